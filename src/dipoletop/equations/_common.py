"""What several equations share: the shape, labels, checks, and states that are ω itself."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.checks import concrete, instance, real, refuse, where_valid
from .._base.linalg import largest
from .._base.types import Real, State, Vector
from ..bodies import Body


def shape_parameter(delta: Any) -> Float[Array, "*lanes"]:
    """δ = 1 − I₃/I₁ as an array; −1 ≤ δ < 1 (−1 a disc, 0 a sphere, towards 1 a needle)."""
    array = real("delta", delta)
    known = np.asarray(array) if concrete(array) else array  # in NumPy, many are faster compared
    return where_valid("delta", array, (known >= -1) & (known < 1), "lie in [-1, 1)")


def rigid_body(body: Any) -> Body:
    """A body; an equation, or its parameter, is none."""
    return instance("body", body, Body)


def check_order(order: Any) -> None:
    """Orders beyond 4 cost about four times more each, and the series diverges."""
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= 4:
        refuse("order", "be 1, 2, 3 or 4", f"is {order!r}")


def one_order_up(lower: Any, t: Any, y: Vector) -> tuple[Vector, Vector]:
    """Ω̇ and Ω̈ = DF·F of the motions of an equation F, which order m + 1 puts into the torque."""
    return jax.jvp(lambda w: lower(t, w), (y,), (lower(t, y),))


@jax.custom_jvp
def reciprocal(x: Real) -> Real:
    """1/x, whose derivatives multiply: a division costs as much as a dozen products."""
    return 1 / x


@reciprocal.defjvp
def _(primals: Any, tangents: Any) -> tuple[Real, Real]:
    (x,), (change,) = primals, tangents
    found = reciprocal(x)
    return found, -(found**2) * change


def unchanged(self: Any, omega: Vector) -> Vector:
    """The state is the angular velocity itself, shape (3,) or (3, B)."""
    return omega


Sizes = Callable[[State], State]
"""What the relative error of each component of a state is measured by."""
Scales = Callable[[Vector], Vector]
"""The same for an angular velocity; a plain function of it."""


def even(omega: Vector) -> Vector:
    """The largest component, for all three."""
    return jnp.broadcast_to(largest(jnp.abs(omega))[None], omega.shape)


def scales_of(equation: Any) -> Scales:
    """How an equation measures ω: by its own function `scales`, or by the largest component."""
    return getattr(equation, "scales", even)


def sizes_of(equation: Any) -> Sizes:
    """How an equation measures its state: by its own method `sizes`, or by the present ω."""
    return getattr(equation, "sizes", Partial(present_sizes, equation))


def present_sizes(equation: Any, y: State) -> State:
    """The scales of ω if that is the state, else |y| or the largest component of ω.

    A component that passes 0 then needs no short steps.
    """
    omega = equation.omega(y)
    if omega is y:
        return scales_of(equation)(y)
    return jnp.maximum(jnp.abs(y), even(omega)[:1])
