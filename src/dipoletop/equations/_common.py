"""What several equations share: converters of fields, order reduction, and members that may lack.

An equation may leave out the members of `OptionalMembers`. Each of them is read by one function,
here or in `levels`, which knows what to do without it.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.checks import concrete, instance, real, refuse, where_valid
from .._base.linalg import largest
from .._base.types import Equation, ErrorScale, OmegaScale, Real, State, Vector
from ..bodies import Body


def shape_parameter(delta: Any) -> Float[Array, "*lanes"]:
    """δ = 1 − I₃/I₁ as an array; −1 ≤ δ < 1 (−1 a disc, 0 a sphere, towards 1 a needle)."""
    array = real("delta", delta)
    known = np.asarray(array) if concrete(array) else array  # in NumPy, many are faster compared
    return where_valid("delta", array, (known >= -1) & (known < 1), "lie in [-1, 1)")


def rigid_body(body: Any) -> Body:
    """A body; an equation, or its parameter, is none."""
    return instance("body", body, Body)


def reduced_order(order: Any) -> int:
    """An order from 1 to 4; beyond, each costs about four times more, and the series diverges."""
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= 4:
        refuse("order", "be 1, 2, 3 or 4", f"is {order!r}")
    return order


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
    inverse = reciprocal(x)
    return inverse, -(inverse**2) * change


def is_full(equation: Any) -> bool:
    """Whether an equation has runaways, and so a physical branch that has to be followed."""
    return getattr(equation, "runaway_rate", None) is not None


def physical(equation: Any) -> Any:
    """The equation that runs from an initial condition ω₀ integrate: its `branch`, else itself."""
    return getattr(equation, "branch", equation)


def has_body_field(equation: Any) -> bool:
    """Whether the body is a parameter: a field, not a top that is derived from δ."""
    fields = dataclasses.fields(equation) if dataclasses.is_dataclass(equation) else ()
    is_field = any(field.name == "body" for field in fields)
    return is_field and isinstance(getattr(equation, "body", None), Body)


def omega_scale_of(equation: Any) -> OmegaScale:
    """What relative errors of ω refer to: `equation.omega_scale`, else the largest component."""
    return getattr(equation, "omega_scale", largest_component)


def error_scale_of(equation: Any) -> ErrorScale:
    """What relative errors of a state refer to: `equation.error_scale`, else its present ω."""
    return getattr(equation, "error_scale", Partial(present_scale, equation))


def largest_component(omega: Vector) -> Vector:
    """The largest component, for all three."""
    return jnp.broadcast_to(largest(jnp.abs(omega))[None], omega.shape)


def present_scale(equation: Equation, y: State) -> State:
    """The scale of ω if that is the state, else |y| or the largest component of ω.

    So a component that passes through 0 needs no short steps.
    """
    omega = equation.omega(y)
    if omega is y:
        return omega_scale_of(equation)(y)
    return jnp.maximum(jnp.abs(y), largest_component(omega)[:1])


def transverse_omega_scale(omega: Vector) -> Vector:
    """Of a transverse top: ω⊥ for ω₁ and ω₂; for ω₃ itself, or ω⊥ min(ω⊥, 1) if that is larger.

    Near the residual line, and at a capture, ω₃ ~ ω⊥² where that is small.
    """
    w1, w2, w3 = jnp.abs(omega)
    across = jnp.maximum(w1, w2)
    return jnp.stack([across, across, jnp.maximum(w3, across * jnp.minimum(across, 1.0))])
