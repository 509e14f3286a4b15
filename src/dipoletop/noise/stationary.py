"""Stationary laws in closed form: a rotator in a gas and a radiation field, and a grain of dust."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.checks import ArrayLike, NumberLike, finite, not_negative, positive, shape_of
from .._base.compiling import compiled_soon
from .._base.refusals import refuse
from .._base.roots import root
from .._base.types import Real

NODES, FAR = 200, 45.0  # nodes of the quadrature, and the −ln f at its end
HALVINGS = 60
Values = Float[Array, "..."]


def rotator_density(
    omega: ArrayLike | NumberLike,
    *,
    kappa: NumberLike = 1.0,
    heat: NumberLike = 0.0,
    drag: NumberLike = 1.0,
    drag_heat: NumberLike = 1.0,
    dimensions: int = 1,
) -> Values:
    """Compute the stationary density of a rotator with I = 1, in a gas and in thermal radiation.

        ln f = −½[ω²/θ_g + (κ/Γ)(θ_g − θ)ω⁴ g(q)/θ_g²],    g = (q − ln(1 + q))/q²,
        q = κθω²/(Γθ_g),    times ω² in three dimensions,

    with θ = kT of the radiation and θ_g of the gas. It is Maxwell's law if both are equal.

    Args:
        omega: ω, of any shape; in three dimensions the speed, not negative.
        kappa: κ, so that radiation brakes at the rate κω².
        heat: θ.
        drag: Γ, positive.
        drag_heat: θ_g, positive.
        dimensions: 1 for a plane rotator or one component, −∞ < ω < ∞; or 3 for the speed of an
            isotropic rotation.

    Returns:
        The density, whose integral is 1.

    Raises:
        ValueError: a negative number, another `dimensions`.

    Example:
        >>> print(f"{rotator_density(0.0, heat=1.0) * (2 * jnp.pi) ** 0.5:.12f}")
        1.000000000000
    """
    energy = _energy(kappa, heat, drag, drag_heat)
    return _density(energy, _speed("omega", omega, dimensions), dimensions)


def mean_square(
    *,
    kappa: NumberLike = 1.0,
    heat: NumberLike = 0.0,
    drag: NumberLike = 1.0,
    drag_heat: NumberLike = 1.0,
    dimensions: int = 1,
) -> Real:
    """Compute ⟨ω²⟩ of `rotator_density`.

    Raises:
        ValueError: as for `rotator_density`.

    Example:
        >>> print(f"{mean_square(heat=0.25):.9f}")
        0.574401397
    """
    energy = _energy(kappa, heat, drag, drag_heat)
    _dimensions(dimensions)
    return _moment(energy, dimensions + 1) / _moment(energy, dimensions - 1)


def grain_density(
    speed: ArrayLike | NumberLike,
    *,
    drag: NumberLike = 1.0,
    excitation: NumberLike = 1.0,
    ratio: NumberLike = 0.0,
) -> Values:
    """Compute the stationary density of the rotation of a grain of interstellar dust.

        f ∝ y² exp[−Fy²/(2G) − τ_H y⁴/(12Gτ_ed)],    y = Ω√(I/kT),

    so that F⟨y²⟩ + (τ_H/3τ_ed)⟨y⁴⟩ = 3G.

    Args:
        speed: y, not negative, of any shape.
        drag: F, the damping over that by a gas of hydrogen.
        excitation: G, the excitation over that by such a gas.
        ratio: τ_H/τ_ed, with the time τ_ed of `emission.damping_time`.

    Returns:
        The density over y, whose integral is 1.

    Raises:
        ValueError: a number that is not positive, or a negative ratio.

    Source: B. T. Draine and A. Lazarian, Astrophys. J. 508 (1998) 157.

    Example:
        >>> print(f"{grain_density(1.0) / (2 / jnp.pi) ** 0.5 * jnp.e**0.5:.12f}")
        1.000000000000
    """
    f, g = positive("drag", drag, batch=False), positive("excitation", excitation, batch=False)
    r = not_negative("ratio", ratio, batch=False)
    return _density(Partial(_grain_energy, f, g, r), _speed("speed", speed, 3), 3)


def _grain_energy(f: Real, g: Real, r: Real, square: Values) -> Values:
    """Return −ln f of `grain_density`."""
    return f * square / (2 * g) + r * square**2 / (12 * g)


def _energy(
    kappa: NumberLike, heat: NumberLike, drag: NumberLike, drag_heat: NumberLike
) -> Callable[[Values], Values]:
    """Return −ln f of `rotator_density` as a function of ω²."""
    k, theta = not_negative("kappa", kappa, batch=False), not_negative("heat", heat, batch=False)
    gamma, warm = positive("drag", drag, batch=False), positive("drag_heat", drag_heat, batch=False)
    return Partial(_rotator_energy, k, theta, gamma, warm)


def _rotator_energy(k: Real, theta: Real, gamma: Real, warm: Real, square: Values) -> Values:
    q = k * theta * square / (gamma * warm)
    near = q < 1e-3
    safe = jnp.where(near, 1.0, q)
    series = 0.5 - q * (1 / 3 - q * (1 / 4 - q * (1 / 5 - q / 6)))
    g = jnp.where(near, series, (safe - jnp.log1p(safe)) / safe**2)
    return (square / warm + k * (warm - theta) * square**2 * g / (gamma * warm**2)) / 2


@compiled_soon
def _moment(energy: Callable[[Values], Values], power: int) -> Real:
    """Compute ∫ω^power e^{−energy}dω from 0 on."""
    end = root(lambda y: energy(jnp.exp(2 * y)) - FAR, jnp.array(-60.0), jnp.array(60.0), HALVINGS)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    x = jnp.exp(end) * (1 + nodes) / 2
    return jnp.sum(jnp.exp(end) / 2 * weights * x**power * jnp.exp(-energy(x**2)))


@compiled_soon
def _density(energy: Callable[[Values], Values], speed: Values, dimensions: int) -> Values:
    sides = 2 if dimensions == 1 else 1
    whole = sides * _moment(energy, dimensions - 1)
    return jnp.abs(speed) ** (dimensions - 1) * jnp.exp(-energy(speed**2)) / whole


def _speed(name: str, value: Any, dimensions: int) -> Values:
    _dimensions(dimensions)
    check = finite if dimensions == 1 else not_negative
    return check(name, value, shape_of(value), batch=False)


def _dimensions(value: int) -> None:
    if value not in (1, 3):
        refuse("dimensions", "be 1 or 3", f"is {value!r}")
