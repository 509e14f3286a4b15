"""Friction by thermal radiation: the fluctuating dipole that the field of the bath induces."""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.guards import safe_sqrt
from .._base.types import Vector
from ..particles import Particle
from ..particles.units import BOLTZMANN, HBAR, LIGHT
from .surrounding import Surrounding, diagonal_matrix, solid_of, with_lanes, zero_or_more

ZETA_3 = 1.202_056_903_159_594_2
"""ζ(3)."""
HIGHEST = 60.0  # ħω/kT beyond which the thermal spectrum is below 1e-22 of its maximum
LOWEST = 1e-6
PANELS, ORDER = 160, 8  # of the quadrature over ln ω


class Blackbody(Surrounding):
    """Thermal radiation of the temperature of the body, for a body small beside the wavelength.

        Γ = (8ħ²/(3πc³kT)) ∫ω³ Im α n(n + 1) dω = (16ζ(3)/π) χ (3V/4π)(kT)³/(c³ħ²),

    with the Bose factor n and the polarisability α (Gaussian units); the latter if Im α is χ times
    3V/4π at all frequencies. It holds for ħΩ ≪ kT, and counts a body that is no sphere as one of
    its volume.

    Args:
        temperature: T of the body and of the field, K.
        loss: χ = Im[(ε − 1)/(ε + 2)], about 0.1 for silica in the infrared; or a function that
            returns Im α in m³ for an array of angular frequencies ω in rad/s.

    Raises:
        ValueError: a temperature or a χ that is negative or not finite.
    """

    temperature: Float[Array, "..."]
    loss: Float[Array, "..."] | Callable[[Any], Any]
    name: ClassVar[str] = "blackbody"

    def __init__(self, temperature: Any, loss: Any) -> None:
        self.temperature = zero_or_more("temperature", temperature, "K")
        self.loss = loss if callable(loss) else zero_or_more("loss", loss)

    def friction(self, particle: Particle) -> Float[Array, "..."]:
        """Return Γ, the same about every axis, N m s."""
        energy = BOLTZMANN * self.temperature
        if callable(self.loss):
            return _by_polarisability(self.loss, energy)
        volume = solid_of(particle, "the absorption of thermal radiation").volume
        size = 3 / (4 * math.pi) * volume
        # The factors one by one: ħ² alone is near 1e-68.
        return 16 * ZETA_3 / math.pi * self.loss * size * (energy / HBAR / LIGHT) ** 3 * HBAR

    def torque(self, particle: Particle, omega: Vector) -> Vector:
        """Compute −ΓΩ, shape (3, ...), N m."""
        return -with_lanes(self.friction(particle), 0, 1, omega) * omega

    def noise(self, particle: Particle, omega: Vector) -> Float[Array, "3 3 ..."]:
        """Compute G = √(2kTΓ), the same about every axis and for every Ω."""
        size = safe_sqrt(2 * BOLTZMANN * self.temperature * self.friction(particle))
        return diagonal_matrix([with_lanes(size, 0, 0, omega)] * 3)


def _by_polarisability(of: Callable[[Any], Any], energy: Float[Array, "..."]) -> Array:
    """Compute Γ from Im α(ω), with x = ħω/kT from `LOWEST` to `HIGHEST`."""
    nodes, weights = np.polynomial.legendre.leggauss(ORDER)
    edges = np.linspace(math.log(LOWEST), math.log(HIGHEST), PANELS + 1)
    half = (edges[1] - edges[0]) / 2
    x = np.exp(np.add.outer(edges[:-1] + half, half * nodes).ravel())
    weight = np.tile(half * weights, PANELS) * x**4 / (4 * np.sinh(x / 2) ** 2)  # x³n(n + 1)dx
    omega = energy[..., None] / HBAR * x
    cube = (energy / HBAR / LIGHT) ** 3
    return 8 * HBAR / (3 * math.pi) * cube * jnp.sum(weight * of(omega), axis=-1)
