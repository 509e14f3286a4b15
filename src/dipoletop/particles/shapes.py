"""Homogeneous solids in SI units: volume, inertia tensor, size, and integrals over the surface."""

import abc
import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import bodies
from .._base.checks import namespace
from .._base.linalg import diagonal
from .._base.refusals import refuse
from .units import positive_si

_ANY_DIPOLE = (1.0, 0.0, 0.0)
"""The dipole of a body from which only the inertia is taken."""


class SurfaceIntegrals(NamedTuple):
    """Integrals over the surface of a solid that is symmetric about its three body axes, m⁴."""

    tangential: Float[Array, "3"]
    """∫(r² − rᵢ²)dA."""
    normal: Float[Array, "3"]
    """∫(r×n)ᵢ²dA, with the unit vector n along the normal."""


class Solid(eqx.Module):
    """A homogeneous convex solid, symmetric about each of its body axes."""

    stress_factor: eqx.AbstractClassVar[float]
    """The largest centrifugal stress over ρΩ²ℓ², with the largest half length ℓ across the axis."""

    @property
    @abc.abstractmethod
    def reach(self) -> Any:
        """The largest distance of a point from the centre, m."""

    @property
    @abc.abstractmethod
    def half_lengths(self) -> Any:
        """Half of the extent along each body axis, shape (3,), m."""

    @property
    @abc.abstractmethod
    def volume(self) -> Any:
        """The volume, m³."""

    @abc.abstractmethod
    def inertia(self, mass: Any) -> Any:
        """Return the inertia tensor of a mass in kg, kg m²."""

    @abc.abstractmethod
    def surface_integrals(self) -> SurfaceIntegrals:
        """Return the integrals over the surface on which the drag by a gas depends."""


class Sphere(Solid):
    """A sphere."""

    radius: Any
    """R, m."""
    stress_factor: ClassVar[float] = 0.4

    @property
    def reach(self) -> Any:
        """R."""
        return self.radius

    @property
    def half_lengths(self) -> Any:
        """R three times."""
        return namespace(self.radius).stack([self.radius] * 3)

    @property
    def volume(self) -> Any:
        """V = 4πR³/3."""
        return 4 * math.pi / 3 * self.radius**2 * self.radius

    def inertia(self, mass: Any) -> Any:
        """Compute I = 2mR²/5."""
        return bodies.spheroid(mass, self.radius, self.radius, dipole=_ANY_DIPOLE).inertia

    def surface_integrals(self) -> SurfaceIntegrals:
        """Compute ∫(r² − rᵢ²)dA = 8πR⁴/3; r×n = 0."""
        fourth = 8 * math.pi / 3 * self.half_lengths**4
        return SurfaceIntegrals(fourth, jnp.zeros_like(fourth))


class Ellipsoid(Solid):
    """An ellipsoid with its semi-axes along the body axes."""

    semi_axes: Any
    """a, b, c, m."""
    stress_factor: ClassVar[float] = 0.4

    @property
    def half_lengths(self) -> Any:
        """The semi-axes, m."""
        return self.semi_axes

    @property
    def reach(self) -> Any:
        """The largest semi-axis, m."""
        return self.semi_axes.max()

    @property
    def volume(self) -> Any:
        """V = 4πabc/3."""
        a, b, c = self.semi_axes
        return 4 * math.pi / 3 * a * b * c

    def inertia(self, mass: Any) -> Any:
        """Compute I = m/5 diag(b² + c², c² + a², a² + b²)."""
        a, b, c = mass * self.semi_axes**2 / 5
        return diagonal(b + c, c + a, a + b)

    def surface_integrals(self) -> SurfaceIntegrals:
        """Integrate over an octant; r = Ds and dA = abc|D⁻¹s| for s on the unit sphere."""
        octant, weights = _octant()
        squares = self.semi_axes[:, None] ** 2
        unit = jnp.max(squares)
        stretch = jnp.sqrt(jnp.sum(octant / (squares / unit), axis=0, keepdims=True))
        area = self.volume * 6 / math.pi / jnp.sqrt(unit) * weights * stretch  # 8abc = 6V/π
        points = squares * octant
        across = jnp.sum(points, axis=0, keepdims=True) - points
        tangential = jnp.sum(area * across, axis=1)
        # (r×n)ᵢ = (D s × D⁻¹s)ᵢ/|D⁻¹s| = (j/k − k/j) sⱼsₖ/|D⁻¹s|
        j, k = (jnp.roll(squares, -shift, axis=0) for shift in (1, 2))
        sj, sk = (jnp.roll(octant, -shift, axis=0) for shift in (1, 2))
        skew = (j - k) ** 2 / (j * k) * unit
        return SurfaceIntegrals(tangential, jnp.sum(area / stretch**2 * skew * sj * sk, axis=1))


class Cuboid(Solid):
    """A cuboid with its edges along the body axes."""

    lengths: Any
    """The edges, m."""
    stress_factor: ClassVar[float] = 0.5

    @property
    def half_lengths(self) -> Any:
        """Half of each edge, m."""
        return self.lengths / 2

    @property
    def reach(self) -> Any:
        """Half of the diagonal, m."""
        return namespace(self.lengths).linalg.norm(self.lengths) / 2

    @property
    def volume(self) -> Any:
        """V = l₁l₂l₃."""
        return self.lengths.prod()

    def inertia(self, mass: Any) -> Any:
        """Compute I₁ = m(l₂² + l₃²)/12, and so on."""
        return bodies.box(mass, self.lengths, _ANY_DIPOLE).inertia

    def surface_integrals(self) -> SurfaceIntegrals:
        """Sum over pairs of faces; that across l₁ has the area l₂l₃."""
        squares = self.lengths**2
        faces = self.volume / self.lengths  # the area of one face of each pair
        # Over the two faces across axis j: ∫rₖ²dA = face·lₖ²/2 for k = j, else face·lₖ²/6.
        moments = faces[:, None] * squares[None] / 6 * jnp.where(jnp.eye(3) > 0, 3.0, 1.0)
        by_axis = jnp.sum(moments, axis=0)
        tangential = jnp.sum(by_axis) - by_axis
        # (r×n)ᵢ² on the faces across j is rₖ², with i, j, k different.
        (f1, f2, f3), (a, b, c) = faces / 6, squares
        normal = jnp.stack([f2 * c + f3 * b, f3 * a + f1 * c, f1 * b + f2 * a])
        return SurfaceIntegrals(tangential, normal)


class Cylinder(Solid):
    """A cylinder about the third body axis."""

    length: Any
    """l, m."""
    radius: Any
    """r, the radius of its circles, m."""
    stress_factor: ClassVar[float] = 0.5

    @property
    def half_lengths(self) -> Any:
        """r, r and l/2, m."""
        xp = namespace(self.length, self.radius)
        return xp.stack([self.radius, self.radius, self.length / 2])

    @property
    def reach(self) -> Any:
        """√(l²/4 + r²), m."""
        return namespace(self.length, self.radius).hypot(self.length / 2, self.radius)

    @property
    def volume(self) -> Any:
        """V = πr²l."""
        return math.pi * self.radius**2 * self.length

    def inertia(self, mass: Any) -> Any:
        """Compute I₃ = mr²/2, I₁ = I₂ = m(3r² + l²)/12."""
        return bodies.rod(mass, self.length, self.radius, dipole=_ANY_DIPOLE).inertia

    def surface_integrals(self) -> SurfaceIntegrals:
        """Sum over the curved surface and the two circles."""
        length, r = self.length, self.radius
        curved, circles = 2 * math.pi * r * length, 2 * math.pi * r**2
        about = curved * r**2 + circles * r**2 / 2
        across = curved * (r**2 / 2 + length**2 / 12) + circles * (r**2 + length**2) / 4
        normal = curved * length**2 / 24 + circles * r**2 / 4
        zero = jnp.zeros_like(normal)
        return SurfaceIntegrals(
            jnp.stack([across, across, about]), jnp.stack([normal, normal, zero])
        )


NODES = 96  # of the double exponential rule on each of two angles
REACH = 3.4  # of its parameter: weights are below 1e-18 beyond


def _octant() -> tuple[Float[np.ndarray, "3 n"], Float[np.ndarray, "1 n"]]:
    """Return s₁², s₂², s₃² and weights for integrals over an octant of the unit sphere.

    The nodes crowd at the edges of the octant, where integrands of long or flat ellipsoids peak.
    """
    t = np.linspace(-REACH, REACH, NODES)
    y = math.pi * np.sinh(t)
    # x = 1/(1 + e^{−y}) from 0 to 1, 1 − x, and dx
    x, rest = 1 / (1 + np.exp(-y)), 1 / (1 + np.exp(y))
    weight = x * rest * math.pi * np.cosh(t) * (t[1] - t[0])
    height, ring = x**2, rest * (1 + x)  # u² and 1 − u², u = cos ϑ
    cosine, sine = np.sin(math.pi / 2 * rest) ** 2, np.sin(math.pi / 2 * x) ** 2
    factors = (ring, cosine), (ring, sine), (height, np.ones_like(x))
    squares = np.stack([np.multiply.outer(*pair) for pair in factors])
    return squares.reshape(3, -1), np.multiply.outer(weight, weight * math.pi / 2).reshape(1, -1)


def sphere(radius: Any) -> Sphere:
    """Return a sphere of a positive radius."""
    return Sphere(positive_si("radius", radius, "m"))


def spheroid(a: Any, c: Any) -> Solid:
    """Return the spheroid with semi-axes a, a, c."""
    a, c = positive_si("a", a, "m"), positive_si("c", c, "m")
    return Ellipsoid(namespace(a, c).stack([a, a, c]))


def ellipsoid(semi_axes: Any) -> Ellipsoid:
    """Return the ellipsoid with its semi-axes along the body axes."""
    return Ellipsoid(positive_si("semi_axes", semi_axes, "m", (3,)))


def cuboid(lengths: Any) -> Cuboid:
    """Return the cuboid with its edges along the body axes."""
    return Cuboid(positive_si("lengths", lengths, "m", (3,)))


def cylinder(length: Any, radius: Any) -> Cylinder:
    """Return the cylinder about the third axis."""
    return Cylinder(positive_si("length", length, "m"), positive_si("radius", radius, "m"))


def mass_of(shape: Solid, mass: Any, density: Any) -> Any:
    """Return the mass that is given, or that follows from the density, kg."""
    if (mass is None) == (density is None):
        was = "neither is" if mass is None else "both are"
        refuse("mass", "be given or else `density`", was)
    if mass is None:
        return shape.volume * positive_si("density", density, "kg/m**3")
    return positive_si("mass", mass, "kg")
