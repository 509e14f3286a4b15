"""Radiation reaction, and the thermal field that belongs to it.

In a bath of temperature T the dipole feels the field of the thermal radiation, too. For kT ≫ ħΩ
that field is E = −Ȧ with white noise A of the strength 2kTk, and only P = L + d×A varies smoothly.
In body axes, with Ω = I⁻¹P and d₁ = Ω×d,

    dP = P×Ω + friction + B·dA,    B·A = d₁×A − P×I⁻¹(d×A),

so that Ω·B·A = d₂·A: the noise heats as much as the dipole radiates, D = kTk BBᵀ. The friction
−DΩ/kT = −kB·d₂ is the radiation torque of first order in k, up to the difference k d×d₂ between L
and P.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.linalg import cross, inverse, matvec, trace
from .._base.types import Matrix, Vector
from ..particles import RADIATION, Particle
from ..particles.units import BOLTZMANN
from .surrounding import Surrounding, with_lanes, zero_or_more


class RadiationReaction(Surrounding):
    """The radiation of the dipole of the body itself, in a bath of temperature T.

    The torque is −k d₁×d₂, the mean rate at which radiation carries off angular momentum.

    Args:
        temperature: T of the thermal radiation, K; 0 for no noise.
    """

    temperature: Float[Array, "..."]
    name: ClassVar[str] = "radiation"

    def __init__(self, temperature: Any = 0.0) -> None:
        self.temperature = zero_or_more("temperature", temperature, "K")

    def torque(self, particle: Particle, omega: Vector) -> Vector:
        """Compute −k d₁×d₂ for the free rotation through Ω, shape (3, ...), N m."""
        d, momentum = with_lanes(particle.dipole, 1, 1, omega), matvec(particle.inertia, omega)
        first, second = dipole_derivatives(_inverse(particle), d, momentum)
        return -RADIATION * cross(first, second)

    def noise(self, particle: Particle, omega: Vector) -> Float[Array, "3 3 ..."]:
        """Compute G = √(2kTk) B, with B of the module docstring."""
        d, momentum = with_lanes(particle.dipole, 1, 1, omega), matvec(particle.inertia, omega)
        units = with_lanes(jnp.eye(3), 2, 2, omega)
        columns = [impulse(_inverse(particle), d, momentum, unit) for unit in units]
        size = jnp.sqrt(2 * BOLTZMANN * self.temperature * RADIATION)
        return with_lanes(size, 0, 2, omega) * jnp.stack(columns, axis=1)


def dipole_derivatives(inverted: Matrix, d: Vector, momentum: Vector) -> tuple[Vector, Vector]:
    """Compute d₁ = Ω×d and d₂ = Ω×d₁ + Ω̇×d in free rotation, Ω = I⁻¹P and Ω̇ = I⁻¹(P×Ω)."""
    omega = matvec(inverted, momentum)
    first, change = cross(omega, d), matvec(inverted, cross(momentum, omega))
    return first, cross(omega, first) + cross(change, d)


def impulse(inverted: Matrix, d: Vector, momentum: Vector, a: Vector) -> Vector:
    """Compute B(P)a = (Ω×d)×a − P×I⁻¹(d×a)."""
    first = cross(matvec(inverted, momentum), d)
    return cross(first, a) - cross(momentum, matvec(inverted, cross(d, a)))


def _inverse(particle: Particle) -> Matrix:
    """Return I⁻¹."""
    unit = trace(particle.inertia)  # in SI units the determinant would be near 1e-120
    return inverse(particle.inertia / unit) / unit
