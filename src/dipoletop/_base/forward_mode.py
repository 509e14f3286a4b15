"""Forward-mode derivatives of functions with while-loops, usable under reverse mode.

JAX cannot transpose a loop whose length is not known beforehand. But the whole Jacobian of a
function of few variables is cheap in forward mode, and a product with a known matrix can be
transposed.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

Function = Callable[[Float[Array, "n"], Any], Any]
"""A function from a vector and settings to arrays of floating-point numbers."""


def forward_differentiable(
    function: Function, *, one_by_one: bool = False, compiled: Callable[[Any], Any] | None = None
) -> Function:
    """Make a function of (vector, settings) differentiable in both modes, to any order.

    All derivatives come from `jax.jacfwd`, so memory does not grow with the length of the loops
    inside. The settings are constant.

    Args:
        function: the function.
        one_by_one: whether to compute the values of a batch in sequence, so that its lanes do not
            wait for each other in every loop.
        compiled: compiles a function, such as `compiled_soon`, which sees known numbers even where
            a user differentiates, unless under `jit`. Keep the result: it holds the programs.
    """
    values = jax.custom_batching.sequential_vmap(function) if one_by_one else function
    compiled = compiled or (lambda function: function)
    values = compiled(values)

    @functools.cache
    def values_and_jacobian() -> Function:
        # Both from one evaluation, so that the function is compiled only once.
        both = jax.jacfwd(lambda x, settings: (function(x, settings),) * 2, has_aux=True)
        return forward_differentiable(both, compiled=compiled)

    @jax.custom_jvp
    def wrapped(x: Float[Array, "n"], settings: Any) -> Any:
        return values(x, settings)

    @wrapped.defjvp
    def rule(primals: Any, tangents: Any) -> Any:
        (x, settings), (change, _) = primals, tangents
        jacobian, found = values_and_jacobian()(x, settings)
        return found, jax.tree.map(lambda rows: rows @ change, jacobian)

    return wrapped
