"""Particles in SI or Gaussian units, and their conversion to the dimensionless library.

The unit of inertia is I₁, the transverse moment of an axisymmetric body, and the unit of time is
τ₀ = k d²/I₁ with k = 1/(6πε₀c³). In these units |d| = 1, an angular velocity Ω is ω = τ₀Ω, and a
time t is τ = t/τ₀. An axis of rotation may define another I₁, the moment about it.
"""

from . import shapes
from .particle import Particle
from .starts import start
from .table import Rotator, Row, paper_particles, particle_table
from .units import DEBYE, RADIATION, STATCOULOMB_CM, angular_speed, magnetic_dipole

__all__ = [
    "DEBYE",
    "RADIATION",
    "STATCOULOMB_CM",
    "Particle",
    "Rotator",
    "Row",
    "angular_speed",
    "magnetic_dipole",
    "paper_particles",
    "particle_table",
    "shapes",
    "start",
]
