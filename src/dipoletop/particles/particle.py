"""A particle in SI or Gaussian units: its units of inertia and time, and conversions by them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.batches import over_batch
from .._base.checks import concrete, finite, instance, on_device, on_host, where_valid, without_unit
from .._base.guards import safe_sqrt
from .._base.linalg import dot
from .._base.quantities import ANGULAR
from .._base.refusals import refuse
from ..bodies import Body
from . import moments, shapes
from .texts import text
from .units import (
    LIGHT,
    RADIATION,
    STATCOULOMB_CM,
    finite_numbers,
    magnetic_dipole,
    numbers,
    positive_si,
    speed_in_rad,
)


def _batch_axes(particle: Any) -> int:
    """Return the number of batch axes of a particle."""
    return particle.mass.ndim


class Particle(eqx.Module):
    """A rigid body in SI units, for which τ₀ = k d²/I₁, k = 1/(6πε₀c³).

    I₁ is the middle one of the principal moments, J₁ ≤ J₂ ≤ J₃. For an axisymmetric body this is
    the transverse moment, as everywhere in the library; it changes continuously with the body and
    is at least J₃/2. Most methods take an `axis`; I₁ is then the moment about it. The SI values of
    a motion do not depend on that choice, if all its conversions share it.

    SI values need float64, because float32 ends near 1e-38. `jax.vmap` makes a batch, whose
    methods return arrays with the batch axes in front, with the same arguments for all particles.
    For an argument of each, write `jax.vmap(Particle.angular_velocity)(particles, omega_inf)`.

    Args:
        mass: mass, kg.
        inertia: inertia tensor I in body axes, shape (3, 3), kg m².
        dipole: dipole moment d in body axes, shape (3,), C m; `DEBYE` converts.
        radius: the largest distance R of a point of the body from the centre of mass, m; None if
            it is not known. Only `rim_speed` needs it.
        shape: the body as a solid of `particles.shapes`, whose radius then counts, along the body
            axes; None if it is not known. The drag by a gas and thermal radiation depend on it.

    Raises:
        ValueError: a `mass` that is not positive; a bad `inertia` or `dipole`, as for `Body`; a
            `radius` below √(tr I/(2m)), which no body of that inertia has; float64 is off. Traced
            bad values become NaN instead.

    Source: equation (2.2) and the conclusions.

    Example:
        >>> from dipoletop.particles import DEBYE
        >>> grain = Particle.rod(100e-9, 10e-9, [2400 * DEBYE, 0, 0], density=2200)
        >>> grain  # doctest: +NORMALIZE_WHITESPACE
        Particle(mass=6.9115e-20 kg, moments=(5.93237e-35, 5.93237e-35, 3.45575e-36) kg m²,
                 dipole=2400 D along (1, 0, 0), radius=5.09902e-08 m)
        >>> f"{grain.tau0():.3e}"  # seconds
        '2.402e-34'
        >>> body = grain.body()
        >>> body.inertia.diagonal().round(6).tolist(), body.dipole.tolist()
        ([1.0, 1.0, 0.058252], [1.0, 0.0, 0.0])
    """

    mass: Float[Array, "*batch"]
    inertia: Float[Array, "*batch 3 3"]
    dipole: Float[Array, "*batch 3"]
    radius: Float[Array, "*batch"] | None = None
    shape: shapes.Solid | None = None

    def __init__(
        self, mass: Any, inertia: Any, dipole: Any, *, radius: Any = None, shape: Any = None
    ) -> None:
        mass = positive_si("mass", mass, "kg")
        self.mass = on_device(mass)
        # The conditions on a body have no scale, so they hold for SI values, too.
        body = Body(
            finite("inertia", inertia, (3, 3), batch=False, unit="kg*m**2"),
            finite("dipole", dipole, (3,), batch=False, unit="C*m"),
        )
        self.inertia, self.dipole = body.inertia, body.dipole
        self.radius, self.shape = None, None
        if shape is not None:
            must = "be a solid of `particles.shapes`, such as `Sphere`"
            solid = instance("shape", shape, shapes.Solid, must)
            positive_si("shape", solid.half_lengths, "m", (3,))
            self.shape = jax.tree.map(on_device, shape)
            if radius is not None:
                refuse("radius", "be None if a `shape` is given, whose radius counts", "is given")
            radius = shape.reach
        if radius is not None:
            given = positive_si("radius", radius, "m")
            # tr I = 2 Σ mρ² ≤ 2mR²
            least = on_host(self.inertia).trace() / (2 * mass)
            large = given**2 >= (1 - 2e-12) * least
            must = "be at least √(tr I/(2m)), the mean distance of the mass from the centre"
            self.radius = on_device(where_valid("radius", given, large, must))

    def __repr__(self) -> str:
        """Return the numbers of one particle, or ranges of many; if traced, the shapes."""
        leaves = jax.tree.leaves(self)
        known = all(isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves)
        if len(leaves) < 3 or not (known and concrete(self)):
            return eqx.tree_pformat(self)
        return text(self)

    @staticmethod
    def sphere(radius: Any, dipole: Any, *, mass: Any = None, density: Any = None) -> "Particle":
        """Return the homogeneous sphere, I = 2mR²/5, m = 4πR³ρ/3.

        Args:
            radius: radius R, m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass m, kg; or else
            density: density ρ, kg/m³.

        Raises:
            ValueError: `radius`, or the one of `mass` and `density` that is given, not positive;
                neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        return _homogeneous(shapes.sphere(radius), dipole, mass, density)

    @staticmethod
    def spheroid(
        a: Any, c: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """Return the homogeneous spheroid about the third body axis, m = 4πa²cρ/3.

        Args:
            a: equatorial semi-axis, m.
            c: polar semi-axis, m; c > a is prolate.
            dipole: dipole moment, shape (3,), C m.
            mass: mass m, kg; or else
            density: density ρ, kg/m³.

        Raises:
            ValueError: `a`, `c`, or the one of `mass` and `density` that is given, not positive;
                neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        return _homogeneous(shapes.spheroid(a, c), dipole, mass, density)

    @staticmethod
    def ellipsoid(
        semi_axes: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """Return the homogeneous ellipsoid, I = m/5 diag(b²+c², c²+a², a²+b²), m = 4πabcρ/3.

        Args:
            semi_axes: semi-axes a, b, c along the body axes, shape (3,), m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass m, kg; or else
            density: density ρ, kg/m³.

        Raises:
            ValueError: `semi_axes`, or the one of `mass` and `density` that is given, not
                positive; neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        return _homogeneous(shapes.ellipsoid(semi_axes), dipole, mass, density)

    @staticmethod
    def cuboid(lengths: Any, dipole: Any, *, mass: Any = None, density: Any = None) -> "Particle":
        """Return the homogeneous cuboid with its edges along the body axes, m = l₁l₂l₃ρ.

        Args:
            lengths: edges, shape (3,), m.
            dipole: dipole moment, shape (3,), C m.
            mass: mass, kg; or else
            density: density ρ, kg/m³.

        Raises:
            ValueError: `lengths`, or the one of `mass` and `density` that is given, not positive;
                neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        return _homogeneous(shapes.cuboid(lengths), dipole, mass, density)

    @staticmethod
    def rod(
        length: Any, radius: Any, dipole: Any, *, mass: Any = None, density: Any = None
    ) -> "Particle":
        """Return the homogeneous cylinder about the third body axis, m = πr²lρ.

        Args:
            length: length l, m.
            radius: radius r, m; the field `radius` is √(l²/4 + r²).
            dipole: dipole moment, shape (3,), C m.
            mass: mass, kg; or else
            density: density ρ, kg/m³.

        Raises:
            ValueError: `length`, `radius`, or the one of `mass` and `density` that is given, not
                positive; neither or both of these given; a bad `dipole`, as for `Particle`.
        """
        return _homogeneous(shapes.cylinder(length, radius), dipole, mass, density)

    @classmethod
    def gaussian(cls, mass: Any, inertia: Any, dipole: Any, *, radius: Any = None) -> "Particle":
        """Return a particle from values in Gaussian units.

        Args:
            mass: mass, g.
            inertia: inertia tensor, shape (3, 3), g cm².
            dipole: dipole moment, shape (3,), statC cm (1 debye is 1e-18 statC cm).
            radius: as for `Particle`, cm.

        Raises:
            ValueError: as for `Particle`; the message shows the Gaussian values.
        """
        mass, inertia = without_unit("mass", mass, "g"), without_unit("inertia", inertia, "g*cm**2")
        radius, si = without_unit("radius", radius, "cm"), without_unit("dipole", dipole, "C*m")
        if si is not dipole:  # a quantity
            dipole = np.asarray(si) / STATCOULOMB_CM
        given = cls(mass, inertia, dipole, radius=radius)
        metres = None if given.radius is None else 1e-2 * given.radius
        dipole = STATCOULOMB_CM * given.dipole
        return cls(1e-3 * given.mass, 1e-7 * given.inertia, dipole, radius=metres)

    @classmethod
    def magnetic(
        cls, mass: Any, inertia: Any, moment: Any, *, radius: Any = None, shape: Any = None
    ) -> "Particle":
        """Return a particle with a magnetic dipole moment m, which radiates as d = m/c does.

        Args:
            mass: mass, kg.
            inertia: inertia tensor in body axes, shape (3, 3), kg m².
            moment: magnetic moment m in body axes, shape (3,), A m².
            radius: as for `Particle`.
            shape: as for `Particle`. `Particle.sphere(radius, magnetic_dipole(moment), …)` and the
                other solids take a magnetic moment, too.

        Raises:
            ValueError: a bad `moment`; else as for `Particle`.

        Example:
            The neutron star in the Crab nebula: its speed over its rate of braking, in years.

            >>> import jax.numpy as jnp
            >>> star = Particle.magnetic(2.8e30, 1e38 * jnp.eye(3), [3.79e27, 0, 0])
            >>> f"{star.braking_time(2 * jnp.pi / 0.0334) / 3.15576e7:.0f}"
            '2519'
        """
        return cls(mass, inertia, magnetic_dipole(moment), radius=radius, shape=shape)

    @over_batch(_batch_axes)
    def moment(self, axis: Any = None) -> Float[Array, "*batch"]:
        """Compute I₁ = n·In, the moment of inertia about the direction n of `axis`.

        Args:
            axis: in body axes, shape (3,), of any length except 0. None is a principal axis with
                the middle moment J₂; for an axisymmetric body, any axis across its symmetry axis.
                Where J₂ equals another moment it has a kink: the first derivative belongs to one
                of the two moments, and second derivatives need an `axis`.

        Returns:
            The moment, kg m².

        Raises:
            ValueError: an `axis` of zero, or of a wrong shape.
        """
        if axis is None:
            return moments.middle(self.inertia)
        return moments.about(axis, self.inertia)

    @over_batch(_batch_axes)
    def tau0(self, axis: Any = None) -> Float[Array, "*batch"]:
        """Compute τ₀ = k d²/I₁, the unit of time, with I₁ the moment about `axis`.

        Args:
            axis: as for `moment`; for a plane rotator its axis of rotation.

        Returns:
            τ₀, s.

        Source: equation (2.2).
        """
        return RADIATION * dot(self.dipole, self.dipole) / self.moment(axis)

    @over_batch(_batch_axes)
    def body(self, axis: Any = None) -> Body:
        """Return the dimensionless body, with I in units of I₁ about `axis`, and |d| = 1.

        Args:
            axis: as for `tau0`, which is then the unit of time.

        Returns:
            The body.
        """
        return Body(self.inertia / self.moment(axis), self.dipole / jnp.linalg.norm(self.dipole))

    @over_batch(_batch_axes)
    def omega(self, angular_velocity: Any, axis: Any = None) -> Float[Array, "..."]:
        """Compute ω = τ₀Ω, dimensionless, of an angular velocity, a component or a speed.

        Args:
            angular_velocity: Ω, rad/s: vectors in body axes or scalars, of any shape; or a text
                such as "1 GHz" (`angular_speed`).
            axis: as for `tau0`.

        Returns:
            ω, of the same shape.
        """
        if isinstance(angular_velocity, str):
            return self.tau0(axis) * speed_in_rad("angular_velocity", angular_velocity)
        return self.tau0(axis) * finite_numbers("angular_velocity", angular_velocity, ANGULAR)

    @over_batch(_batch_axes)
    def angular_velocity(self, omega: Any, axis: Any = None) -> Float[Array, "..."]:
        """Compute Ω = ω/τ₀ in rad/s, of an angular velocity ω, a component or an ω∞.

        Args:
            omega: dimensionless: vectors in body axes or scalars, of any shape. NaN, the ω∞ of a
                run that is not decided, stays NaN.
            axis: as for `tau0`.

        Returns:
            Ω, of the same shape, rad/s.
        """
        return numbers("omega", omega) / self.tau0(axis)

    @over_batch(_batch_axes)
    def tau(self, seconds: Any, axis: Any = None) -> Float[Array, "..."]:
        """Compute the dimensionless time τ = t/τ₀.

        Args:
            seconds: t, s, of any shape.
            axis: as for `tau0`.

        Returns:
            τ, of the same shape.
        """
        return finite_numbers("seconds", seconds, "s") / self.tau0(axis)

    @over_batch(_batch_axes)
    def seconds(self, tau: Any, axis: Any = None) -> Float[Array, "..."]:
        """Compute the time t = τ₀τ in seconds.

        Args:
            tau: dimensionless time τ, of any shape. NaN, a time that is not known, stays NaN.
            axis: as for `tau0`.

        Returns:
            t, of the same shape, s.
        """
        return self.tau0(axis) * numbers("tau", tau)

    @over_batch(_batch_axes)
    def braking_time(self, speed: Any, axis: Any = None) -> Float[Array, "*batch"]:
        """Compute T = I/(k d²Ω₀²), the time in which a rotator slows down from Ω₀ to Ω₀/√3.

        Args:
            speed: angular speed Ω₀ > 0, shape () or (B,), rad/s; or a text (`angular_speed`).
            axis: axis of rotation, shape (3,), across the dipole. It may be left out if the moment
                I is the same about all such axes, as for a sphere or a dipole along a symmetry
                axis.

        Returns:
            T, of the same shape, s.

        Raises:
            ValueError: a `speed` that is not positive; a bad `axis`, as for `moment`; no `axis`
                where the moment depends on it (of a batch, or traced, T is NaN there).

        Source: equation (2.4).
        """
        speed = speed_in_rad("speed", speed)
        speed = where_valid("speed", speed, on_host(speed) > 0, "be positive")
        if axis is None:
            moment = moments.across(self.dipole, self.inertia)
        else:
            moment = moments.about(axis, self.inertia)
        return moment / (RADIATION * dot(self.dipole, self.dipole) * speed**2)

    @over_batch(_batch_axes)
    def rim_speed(self, angular_velocity: Any) -> Float[Array, "*batch"]:
        """Compute |Ω|R/c, an upper bound of the speed of points of the body in units of c.

        R is the field `radius`. A point at this distance has this speed if it lies across the axis
        of rotation from the centre. The theory is not relativistic: it holds where this is small.

        Args:
            angular_velocity: a speed |Ω| in rad/s, shape (), or a text (`angular_speed`); or Ω in
                rad/s, shape (3,) or (B, 3).

        Returns:
            v/c, of shape () or (B,).

        Raises:
            ValueError: the `radius` of the particle is not known; a negative speed.

        Example:
            >>> grain = Particle.sphere(50e-9, [8e-27, 0, 0], density=2000)
            >>> f"{grain.rim_speed('1 GHz'):.2e}"
            '1.05e-06'
        """
        if self.radius is None:
            refuse("radius", "be given to the particle, which `rim_speed` needs", "is None")
        given = angular_velocity
        if not isinstance(given, str) and numbers("angular_velocity", given, ANGULAR).ndim > 0:
            squares = jnp.square(finite("angular_velocity", given, (3,), unit=ANGULAR))
            speed = safe_sqrt(jnp.sum(squares, axis=-1))
        else:
            speed = speed_in_rad("angular_velocity", given)
        return speed * (self.radius / LIGHT)


def _homogeneous(shape: shapes.Solid, dipole: Any, mass: Any, density: Any) -> Particle:
    mass = shapes.mass_of(shape, mass, density)
    return Particle(mass, shape.inertia(mass), dipole, shape=shape)
