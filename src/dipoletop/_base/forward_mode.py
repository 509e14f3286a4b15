"""Derivatives of what only runs forwards: a loop whose length is not known beforehand."""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

Function = Callable[[Float[Array, "n"], Any], Float[Array, "..."]]


def differentiable(function: Function) -> Function:
    """The same function of (vector, settings), differentiable forwards, backwards and again.

    Its derivatives come from `jax.jacfwd`, whatever is asked for, so that memory does not grow
    with the length of the loops inside. It is for few variables; the settings are constant.
    """

    @jax.custom_jvp
    def wrapped(x: Float[Array, "n"], settings: Any) -> Float[Array, "..."]:
        return function(x, settings)

    @wrapped.defjvp
    def rule(primals: Any, tangents: Any) -> Any:
        (x, settings), (change, _) = primals, tangents
        jacobian = differentiable(jax.jacfwd(function))
        return wrapped(x, settings), jacobian(x, settings) @ change

    return wrapped
