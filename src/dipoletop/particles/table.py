"""Particles with an axis of rotation, such as the paper's, and their table."""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._base.checks import instance
from .particle import Particle
from .units import CHARGE, DEBYE


class Rotator(NamedTuple):
    """A particle and its axis of rotation."""

    name: str
    particle: Particle
    axis: tuple[float, float, float]
    """The axis of rotation in body axes, across the dipole."""


class Row(NamedTuple):
    """A row of `particle_table`."""

    name: str
    mass: float
    """The mass, kg."""
    moment: float
    """The moment of inertia about the axis of rotation, kg m²."""
    debye: float
    """Dipole moment |d|, debye."""
    tau0: float
    """τ₀, s."""
    braking_time: float
    """T = 1/(τ₀Ω₀²), s."""


def paper_particles() -> tuple[Rotator, ...]:
    """Return the particles of the paper's conclusions, each with its axis of rotation.

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
    silica = Particle.sphere(50 * nm, 50 * nm * CHARGE * x, mass=1e-18)
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
    """Compute τ₀ = k d²/I and T = 1/(τ₀Ω₀²) of each rotator, as Python numbers.

    Args:
        rotators: particles with their axes, such as `paper_particles()`.
        speed: Ω₀, rad/s, or a text such as "1 GHz", which is the default.

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
