"""Homogeneous solids in SI units: their mass, inertia tensor and radius by formula."""

import math
from typing import Any

from .. import bodies
from .._base.checks import namespace, refuse
from .._base.linalg import diagonal
from .units import positive_si

_ANY_DIPOLE = (1.0, 0.0, 0.0)
"""The dipole of a body from which only the inertia is taken."""


Solid = dict[str, Any]
"""The `mass`, the `inertia` and the `radius`, the largest distance of a point from the centre."""


def spheroid(a: Any, c: Any, mass: Any, density: Any) -> Solid:
    """Return the spheroid with semi-axes a, a, c."""
    a, c = positive_si("a", a, "m"), positive_si("c", c, "m")
    mass = _mass(4 * math.pi / 3 * a**2 * c, mass, density)
    inertia = bodies.spheroid(mass, a, c, dipole=_ANY_DIPOLE).inertia
    return Solid(mass=mass, inertia=inertia, radius=namespace(a, c).maximum(a, c))


def ellipsoid(semi_axes: Any, mass: Any, density: Any) -> Solid:
    """Return the ellipsoid with its semi-axes along the body axes."""
    semi_axes = positive_si("semi_axes", semi_axes, "m", (3,))
    mass = _mass(4 * math.pi / 3 * semi_axes.prod(), mass, density)
    a, b, c = mass * semi_axes**2 / 5
    return Solid(mass=mass, inertia=diagonal(b + c, c + a, a + b), radius=semi_axes.max())


def cuboid(lengths: Any, mass: Any, density: Any) -> Solid:
    """Return the cuboid with its edges along the body axes."""
    lengths = positive_si("lengths", lengths, "m", (3,))
    mass = _mass(lengths.prod(), mass, density)
    inertia = bodies.box(mass, lengths, _ANY_DIPOLE).inertia
    return Solid(mass=mass, inertia=inertia, radius=namespace(lengths).linalg.norm(lengths) / 2)


def rod(length: Any, radius: Any, mass: Any, density: Any) -> Solid:
    """Return the cylinder about the third axis."""
    length, radius = positive_si("length", length, "m"), positive_si("radius", radius, "m")
    mass = _mass(math.pi * radius**2 * length, mass, density)
    inertia = bodies.rod(mass, length, radius, dipole=_ANY_DIPOLE).inertia
    largest = namespace(length, radius).hypot(length / 2, radius)
    return Solid(mass=mass, inertia=inertia, radius=largest)


def _mass(volume: Any, mass: Any, density: Any) -> Any:
    """Return the mass that is given, or that follows from the density, kg."""
    if (mass is None) == (density is None):
        was = "neither is" if mass is None else "both are"
        refuse("mass", "be given or else `density`", was)
    if mass is None:
        return volume * positive_si("density", density, "kg/m**3")
    return positive_si("mass", mass, "kg")
