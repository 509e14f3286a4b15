"""Code that several equations share: converters of fields, order reduction, members.

An equation need not have the `OptionalMembers`. For each of them one function, here or in `levels`,
reads it and supplies the default. The classes hold members by the kind of states, and of the body.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.checks import instance, namespace, on_device, on_host, real, where_valid
from .._base.linalg import diagonal, dot, largest, length, scale
from .._base.refusals import refuse
from .._base.shown import Shown
from .._base.types import Equation, ErrorScale, OmegaScale, Real, State, Vector
from ..bodies import AXES, Body, axisymmetric
from ..radiation import radiated_power
from .coordinates import from_cylindrical, to_cylindrical
from .levels import Level


def shape_parameter(delta: Any) -> Float[Array, "*lanes"]:
    """Compute δ = 1 − I₃/I₁ as an array; −1 ≤ δ < 1 (−1 a disc, 0 a sphere, towards 1 a needle)."""
    array = real("delta", delta)
    known = on_host(array)
    return where_valid("delta", array, (known >= -1) & (known < 1), "lie in [-1, 1)")


def rigid_body(body: Any) -> Body:
    """Return a `Body`; refuse anything else."""
    return instance("body", body, Body)


def reduced_order(order: Any) -> int:
    """Return an order from 1 to 4; each costs four times as much, and the series diverges."""
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= 4:
        refuse("order", "be 1, 2, 3 or 4", f"is {order!r}")
    return order


def first_and_second(rate: Callable[[Vector], Vector], omega: Vector) -> tuple[Vector, Vector]:
    """Compute Ω̇ = F and Ω̈ = DF·F of an equation F; F is evaluated once."""
    first, derivative = jax.linearize(rate, omega)
    return first, derivative(first)


@jax.custom_jvp
def reciprocal(x: Real) -> Real:
    """Return 1/x, with derivatives made of products: a division costs as much as a dozen."""
    return 1 / x


@reciprocal.defjvp
def _(primals: Any, tangents: Any) -> tuple[Real, Real]:
    (x,), (change,) = primals, tangents
    inverse = reciprocal(x)
    return inverse, -(inverse**2) * change


def jumps_of(equation: Any) -> Float[Array, "j *lanes"] | None:
    """Return the times at which a torque jumps, and steps must end; None if there is none."""
    return getattr(equation, "jumps", None)


def rate_of_omega(equation: Equation, t: Any, y: State) -> Vector:
    """Return the rate of the angular velocity of a state."""
    return jax.jvp(equation.omega, (y,), (equation(t, y, None),))[1]


def energy_flows(equation: Any, t: Any, y: State) -> Float[Array, "k"]:
    """Return the radiated power |d₂|², and ω·M if the equation has a torque M from outside."""
    omega = equation.omega(y)
    power = radiated_power(equation.body, omega, rate_of_omega(equation, t, y))
    torque = getattr(equation, "torque", None)
    return jnp.stack([power] if torque is None else [power, dot(omega, torque(t, y))])


def follows_attitude(equation: Any) -> bool:
    """Return whether states of the equation hold an attitude."""
    return getattr(equation, "start", None) is not None


def slow_start(equation: Any, omega0: Vector) -> State:
    """Return the slow part of a state at ω₀: ω₀, followed by the attitude if a state holds one."""
    start = getattr(equation, "start", None)
    return omega0 if start is None else jnp.concatenate([omega0, start])


def is_full(equation: Any) -> bool:
    """Return whether an equation has runaways, so that its physical branch has to be followed."""
    passes_on = hasattr(type(equation), "__getattr__")  # the members of another equation
    if not passes_on and inspect.getattr_static(equation, "runaway_rate", None) is None:
        return False
    # Traced, not computed: leaves may be shapes that stand for arrays.
    return eqx.filter_eval_shape(getattr, equation, "runaway_rate", None) is not None


def elements_of(equation: Any) -> int:
    """Return the number of elements of a window of a full equation: `equation.elements`, else 4."""
    return getattr(equation, "elements", 4)


def physical(equation: Any) -> Any:
    """Return the equation to integrate from an initial condition ω₀: its `branch`, else itself."""
    return getattr(equation, "branch", equation)


def has_body_field(equation: Any) -> bool:
    """Return whether the body is a parameter of the equation: a field, not a top derived from δ."""
    fields = dataclasses.fields(equation) if dataclasses.is_dataclass(equation) else ()
    is_field = any(field.name == "body" for field in fields)
    return is_field and isinstance(getattr(equation, "body", None), Body)


def twist_axis(equation: Any) -> Vector:
    """Return the axis about which the turns of an attitude are counted (`_base.attitudes`).

    It is the dipole, along which a residual rotation ends. Without a dipole any axis serves. No
    attitude depends on it, so it has no derivatives.
    """
    third = jnp.array([0.0, 0.0, 1.0])
    body = getattr(equation, "body", None)
    if body is None:
        return third
    dipole = jax.lax.stop_gradient(body.dipole)
    dipole = jnp.where(jnp.any(dipole != 0), dipole, third)
    return scale(1 / length(dipole), dipole)


def omega_scale_of(equation: Any) -> OmegaScale:
    """Return the scale of the error of ω: `equation.omega_scale`, else the largest component."""
    return getattr(equation, "omega_scale", largest_component)


def error_scale_of(equation: Any) -> ErrorScale:
    """Return the scale of the error of a state: `equation.error_scale`, else `present_scale`."""
    return getattr(equation, "error_scale", Partial(present_scale, equation))


def largest_component(omega: Vector) -> Vector:
    """Return the largest component of |ω|, for all three components."""
    return jnp.broadcast_to(largest(jnp.abs(omega))[None], omega.shape)


def present_scale(equation: Equation, y: State) -> State:
    """Return the scale of ω if ω is the state, else |y| or the largest component of ω.

    A component that passes through 0 then does not force short steps.
    """
    omega = equation.omega(y)
    if omega is y:
        return omega_scale_of(equation)(y)
    return jnp.maximum(jnp.abs(y), largest_component(omega)[:1])


def transverse_omega_scale(omega: Vector) -> Vector:
    """Return the scale for a transverse top: ω⊥ for ω₁ and ω₂, max(|ω₃|, ω⊥ min(ω⊥, 1)) for ω₃.

    Near the residual line, and where a top is captured by it, ω₃ ~ ω⊥² if ω⊥ is small.
    """
    w1, w2, w3 = jnp.abs(omega)
    across = jnp.maximum(w1, w2)
    return jnp.stack([across, across, jnp.maximum(w3, across * jnp.minimum(across, 1.0))])


def planar_rates(
    delta: Real, c: Real | float, y: Float[Array, "2 *#lanes"]
) -> Float[Array, "2 *#lanes"]:
    """Compute φ_σ = −δz − ½ sin 2φ, z_σ = z{1 − …cos²φ} − c sin 2φ/(1−δ) (`dipoletop.planar`)."""
    phi, z = y
    sine = jnp.sin(2 * phi)
    growth = z * (1 - (2 + delta) / (1 - delta) * jnp.cos(phi) ** 2)
    return jnp.stack([-delta * z - sine / 2, growth - c * sine / (1 - delta)])


class OfOmega(Shown):
    """An equation whose state is ω itself."""

    def lift(self, omega0: Vector) -> Vector:
        """Return ω₀, since the state is ω itself."""
        return omega0

    def omega(self, y: Vector) -> Vector:
        """Return the state, which is ω itself."""
        return y


class OfOrder(OfOmega):
    """A reduced level, 1 … 4."""

    order: int = eqx.field(static=True, default=1, converter=reduced_order)

    @property
    def level(self) -> str:
        """The label of the level."""
        return Level.of_order(self.order).label


class OmegaFirst(Shown):
    """An equation whose state begins with ω."""

    def omega(self, y: State) -> Vector:
        """Return the first three components."""
        return y[:3]


class OfFull(OmegaFirst):
    """A full equation of a body, with the state (ω, a)."""

    def lift(self: Any, omega0: Vector) -> State:
        """Return the state near the physical branch, by the reduction of order 3: error O(ω⁹)."""
        return jnp.concatenate([omega0, self.fast(self.reduced(3)(0.0, omega0))])


class Cylindrical(Shown):
    """An equation with the state (ω⊥, ω₃, φ)."""

    def lift(self, omega0: Vector) -> Vector:
        """Compute (ω⊥, ω₃, φ) of ω₀."""
        return to_cylindrical(omega0)

    def omega(self, y: Vector) -> Vector:
        """Compute ω of a state (ω⊥, ω₃, φ)."""
        return from_cylindrical(y[0], y[1], y[2])


def _top(delta: Real, dipole: str) -> Body:
    """Return `axisymmetric(delta, dipole)`; δ has been checked, and is not again."""
    delta = on_host(delta)
    one = namespace(delta).ones_like(delta)
    direction = np.broadcast_to(np.asarray(AXES[dipole], delta.dtype), (*delta.shape, 3))
    parts = on_device(diagonal(one, one, 1 - delta)), on_device(direction)
    return jax.tree.unflatten(_structure_of_body(), parts)


@functools.cache
def _structure_of_body() -> Any:
    return jax.tree.structure(axisymmetric(0.0))


class TransverseTop(Shown):
    """An equation of the top with a transverse dipole."""

    delta: Real = eqx.field(converter=shape_parameter)

    omega_scale = staticmethod(transverse_omega_scale)

    @property
    def body(self) -> Body:
        """The top, for energies and powers."""
        return _top(self.delta, "transverse")


class LongitudinalTop(Shown):
    """An equation of the top with a longitudinal dipole."""

    delta: Real = eqx.field(converter=shape_parameter)

    @property
    def body(self) -> Body:
        """The top, for energies and powers."""
        return _top(self.delta, "longitudinal")


class OfBody(Shown):
    """An equation of any body."""

    body: Body = eqx.field(converter=rigid_body)
