"""The linear motion near the residual line Ω = w n along the dipole, and the limit of w.

In the frame (n, a, b) of the dipole (`dipole_frame`), n a principal axis, x = (x_a, x_b) are the
components across n. Moments are in units of J_d: a = J_a/J_d, b = J_b/J_d, I⊥ = diag(a, b). With
times in 1/|w|, y = (x_a, ±x_b)/|w| with the sign of w (a reflection of the body that keeps the
dipole) and μ = |d|²|w|/J_d the equation of motion, linear in y, is

    I⊥y′ = I⊥ℓ₀y + μ(−y + y″ + 2n×y′),   ℓ₀ = [[0, (b−1)/a], [(1−a)/b, 0]]:

gyroscopic torque and radiation torque. On physical motions y′ = ℓy and y″ = ℓ²y, so that
(I⊥ − 2μ n× − μℓ)ℓ = I⊥ℓ₀ − μ at the full level. The reduced levels insert the ℓ of the order below
(ℓ₀ at first) into both terms, the semi-reduced level inserts ℓ₀ into ℓ² only.

As w′/w = g y_a y_b exactly, g = a − b, the limit of w follows from ∫y_a y_b. Let S solve
ℓᵀS + Sℓ = −g [[0, 1], [1, 0]]/2; then w(1 + yᵀSy) is constant up to the fourth power of y, and

    w∞ = w(1 + yᵀSy) + O(y⁴).
"""

from typing import Any

import jax
import jax.numpy as jnp

from ..._base.guards import safe_divisor, safe_sqrt
from ..._base.types import Real
from ..levels import Level

Matrix2 = tuple[Real, Real, Real, Real]
"""A 2×2 matrix, by rows."""
Symmetric2 = tuple[Real, Real, Real]
"""A symmetric 2×2 matrix: its elements 11, 12 and 22."""

ITERATIONS = 30  # iterations towards the fixed point ℓ of the full level


def linear_part(a: Real, b: Real, mu: Real, level: Level) -> Matrix2:
    """Return the matrix ℓ(μ) of the linear motion across the residual line, without runaways.

    Args:
        a: J_a/J_d.
        b: J_b/J_d.
        mu: μ = |d|²|w|/J_d.
        level: the level of the equation of motion.
    """
    if level is Level.FULL:
        return _slow_solvent(a, b, mu)
    free = ((b - 1) / a, -(a - 1) / b)
    both = free[0] * free[1]
    if level is Level.SEMI:
        # (I⊥ − 2μ n×) ℓ = I⊥ℓ₀ + μ(−1 + ℓ₀²)
        drag, inverse = mu * (both - 1), 1 / (a * b + 4 * mu**2)
        up, down = b - 1, 1 - a
        return (
            (b * drag - 2 * mu * down) * inverse,
            (b * up - 2 * mu * drag) * inverse,
            (a * down + 2 * mu * drag) * inverse,
            (a * drag + 2 * mu * up) * inverse,
        )
    in_a, in_b = mu * (1 / a), mu * (1 / b)  # 1/a and 1/b depend on the body alone
    l11, l12, l21, l22 = jnp.zeros_like(both), free[0], free[1], jnp.zeros_like(both)
    for _ in range(level.order or 0):
        product, trace = l12 * l21, l11 + l22
        l11, l12, l21, l22 = (
            in_a * (l11**2 + product - 1 - 2 * l21),
            free[0] + in_a * (l12 * trace - 2 * l22),
            free[1] + in_b * (l21 * trace + 2 * l11),
            in_b * (l22**2 + product - 1 + 2 * l12),
        )
    return l11, l12, l21, l22


def _slow_solvent(a: Real, b: Real, mu: Real) -> Matrix2:
    """Compute the ℓ of the full equation, by ℓ ← (I⊥ − 2μ n× − μℓ)⁻¹(I⊥ℓ₀ − μ) from ℓ = 0.

    The iteration finds the solvent with the small eigenvalues, without runaways.
    """

    def iterate(_: Any, m: Matrix2) -> Matrix2:
        l11, l12, l21, l22 = m
        m11, m12, m21, m22 = a - mu * l11, mu * (2 - l12), -mu * (2 + l21), b - mu * l22
        det = safe_divisor(m11 * m22 - m12 * m21)
        return (
            (-mu * m22 - (1 - a) * m12) / det,
            ((b - 1) * m22 + mu * m12) / det,
            (mu * m21 + (1 - a) * m11) / det,
            (-(b - 1) * m21 - mu * m11) / det,
        )

    zero = jnp.zeros_like(a * b * mu)
    # Fully unrolled, a second derivative compiles for minutes, as in
    # https://github.com/jax-ml/jax/issues/2777.
    return jax.lax.fori_loop(0, ITERATIONS, iterate, (zero, zero, zero, zero), unroll=5)


def solve_lyapunov(m: Matrix2, q: Symmetric2) -> Symmetric2:
    """Compute P of MᵀP + PM = −Q: [det M · Q + adj(M)ᵀ Q adj(M)] / (−2 tr M det M)."""
    m11, m12, m21, m22 = m
    q11, q12, q22 = q
    det = m11 * m22 - m12 * m21
    inverse = 1 / safe_divisor(-2 * (m11 + m22) * det)
    return (
        ((det + m22**2) * q11 - 2 * m21 * m22 * q12 + m21**2 * q22) * inverse,
        (-m12 * m22 * q11 + 2 * m11 * m22 * q12 - m11 * m21 * q22) * inverse,
        (m12**2 * q11 - 2 * m11 * m12 * q12 + (det + m11**2) * q22) * inverse,
    )


def least_decay(m: Matrix2, p: Symmetric2) -> Real:
    """Return the smallest eigenvalue of −(MᵀP + PM)."""
    m11, m12, m21, m22 = m
    return extreme_eigenvalues(
        (
            -2 * (p[0] * m11 + p[1] * m21),
            -(p[0] * m12 + p[1] * (m11 + m22) + p[2] * m21),
            -2 * (p[1] * m12 + p[2] * m22),
        )
    )[0]


def extreme_eigenvalues(p: Symmetric2) -> tuple[Real, Real]:
    """Return the smallest and the largest eigenvalue of a symmetric matrix."""
    mean, spread = (p[0] + p[2]) / 2, safe_sqrt((p[0] - p[2]) ** 2 / 4 + p[1] ** 2)
    return mean - spread, mean + spread


def quadratic_form(p: Symmetric2, y: tuple[Real, Real]) -> Real:
    """Return yᵀPy."""
    return p[0] * y[0] ** 2 + 2 * p[1] * y[0] * y[1] + p[2] * y[1] ** 2


def balancing_scale(m: Matrix2) -> Real:
    """Return s that balances the matrix in (y_a, y_b/s): slow precession has y_b ~ μ y_a."""
    down, up, rate = jnp.abs(m[2]), jnp.abs(m[1]), safe_divisor(jnp.abs(m[0] + m[3]))
    square = (down + rate * jnp.minimum(1.0, rate / safe_divisor(up))) / (
        up + rate * jnp.minimum(1.0, rate / safe_divisor(down))
    )
    return jnp.sqrt(square)


def rescaled(m: Matrix2, s: Real) -> Matrix2:
    """Return the matrix in (y_a, y_b/s)."""
    return m[0], m[1] * s, m[2] / s, m[3]
