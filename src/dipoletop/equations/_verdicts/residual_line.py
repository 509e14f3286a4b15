"""Motions beside the line Ω = w n along the dipole: how they decay, and what w becomes.

In the frame (n, a, b) of `_general`, with moments a and b in units of J_d and times in 1/|w|,
μ = |d|²|w|/J_d and y = (x_a, ±x_b)/|w|: y′ = ℓ(μ) y + odd terms from the third power on, and
w′/w = g y_a y_b exactly, g = a − b. So w(1 + yᵀSy) is constant up to the fourth power of y, where
ℓᵀS + Sℓ = −g [[0, 1], [1, 0]]/2.
"""

from typing import Any

import jax
import jax.numpy as jnp

from ..._base.types import Real
from ..levels import Level

Two = tuple[Real, Real, Real, Real]
"""A 2×2 matrix, by rows."""
Form = tuple[Real, Real, Real]
"""A symmetric 2×2 matrix: its elements 11, 12 and 22."""

SWEEPS = 30  # of the fixed-point iteration for the full equation


def guarded(denominator: Real) -> Real:
    """1 in place of 0, so that no unused branch divides by it."""
    return jnp.where(denominator == 0, 1.0, denominator)


def root(square: Real) -> Real:
    """Square root with derivative 0 at 0."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def line(a: Real, b: Real, mu: Real, level: Level) -> Two:
    """ℓ(μ), the linear part of the equation across its residual line.

    The full equation is on its physical branch. Across the line I⊥ℓ₀ is the gyroscopic part,
    Ω̇ = ℓ₋x and Ω̈ = ℓ₋²x with ℓ₋ the order before, and the torque of radiation is
    μ(−1 + ℓ₋² + 2n×ℓ₋)x.
    """
    if level is Level.FULL:
        return _solvent(a, b, mu)
    free = ((b - 1) / a, -(a - 1) / b)
    both = free[0] * free[1]
    if level is Level.SEMI:
        # (I⊥ − 2μ n×) ℓ = I⊥ℓ₀ + μ(−1 + ℓ₀²)
        drag, det = mu * (both - 1), a * b + 4 * mu**2
        up, down = b - 1, 1 - a
        return (
            (b * drag - 2 * mu * down) / det,
            (b * up - 2 * mu * drag) / det,
            (a * down + 2 * mu * drag) / det,
            (a * drag + 2 * mu * up) / det,
        )
    l11, l12, l21, l22 = jnp.zeros_like(both), free[0], free[1], jnp.zeros_like(both)
    for _ in range(level.order or 0):
        cross_term, trace = l12 * l21, l11 + l22
        l11, l12, l21, l22 = (
            mu / a * (l11**2 + cross_term - 1 - 2 * l21),
            free[0] + mu / a * (l12 * trace - 2 * l22),
            free[1] + mu / b * (l21 * trace + 2 * l11),
            mu / b * (l22**2 + cross_term - 1 + 2 * l12),
        )
    return l11, l12, l21, l22


def _solvent(a: Real, b: Real, mu: Real) -> Two:
    """ℓ of the full equation, (I⊥ − 2μ n× − μℓ) ℓ = I⊥ℓ₀ − μ, whose fast roots it leaves out."""

    def swept(_: Any, m: Two) -> Two:
        l11, l12, l21, l22 = m
        m11, m12, m21, m22 = a - mu * l11, mu * (2 - l12), -mu * (2 + l21), b - mu * l22
        det = guarded(m11 * m22 - m12 * m21)
        return (
            (-mu * m22 - (1 - a) * m12) / det,
            ((b - 1) * m22 + mu * m12) / det,
            (mu * m21 + (1 - a) * m11) / det,
            (-(b - 1) * m21 - mu * m11) / det,
        )

    none = jnp.zeros_like(a * b * mu)
    # A loop, since all of them written out compile for minutes in a second derivative.
    return jax.lax.fori_loop(0, SWEEPS, swept, (none, none, none, none), unroll=5)


def lyapunov(m: Two, q: Form) -> Form:
    """P of MᵀP + PM = −Q: [det Q + adj(M)ᵀ Q adj(M)] / (−2 tr M det M)."""
    m11, m12, m21, m22 = m
    q11, q12, q22 = q
    det = m11 * m22 - m12 * m21
    below = guarded(-2 * (m11 + m22) * det)
    return (
        ((det + m22**2) * q11 - 2 * m21 * m22 * q12 + m21**2 * q22) / below,
        (-m12 * m22 * q11 + 2 * m11 * m22 * q12 - m11 * m21 * q22) / below,
        (m12**2 * q11 - 2 * m11 * m12 * q12 + (det + m11**2) * q22) / below,
    )


def extremes(p: Form) -> tuple[Real, Real]:
    """Smallest and largest eigenvalue of a symmetric matrix."""
    mean, spread = (p[0] + p[2]) / 2, root((p[0] - p[2]) ** 2 / 4 + p[1] ** 2)
    return mean - spread, mean + spread


def quadratic(p: Form, y: tuple[Real, Real]) -> Real:
    """yᵀPy."""
    return p[0] * y[0] ** 2 + 2 * p[1] * y[0] * y[1] + p[2] * y[1] ** 2


def balancing(m: Two) -> Real:
    """Scale s such that y_b/s makes ℓ balanced: a slow precession has y_b ~ μ y_a."""
    down, up, rate = jnp.abs(m[2]), jnp.abs(m[1]), guarded(jnp.abs(m[0] + m[3]))
    square = (down + rate * jnp.minimum(1.0, rate / guarded(up))) / (
        up + rate * jnp.minimum(1.0, rate / guarded(down))
    )
    return jnp.sqrt(square)


def scaled(m: Two, s: Real) -> Two:
    """The matrix for (y_a, y_b/s)."""
    return m[0], m[1] * s, m[2] / s, m[3]
