"""Particles in SI or Gaussian units, and their conversion to the dimensionless library.

An axis of rotation defines the unit of inertia I₁, the moment about it, and the unit of time
τ₀ = k d²/I₁ with k = 1/(6πε₀c³). In these units |d| = 1, an angular velocity Ω is ω = τ₀Ω, and a
time t is τ = t/τ₀.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.constants import c, e, epsilon_0

from ._base.batches import over_batch
from ._base.checks import finite, instance, refuse, where_valid
from ._base.linalg import dot, matvec
from .bodies import Body, box, rod, spheroid

RADIATION = 1 / (6 * math.pi * epsilon_0 * c**3)
"""k = 1/(6πε₀c³), in kg m² s/(C m)²: the strength of the radiation torque in SI units."""
DEBYE = 1e-21 / c
"""One debye, 1e-18 statC cm, in C m (c is its number in m/s)."""
STATCOULOMB_CM = 1e18 * DEBYE
"""The Gaussian unit of dipole moment, in C m."""


def _batch_axes(particle: Any) -> int:
    """The number of batch axes of a particle."""
    return particle.mass.ndim


class Particle(eqx.Module):
    """A rigid body in SI units, for which τ₀ = k d²/I, k = 1/(6πε₀c³).

    SI values need float64, because float32 ends near 1e-38. `jax.vmap` makes a batch, whose
    methods return arrays with the batch axes in front.

    Args:
        mass: mass, kg.
        inertia: inertia tensor I in body axes, shape (3, 3), kg m².
        dipole: dipole moment d in body axes, shape (3,), C m; `DEBYE` converts.

    Raises:
        ValueError: a `mass` that is not positive; a bad `inertia` or `dipole`, as for `Body`;
            float64 is off. Traced bad values become NaN instead.

    Source: equation (2.2) and the conclusions.

    Example:
        >>> grain = Particle.sphere(50e-9, [2400 * DEBYE, 0, 0], mass=1e-18)
        >>> f"{grain.tau0([0, 0, 1]):.3e}"  # seconds
        '1.425e-35'
        >>> body = grain.body([0, 0, 1])
        >>> body.inertia.diagonal().tolist(), body.dipole.tolist()
        ([1.0, 1.0, 1.0], [1.0, 0.0, 0.0])
    """

    mass: Float[Array, "*batch"]
    inertia: Float[Array, "*batch 3 3"]
    dipole: Float[Array, "*batch 3"]

    def __init__(self, mass: Any, inertia: Any, dipole: Any) -> None:
        self.mass = _positive("mass", mass)
        # The conditions on a body have no scale, so they hold for SI values, too.
        body = Body(
            finite("inertia", inertia, (3, 3), batch=False),
            finite("dipole", dipole, (3,), batch=False),
        )
        self.inertia, self.dipole = body.inertia, body.dipole

    @classmethod
    def sphere(
        cls, radius: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """The homogeneous sphere, I = 2mR²/5.

        Args:
            radius: radius R, m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass m, kg; or else
            density: density, kg/m³.

        Raises:
            ValueError: `radius`, or the one of `mass` and `density` that is given, not positive;
                neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        radius = _positive("radius", radius)
        mass = _mass(4 * math.pi / 3 * radius**3, mass, density)
        return cls(mass, spheroid(mass, radius, radius, dipole=_ANY_DIPOLE).inertia, dipole)

    @classmethod
    def cuboid(
        cls, lengths: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """The homogeneous cuboid with its edges along the body axes.

        Args:
            lengths: edges, shape (3,), m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass, kg; or else
            density: density, kg/m³.

        Raises:
            ValueError: `lengths`, or the one of `mass` and `density` that is given, not positive;
                neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        lengths = _positive("lengths", lengths, (3,))
        mass = _mass(jnp.prod(lengths), mass, density)
        return cls(mass, box(mass, lengths, _ANY_DIPOLE).inertia, dipole)

    @classmethod
    def rod(
        cls, length: Any, radius: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """The homogeneous cylinder about the third body axis.

        Args:
            length: length, m.
            radius: radius, m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass, kg; or else
            density: density, kg/m³.

        Raises:
            ValueError: `length`, `radius`, or the one of `mass` and `density` that is given, not
                positive; neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        length, radius = _positive("length", length), _positive("radius", radius)
        mass = _mass(math.pi * radius**2 * length, mass, density)
        return cls(mass, rod(mass, length, radius, dipole=_ANY_DIPOLE).inertia, dipole)

    @classmethod
    def gaussian(cls, mass: Any, inertia: Any, dipole: Any) -> "Particle":
        """A particle from values in Gaussian units.

        Args:
            mass: mass, g.
            inertia: inertia tensor, shape (3, 3), g cm².
            dipole: dipole moment, shape (3,), statC cm (1 debye is 1e-18 statC cm).

        Raises:
            ValueError: as for `Particle`; the message shows the Gaussian values.
        """
        given = cls(mass, inertia, dipole)
        return cls(1e-3 * given.mass, 1e-7 * given.inertia, STATCOULOMB_CM * given.dipole)

    @over_batch(_batch_axes)
    def moment(self, axis: Any) -> Float[Array, "*batch"]:
        """I = n·In, the moment of inertia about the direction n of `axis`.

        Args:
            axis: axis of rotation in body axes, shape (3,), of any length except 0.

        Returns:
            The moment, kg m².

        Raises:
            ValueError: an `axis` of zero, or of a wrong shape.
        """
        axis = finite("axis", axis, (3,), batch=False)
        axis = where_valid("axis", axis, jnp.any(axis != 0), "not be zero")
        n = axis / jnp.linalg.norm(axis)
        return dot(n, matvec(self.inertia, n))

    @over_batch(_batch_axes)
    def tau0(self, axis: Any) -> Float[Array, "*batch"]:
        """τ₀ = k d²/I, with I the moment about `axis`: the unit of time.

        Args:
            axis: axis of rotation, shape (3,). For a top take an axis across its symmetry axis,
                so that I is its transverse moment; for a plane rotator its axis of rotation.

        Returns:
            τ₀, s.

        Source: equation (2.2).
        """
        return RADIATION * dot(self.dipole, self.dipole) / self.moment(axis)

    @over_batch(_batch_axes)
    def body(self, axis: Any) -> Body:
        """The dimensionless body: I in units of its moment about `axis`, and |d| = 1.

        Args:
            axis: as for `tau0`, which is then the unit of time.

        Returns:
            The body.
        """
        return Body(self.inertia / self.moment(axis), self.dipole / jnp.linalg.norm(self.dipole))

    @over_batch(_batch_axes)
    def omega(self, angular_velocity: Any, axis: Any) -> Float[Array, "*batch 3"]:
        """ω = τ₀Ω, the dimensionless angular velocity.

        Args:
            angular_velocity: Ω in body axes, shape (3,) or (B, 3), rad/s.
            axis: as for `tau0`.

        Returns:
            ω, of the same shape.
        """
        return self.tau0(axis) * finite("angular_velocity", angular_velocity, (3,))

    @over_batch(_batch_axes)
    def angular_velocity(self, omega: Any, axis: Any) -> Float[Array, "*batch 3"]:
        """Ω = ω/τ₀, the angular velocity in rad/s.

        Args:
            omega: dimensionless ω in body axes, shape (3,) or (B, 3).
            axis: as for `tau0`.

        Returns:
            Ω, of the same shape, rad/s.
        """
        return finite("omega", omega, (3,)) / self.tau0(axis)

    @over_batch(_batch_axes)
    def seconds(self, tau: Any, axis: Any) -> Float[Array, "*batch"]:
        """The time t = τ₀τ in seconds.

        Args:
            tau: dimensionless time τ, shape () or (B,).
            axis: as for `tau0`.

        Returns:
            t, of the same shape, s.
        """
        return self.tau0(axis) * finite("tau", tau)

    @over_batch(_batch_axes)
    def braking_time(self, speed: Any, axis: Any) -> Float[Array, "*batch"]:
        """T = 1/(τ₀Ω₀²), the time in which a rotator slows down from Ω₀ to Ω₀/√3.

        Args:
            speed: angular speed Ω₀ > 0, shape () or (B,), rad/s.
            axis: axis of rotation, shape (3,), across the dipole.

        Returns:
            T, of the same shape, s.

        Raises:
            ValueError: a `speed` that is not positive; a bad `axis`, as for `moment`.

        Source: equation (2.4).
        """
        speed = finite("speed", speed)
        speed = where_valid("speed", speed, speed > 0, "be positive")
        return 1 / (self.tau0(axis) * speed**2)


class Rotator(NamedTuple):
    """A particle and the axis that it rotates about."""

    name: str
    particle: Particle
    axis: tuple[float, float, float]
    """In body axes, across the dipole."""


class Row(NamedTuple):
    """A row of `particle_table`."""

    name: str
    mass: float
    """kg."""
    moment: float
    """About the axis of rotation, kg m²."""
    debye: float
    """Dipole moment |d|, debye."""
    tau0: float
    """τ₀, s."""
    braking_time: float
    """T = 1/(τ₀Ω₀²), s."""


def paper_particles() -> tuple[Rotator, ...]:
    """The particles of the paper's conclusions, each with its axis of rotation.

    The dipole lies along the first body axis. The masses of CdSe and CdS, 3.80e-22 kg and
    3.15e-22 kg, come from the densities 5.81 g/cm³ and 4.82 g/cm³ of the crystals.

    Returns:
        Six rotators: a silica sphere of radius 50 nm and mass 1 fg with the dipole of one charge
        e at its surface; a cuboid of DAST about a long and about its short edge; a fibre of
        cellulose; spheres of CdSe and CdS, 5 nm wide.

    Raises:
        ValueError: float64 is off.

    Source: conclusions.

    Example:
        >>> [rotator.name for rotator in paper_particles()][3:]
        ['cellulose fibre', 'CdSe sphere', 'CdS sphere']
    """
    nm, x, y, z = 1e-9, np.array([1.0, 0.0, 0.0]), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    silica = Particle.sphere(50 * nm, 50 * nm * e * x, mass=1e-18)
    dast = Particle.cuboid(nm * np.array([100, 100, 50]), 2.8e7 * DEBYE * x, density=1280)
    cellulose = Particle.cuboid(nm * np.array([300, 30, 30]), 4000 * DEBYE * x, density=1600)
    cdse = Particle.sphere(2.5 * nm, 100 * DEBYE * x, density=5810)
    cds = Particle.sphere(2.5 * nm, 100 * DEBYE * x, density=4820)
    return (
        Rotator("silica sphere", silica, z),
        Rotator("DAST about the long axis", dast, y),
        Rotator("DAST about the short axis", dast, z),
        Rotator("cellulose fibre", cellulose, z),
        Rotator("CdSe sphere", cdse, z),
        Rotator("CdS sphere", cds, z),
    )


def particle_table(rotators: Iterable[Rotator], speed: Any = 2e9 * math.pi) -> list[Row]:
    """τ₀ = k d²/I and T = 1/(τ₀Ω₀²) of each rotator, as Python numbers.

    Args:
        rotators: particles with their axes, such as `paper_particles()`.
        speed: Ω₀, rad/s; by default 2π·10⁹/s.

    Returns:
        One row for each rotator.

    Raises:
        ValueError: a `speed` that is not positive.

    Example:
        >>> row = particle_table(paper_particles())[0]
        >>> f"{row.debye:.1f} D, {row.tau0:.3e} s, {row.braking_time:.3e} s"
        '2401.6 D, 1.427e-35 s, 1.775e+15 s'
    """
    must = "hold rotators, such as `paper_particles()`"
    iterable = instance("rotators", rotators, Iterable, must)
    checked = [instance("rotators", rotator, Rotator, must) for rotator in iterable]
    return [
        Row(
            name,
            mass=float(particle.mass),
            moment=float(particle.moment(axis)),
            debye=float(jnp.linalg.norm(particle.dipole)) / DEBYE,
            tau0=float(particle.tau0(axis)),
            braking_time=float(particle.braking_time(speed, axis)),
        )
        for name, particle, axis in checked
    ]


_ANY_DIPOLE = (1.0, 0.0, 0.0)
"""The dipole of a body from which only the inertia is taken."""


def _positive(name: str, value: Any, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
    """A positive number in SI units, or an array of them."""
    array = finite(name, value, shape, batch=False)
    if array.dtype != jnp.float64:
        hint = 'jax.config.update("jax_enable_x64", True) switches float64 on'
        refuse(name, "be float64", f"is {array.dtype}, which ends near 1e-38 ({hint})")
    return where_valid(name, array, array > 0, "be positive")


def _mass(volume: Float[Array, ""], mass: Any, density: Any) -> Float[Array, ""]:
    """The mass that is given, or that follows from the density, kg."""
    if (mass is None) == (density is None):
        was = "neither is" if mass is None else "both are"
        refuse("mass", "be given or else `density`", was)
    return volume * _positive("density", density) if mass is None else _positive("mass", mass)
