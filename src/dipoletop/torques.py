"""Torques from outside: drag by a gas, a field on the dipole, any function of time and rotation.

`with_torque` adds a torque to an equation of motion. Torques are in body axes, in units of I₁/τ₀²,
so that a torque M adds I⁻¹M to ω′.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._base.attitudes import Quaternion, rotate, unit_quaternion
from ._base.checks import (
    ArrayLike,
    NumberLike,
    check_body,
    finite,
    instance,
    on_host,
    shape_of,
    where_valid,
)
from ._base.linalg import cross, length, matvec
from ._base.refusals import refuse
from ._base.shown import Shown
from ._base.types import Equation, State, Vector
from .bodies import Body
from .equations.torque_driven import Driven, DrivenFull, Torque, driven
from .particles import Particle
from .particles.shapes import Sphere
from .surroundings import AIR, Gas


def with_torque(
    equation: Equation,
    torque: Torque,
    *,
    verdict: Callable[[State], Any] | None = None,
    attitude: ArrayLike | None = None,
    jumps: ArrayLike | None = None,
) -> Driven | DrivenFull:
    """Return the equation of motion IΩ̇ + N − M = T(Ω, Ω̇, Ω̈) with a torque M from outside.

    M is treated like the gyroscopic torque N at every level: the Ω̇ and Ω̈ that a reduced level
    inserts into the radiation torque T include the effect of M. A full equation is followed along
    its physical branch with M. Between its `jumps` M needs finite derivatives by τ, ω and q. A
    reduced level is an expansion: it holds for Γ ≪ I² and E ≪ I³, with the moment I about the axis
    of the motion; where Γ > I² a drag would spin the body up. It inserts the Ω̈ of either side of a
    jump, but not the infinite one of the jump itself, and the motion before a jump does not know of
    it. Several torques are added by repeated calls.

    At the full level the physical branch ends where a torque drives ω at a rate of I²/4, or a field
    E against the dipole reaches 4I³/27; runs near these limits fail at tight tolerances.

    Args:
        equation: any level of a rigid body, or a result of this function.
        torque: M, shape (3,), in body axes and units of I₁/τ₀²: a function of (τ, ω), or of
            (τ, ω, q) if the attitude is followed, written for one top. A plain function must not
            hold numbers that vary in a sweep, or with respect to which you differentiate: make
            them fields of an `equinox.Module`, or arguments by
            `jax.tree_util.Partial(function, number)`.
        verdict: how runs end, for `classify` and `sweep`: a function of the state (ω, or (ω, q),
            lanes behind) that gives outcome, ω∞ and False, for not certified. The regions of the
            equation itself do not hold with another torque. In the state of a full equation the
            part of Ω̇ that runs away follows. None: for `simulate` only.
        attitude: the attitude at the start, a unit quaternion, shape (4,), scalar first, with
            v_lab = q∘v∘q*; the state is then (ω, q). None: the attitude is not followed.
        jumps: times τ at which the torque jumps, shape (j,). A step ends at each of them, at every
            level, so that none is stepped over; more times than jumps bound the steps. A full
            equation has room for 15 in the time of 36 e-foldings of a runaway. Derivatives take
            the times as fixed.

    Returns:
        An equation of motion; `simulate`, and with a verdict `classify` and `sweep`, take it.

    Raises:
        ValueError: another equation, or a bad torque, verdict, attitude or time.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> gamma = 0.1  # ω′ = −(γ − γ²)ω − ω³, since ω″ = γ²ω without radiation
        >>> braked = dt.torques.with_torque(dt.TransverseReduced(0.0), dt.torques.drag(gamma))
        >>> run = dt.simulate(braked, [0.0, 1.0, 0.0], jnp.array([0.0, 4.0]))
        >>> rate = gamma - gamma**2
        >>> expected = (jnp.exp(8 * rate) * (1 + 1 / rate) - 1 / rate) ** -0.5
        >>> bool(abs(run.omega[-1, 1] - expected) < 1e-9)
        True
    """
    if isinstance(torque, RotatingField):
        torque = torque.of_body(check_body(equation))
    start = None if attitude is None else unit_quaternion("attitude", attitude)
    times = None if jumps is None else finite("jumps", jumps, (-1,), batch=False)
    return driven(equation, torque, verdict, start, times)


class Drag(Shown):
    """The torque M = −Γω, with Γ a number or a matrix in body axes."""

    gamma: Float[Array, "*shape"]

    def __call__(self, t: Any, omega: Vector, *attitude: Quaternion) -> Vector:
        """Return the torque, shape (3,)."""
        return -(self.gamma * omega if self.gamma.ndim == 0 else matvec(self.gamma, omega))


def drag(gamma: NumberLike | ArrayLike) -> Drag:
    """Return the torque M = −Γω, the drag by a gas, with Γ in units of I₁/τ₀.

    Args:
        gamma: Γ, a number, or a matrix of shape (3, 3) in body axes. For a particle it is
            `gas_drag(…) * particle.tau0() / particle.moment()`.

    Raises:
        ValueError: another shape, or a number that is not finite.
    """
    array = finite("gamma", gamma, shape_of(gamma))
    if array.shape not in ((), (3, 3)):
        refuse("gamma", "be a number or have shape (3, 3)", f"has shape {array.shape}")
    return Drag(array)


class FieldOnDipole(Shown):
    """The torque M = d × q*∘E∘q, with E constant in the laboratory."""

    dipole: Float[Array, "3"]
    field: Float[Array, "3"]

    def __call__(self, t: Any, omega: Vector, attitude: Quaternion) -> Vector:
        """Return the torque, shape (3,)."""
        back = jnp.concatenate([attitude[:1], -attitude[1:]])
        return cross(self.dipole, rotate(back, self.field))


def field_on_dipole(equation: Equation, field: ArrayLike) -> FieldOnDipole:
    """Return the torque M = d × E of a field that is constant in the laboratory.

    It needs an equation that follows the attitude.

    Args:
        equation: an equation with a body, which has the dipole d.
        field: E in the laboratory, shape (3,), in units of I₁/(τ₀²|d|) for a body of unit dipole.

    Raises:
        ValueError: an equation without a body, or a field of another shape.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> top = dt.TransverseSemi(0.3)
        >>> pulled = dt.torques.field_on_dipole(top, [0.0, 1e-3, 0.0])
        >>> level = [1.0, 0.0, 0.0, 0.0]
        >>> equation = dt.torques.with_torque(top, pulled, attitude=level)
        >>> run = dt.simulate(equation, [0.0, 0.0, 0.0], jnp.array([0.0, 1.0]))
        >>> [float(f"{x:.2e}") for x in run.omega[-1]]  # I₃ω₃′ = E at first, I₃ = 1 − δ
        [0.0, 0.0, 0.00143]
    """
    return FieldOnDipole(check_body(equation).dipole, finite("field", field, (3,)))


class RotatingField(Shown):
    """The torque M = d × q*∘E(t)∘q of a field that rotates in the laboratory."""

    amplitude: Float[Array, ""]
    frequency: Float[Array, ""]
    axes: Float[Array, "2 3"]
    """The directions of E at the phases 0 and π/2."""
    dipole: Float[Array, "3"] | None = None
    """The dipole d of the body; None until `with_torque` gives it."""

    def of_body(self, body: Body) -> "RotatingField":
        """Return the torque on the dipole of a body."""
        return dataclasses.replace(self, dipole=body.dipole)

    def __call__(self, t: Any, omega: Vector, attitude: Quaternion) -> Vector:
        """Return the torque, shape (3,)."""
        if self.dipole is None:
            refuse("torque", "be given to `with_torque`, which knows the dipole", "is called")
        phase = self.frequency * t
        field = self.amplitude * (jnp.cos(phase) * self.axes[0] + jnp.sin(phase) * self.axes[1])
        return FieldOnDipole(self.dipole, field)(t, omega, attitude)


def rotating_field(
    amplitude: NumberLike, frequency: NumberLike, *, axis: ArrayLike = (0.0, 0.0, 1.0)
) -> RotatingField:
    """Return the torque M = d × E of a field that rotates in the laboratory.

    E(τ) = E(e₁ cos ντ + e₂ sin ντ), with e₁, e₂ and the axis right-handed; e₁ = x for the axis z.
    A dipole across the axis can follow the field if |d|E exceeds the drag Γν and the radiation
    torque κν³. It lags behind by the angle φ with sin φ = (Γν + κν³)/(|d|E), and oscillates about
    that with the frequency √(|d|E cos φ/I). It needs an equation that follows the attitude, with a
    body, whose dipole `with_torque` takes.

    Args:
        amplitude: E, in units of I₁/(τ₀²|d|) for a body of unit dipole.
        frequency: ν, in units of 1/τ₀; negative for the other sense.
        axis: the axis of the rotation of E in the laboratory, shape (3,).

    Raises:
        ValueError: a number that is not finite, or an axis of zero.

    Example:
        The dipole lags behind the field by the angle with the sine (Γν + ν³)/E = 0.327.

        >>> import jax.numpy as jnp, dipoletop as dt
        >>> pulled = dt.torques.rotating_field(1e-3, 0.03)
        >>> top, start = dt.TransverseReduced(0.0), [1.0, 0.0, 0.0, 0.0]
        >>> driven = dt.torques.with_torque(top, pulled, attitude=start)
        >>> driven = dt.torques.with_torque(driven, dt.torques.drag(0.01))
        >>> run = dt.simulate(driven, [0.0, 0.0, 0.03], jnp.array([0.0, 3000.0]))
        >>> lag = 0.03 * 3000 - 2 * jnp.arctan2(run.attitude[-1, 3], run.attitude[-1, 0])
        >>> print(f"{jnp.sin(lag):.3f}")
        0.327
    """
    z = finite("axis", axis, (3,), batch=False)
    z = where_valid("axis", z, (on_host(z) != 0).any(), "not be zero")
    z = z / length(z)
    # The axis x turned the shortest way from z to the axis; about y if they are opposite.
    near = 1 + z[2] > 1e-12
    ratio = 1 / jnp.where(near, 1 + z[2], 1.0)
    x = jnp.stack([1 - z[0] ** 2 * ratio, -z[0] * z[1] * ratio, -z[0]])
    x = jnp.where(near, x, jnp.array([-1.0, 0.0, 0.0]))
    size, rate = finite("amplitude", amplitude), finite("frequency", frequency)
    return RotatingField(size, rate, jnp.stack([x, cross(z, x)]))


def gas_drag(
    particle: Particle,
    pressure: NumberLike | ArrayLike,
    temperature: NumberLike | ArrayLike = 300.0,
    molecular_mass: NumberLike | ArrayLike = AIR,
    **options: Any,
) -> Float[Array, "..."]:
    """Compute Γ, the drag by a rarefied gas on a rotating body, N m s; the torque is −ΓΩ.

    For a sphere that molecules leave diffusely it is Γ = (2π/3)R⁴p√(8m/(πk_BT)).

    Args:
        particle: a particle with a shape.
        pressure: p in Pa.
        temperature: T in K.
        molecular_mass: m in kg; by default of air.
        options: accommodation and surface temperature, as for `surroundings.Gas`.

    Returns:
        For a sphere a number, in the shape of the arguments; for other bodies a diagonal matrix in
        body axes, shape (..., 3, 3).

    Raises:
        ValueError: a particle without a shape, or bad numbers, as for `surroundings.Gas`.

    Example:
        >>> import dipoletop as dt
        >>> bead = dt.Particle.sphere(50e-9, [0.0, 0.0, 1e-27], density=2000.0)
        >>> rate = dt.torques.gas_drag(bead, 1e-6) / bead.moment()  # 1/s, at 1e-8 mbar
        >>> f"{rate:.2e}"
        '6.80e-05'
    """
    instance("particle", particle, Particle)
    gas = Gas(pressure, temperature, molecular_mass=molecular_mass, **options)
    friction = gas.friction(particle)
    if isinstance(particle.shape, Sphere):
        return friction[0]
    return jnp.moveaxis(friction, 0, -1)[..., None] * jnp.eye(3)
