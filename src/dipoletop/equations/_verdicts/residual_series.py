"""ω∞ of the transverse top as a power series, from a state near the residual line.

ω∞ is constant along a trajectory. With T = ω₂/ω₁, Z = ω₃/ω₁², v = ω₁² and dσ = v dτ, ω₁′ = δω₂ω₃
is d ln ω₁/dσ = δTZ, and (T, Z)_σ is a linear part L(T, Z) and terms from the third power on. Put
ω∞ = ω₁(1 + Q₂ + Q₄ + …), Qₙ homogeneous of degree n in (T, Z). Then dω∞/dσ = 0 gives in turn

    L(T, Z)·∇Q₂ = −δTZ,    L(T, Z)·∇Q₄ = −δTZ Q₂ − (dQ₂/dσ by the cubic terms and v_σ = 2δTZ v),

linear equations for the coefficients of each Qₙ. With β = (1+2δ)/(1−δ), D = 1−δ+4v and
b = 2v−δ(1−δ)

    order 1:       L = [[−1, −δ], [0, −β]], a triangular system for the coefficients;
    semi-reduced:  D L = [[−(1−δ), b], [−2, −(1+2δ)]], a tridiagonal system for Q₄.

At the other levels Q₂ follows from their linear part, and the semi-reduced Q₄ holds up to O(v).

Errors are estimated by the size of the next term, with factors fitted to samples: on 25 000 random
states of each level they bound the true errors, except for 2 in 10 000 at order 1, where they are
too small by less than a factor 2.
"""

import jax.numpy as jnp

from ..._base.guards import safe_divisor
from ..._base.linalg import components
from ..._base.types import Real, Vector
from ..levels import Level
from .residual_line import linear_part, quadratic_form, rescaled, solve_lyapunov

LEVEL_GAP = 20.0  # factor of the difference of Q₄ between the levels
SLOPE = 30.0  # factor of the errors of the derivatives

Series = tuple[Real, Real, Real]
"""ω∞, its relative error, and the relative error of its derivatives by δ, T and Z."""


def line_coordinates(w: Vector) -> tuple[Real, Real, Real]:
    """Compute T, Z and v = ω₁²."""
    w1, w2, w3 = components(w)
    divisor = safe_divisor(w1)
    return w2 / divisor, w3 / divisor**2, w1**2


def first_order(d: Real, w: Vector) -> Series:
    """Return ω∞ and its errors at order 1, −1/2 < δ < 1."""
    t, z, v = line_coordinates(w)
    d = jnp.where(d > -0.5, d, 0.0)
    beta, m = (1 + 2 * d) / (1 - d), 1 + d + d**2
    b = d / (1 + beta)
    c = -(d**2) / (2 * beta * (1 + beta))
    q1 = -2 * b / (3 + beta)
    q2 = -(2 * d * b + 2 * c + 3 * d * q1) / (2 + 2 * beta)
    q3 = -(3 * d * c + b * v * (m + 1 / (1 - d)) + 2 * d * q2) / (1 + 3 * beta)
    q4 = -(2 * c * v / (1 - d) + d * q3) / (4 * beta)
    quartic = t**3 * q1 + z * (t**2 * q2 + z * (t * q3 + z * q4))
    omega_inf = components(w)[0] * (1 + z * (t * b + z * c + quartic))
    quadratic = jnp.abs(b * t * z) + jnp.abs(c) * z**2
    size = t**2 / (2 + beta) + d**2 * z**2 / (beta * (1 + beta / 8))
    size = size + v * z**2 / (1.5 * (1 + 2 * d))
    return omega_inf, 35 * quadratic * size**2, _slope_error(size, z)


def semi_reduced(d: Real, w: Vector, k: Real) -> Series:
    """Return ω∞ and its errors at the semi-reduced level, −1 < δ < 1, with k = δ/(2+δ)."""
    t, z, v = line_coordinates(w)
    b, det = 2 * v - d * (1 - d), 1 - d + 4 * v
    q2 = -(1 + 2 * d) * t**2 + (1 - d) * (1 + 2 * d) * t * z + (1 - d) * b * z**2 / 2
    right_side = [
        jnp.zeros_like(b),
        -k * (4 * d**2 + d - 2) * det,
        k * d * (1 - d) * (1 + 5 * d) * det,
        -k / 2 * det * (2 * v * (d + 2) * (d**2 - d - 1) + 3 * d**2 * (1 - d) ** 2),
        -k * d * (1 - d) * v * det,
    ]
    q = _solve_tridiagonal(d, b, right_side)
    quartic = t**4 * q[0] + z * (t**3 * q[1] + z * (t**2 * q[2] + z * (t * q[3] + z * q[4])))
    omega_inf = components(w)[0] * (1 + k * q2 + quartic)
    size = (t**2 + (v + d**2) * z**2) * (1 + 2 * jnp.abs(d) * v)
    return omega_inf, 2.5 * _quadratic_size(d, k, (t, z, v)) * size**2, _slope_error(size, z)


def quadratic_term(d: Real, w: Vector, level: Level) -> Real:
    """Return Q₂ of a level, from the linear part of its motion across the residual line."""
    t, z, v = line_coordinates(w)
    mu, zero = jnp.sqrt(v), jnp.zeros_like(d * v)
    linear = rescaled(linear_part(1 + zero, 1 - d, mu, level), mu)
    return quadratic_form(solve_lyapunov(linear, (zero, d * mu / 2, zero)), (t, z))


def higher_order(d: Real, w: Vector, q2: Real) -> Series:
    """Return ω∞ and its errors at a level whose Q₂ is `q2`, with the semi-reduced Q₄."""
    t, z, v = line_coordinates(w)
    k = d / (2 + d)
    omega_inf, error, slope = semi_reduced(d, w, k)
    omega_inf = omega_inf + components(w)[0] * (q2 - quadratic_term(d, w, Level.SEMI))
    size = t**2 + (v + d**2) * z**2
    gap = LEVEL_GAP * v / (1 - d) ** 2 * size
    slope = slope + SLOPE * gap * jnp.sqrt(size) * (1 + jnp.abs(z))
    return omega_inf, error + gap * _quadratic_size(d, k, (t, z, v)), slope


def full(w: Vector, q2: Real) -> Series:
    """Return ω∞ and its errors on the physical branch at any amplitude: Q₂ only."""
    t, z, v = line_coordinates(w)
    size = t**2 + v * z**2 + z**2
    return components(w)[0] * (1 + q2), LEVEL_GAP * size**2, SLOPE * size * jnp.sqrt(size)


def _slope_error(size: Real, z: Real) -> Real:
    """Return the part of a derivative that comes from the sixth power of (T, Z)."""
    return SLOPE * size**2 * jnp.sqrt(size) * (1 + jnp.abs(z))


def _quadratic_size(d: Real, k: Real, place: tuple[Real, Real, Real]) -> Real:
    """Return the sum of the sizes of the terms of Q₂ at the semi-reduced level, at (T, Z, v)."""
    t, z, v = place
    a = jnp.abs(d)
    along = (1 - d) * (2 * v + a * (1 - d)) * z**2 / 2
    return jnp.abs(k) * ((1 + a) * t**2 + (1 - d) * jnp.abs(t * z) + along)


def _solve_tridiagonal(d: Real, b: Real, right_side: list[Real]) -> list[Real]:
    """Solve A q = r for the coefficients qᵢ of T⁴⁻ⁱZⁱ in Q₄, by elimination without pivoting.

    Aᵢᵢ = −(4−i)(1−δ) − i(1+2δ), Aᵢ,ᵢ₋₁ = (5−i)b, Aᵢ,ᵢ₊₁ = −2(i+1). The pivots never vanish.
    """
    diagonal = [-(4 - i) * (1 - d) - i * (1 + 2 * d) for i in range(5)]
    pivots, sums = [diagonal[0]], [right_side[0]]
    for i in range(1, 5):
        factor = (5 - i) * b / pivots[-1]
        pivots.append(diagonal[i] + 2 * i * factor)
        sums.append(right_side[i] - factor * sums[-1])
    q = [sums[4] / pivots[4]]
    for i in range(3, -1, -1):
        q.append((sums[i] + 2 * (i + 1) * q[-1]) / pivots[i])
    return q[::-1]
