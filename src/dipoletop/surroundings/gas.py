"""The drag by a rarefied gas, and its noise.

A surface element that moves with the velocity u through a gas of pressure p feels the force

    −Φ[α u_t + aₙ u_n n],  Φ = p√(m/(2πkT)),  aₙ = α(2 + (π/2)√(T_s/T)) + 4(1 − α)

on its area, where α is the share of molecules that leave diffusely, with the temperature T_s of the
surface; the others are reflected. About body axis i this makes the friction Γ and, since impacts
are independent, the strength 2D of the noise,

    Γ = Φ∫[α(r² − rᵢ²) + (aₙ − α)(r×n)ᵢ²]dA,    2D = Φk∫[s_t(r² − rᵢ²) + (sₙ − s_t)(r×n)ᵢ²]dA,
    s_t = α(T + T_s),    sₙ = α(2T + 2T_s + π√(TT_s)) + 8(1 − α)T,

which is 2kTΓ for T_s = T.

Sources: P. S. Epstein, Phys. Rev. 23 (1924) 710, for the sphere; the mean square impulses follow
from Maxwell's distribution of the velocities that arrive at a surface, and of those that leave.
"""

import math
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import on_host, where_valid
from .._base.guards import safe_sqrt
from .._base.types import Vector
from ..particles import Particle
from ..particles.units import BOLTZMANN, DALTON
from .surrounding import (
    Surrounding,
    above_zero,
    diagonal_matrix,
    solid_of,
    with_lanes,
    zero_or_more,
)

AIR = 28.97 * DALTON
"""The mean mass of the molecules of air, kg."""
AIR_DIAMETER = 3.7e-10
"""The diameter of the molecules of air for collisions among them, m."""


class Gas(Surrounding):
    """A gas so thin that its molecules hit the body, but not each other, near it.

    Args:
        pressure: p, Pa.
        temperature: T, K.
        molecular_mass: m, kg; by default of air.
        accommodation: α, the share of the molecules that leave diffusely, from 0 to 1.
        surface_temperature: T_s, K; None means T.
        diameter: the diameter of a molecule, m, from which the mean free path follows.

    Raises:
        ValueError: a negative pressure, an accommodation outside of 0 … 1, another number that is
            not positive.
    """

    pressure: Float[Array, "..."]
    temperature: Float[Array, "..."]
    molecular_mass: Float[Array, "..."]
    accommodation: Float[Array, "..."]
    surface_temperature: Float[Array, "..."]
    diameter: Float[Array, "..."]
    name: ClassVar[str] = "gas"

    def __init__(
        self,
        pressure: Any,
        temperature: Any = 300.0,
        *,
        molecular_mass: Any = AIR,
        accommodation: Any = 1.0,
        surface_temperature: Any = None,
        diameter: Any = AIR_DIAMETER,
    ) -> None:
        self.pressure = zero_or_more("pressure", pressure, "Pa")
        self.temperature = above_zero("temperature", temperature, "K")
        self.molecular_mass = above_zero("molecular_mass", molecular_mass, "kg")
        share = zero_or_more("accommodation", accommodation)
        below_one = on_host(share) <= 1
        self.accommodation = where_valid("accommodation", share, below_one, "be at most 1")
        self.surface_temperature = self.temperature
        if surface_temperature is not None:
            self.surface_temperature = above_zero("surface_temperature", surface_temperature, "K")
        self.diameter = above_zero("diameter", diameter, "m")

    @property
    def mass_flux(self) -> Float[Array, "..."]:
        """Φ = p√(m/(2πkT)), the mass that arrives per area and time, kg/(m² s)."""
        thermal = 2 * math.pi * BOLTZMANN * self.temperature
        return self.pressure * jnp.sqrt(self.molecular_mass / thermal)

    @property
    def mean_free_path(self) -> Float[Array, "..."]:
        """λ = kT/(√2 π d²p), m; infinite in a vacuum."""
        cross_section = math.sqrt(2) * math.pi * self.diameter**2
        return BOLTZMANN * self.temperature / (cross_section * self.pressure)

    def friction(self, particle: Particle) -> Float[Array, "3 ..."]:
        """Return Γ about the body axes, shape (3, ...), N m s; the torque is −ΓᵢΩᵢ."""
        ratio = jnp.sqrt(self.surface_temperature / self.temperature)
        along = self.accommodation
        normal = along * (2 + math.pi / 2 * ratio) + 4 * (1 - along)
        return self._weighted(particle, along, normal)

    def torque(self, particle: Particle, omega: Vector) -> Vector:
        """Compute −ΓΩ, shape (3, ...), N m."""
        return -with_lanes(self.friction(particle), 1, 1, omega) * omega

    def noise(self, particle: Particle, omega: Vector) -> Float[Array, "3 3 ..."]:
        """Compute G = √(2D), diagonal in body axes; it does not depend on Ω."""
        t, ts, share = self.temperature, self.surface_temperature, self.accommodation
        along = share * (t + ts)
        normal = share * (2 * t + 2 * ts + math.pi * jnp.sqrt(t * ts)) + 8 * (1 - share) * t
        size = safe_sqrt(BOLTZMANN * self._weighted(particle, along, normal))
        return diagonal_matrix(with_lanes(size, 1, 1, omega))

    def _weighted(self, particle: Particle, along: Any, normal: Any) -> Float[Array, "3 ..."]:
        """Compute Φ∫[along (r² − rᵢ²) + (normal − along)(r×n)ᵢ²]dA."""
        over = solid_of(particle, "the drag by a gas").surface_integrals()
        along, normal = ((self.mass_flux * each)[None] for each in (along, normal))
        tangential, across = (values.reshape(3, *[1] * (normal.ndim - 1)) for values in over)
        return along * tangential + (normal - along) * across
