"""Isotropic directions of L: how often each shape h = 2E/L² of the rotation occurs among them.

A slow motion depends on the direction of L by h alone, except for the sign of its last spin. So a
mean over isotropic directions is a mean over h. On the side round the axis c, with a the other
extreme axis, b the middle one, and x = (h − p_c)/(p_b − p_c), the share of directions between x
and x + dx is

    (k/π) K(m)/√(1 − k²x) dx,   k² = (p_b − p_c)/(p_a − p_c),   m = x(1 − k²)/(1 − k²x),

with a logarithmic singularity at the separatrix, x = 1. The integral over x is (2/π) arcsin k, the
share of this side, a pair of lunes.
"""

import numpy as np
from jaxtyping import Float

from .free_rotation import quarter_period


def isotropic_shapes(
    moments: Float[np.ndarray, "B 3"], count: int
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "B K"]]:
    """Return nodes and weights of the mean over isotropic directions round the last axis.

    Args:
        moments: J_a, J_b and J_c of B bodies, with b the middle one.
        count: the number of nodes.

    Returns:
        The x of the nodes, rising; dense near the axis and the separatrix, where L∞/L₀ has powers
        and logarithms of x. And the weights, whose sum is the share of directions on this side.
    """
    nodes, rule = np.polynomial.legendre.leggauss(count)
    v, rule = (1 + nodes) / 2, rule / 2
    x = v**3 * (10 - 15 * v + 6 * v**2)
    rest = (1 - v) ** 3 * (1 + 3 * v + 6 * v**2)
    square = _square(moments)
    left = 1 - square * x
    density = np.sqrt(square / left) * quarter_period(rest / left, np) / np.pi
    weights = density * (rule * 30 * (v * (1 - v)) ** 2)
    whole = share_of_side(moments)[:, None]
    return x, weights * (whole / np.sum(weights, axis=1, keepdims=True))


def momentum_at(moments: Float[np.ndarray, "B 3"], x: Float[np.ndarray, "B"]) -> np.ndarray:
    """Return unit vectors L with given x and L_b = 0; components along a, b, c, shape (B, 3)."""
    along = _square(moments)[:, 0] * x
    return np.stack([np.sqrt(along), np.zeros_like(along), np.sqrt(1 - along)], axis=1)


def share_of_side(moments: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B"]:
    """Return the share of directions on the side round the last axis, (2/π) arcsin k."""
    return 2 / np.pi * np.arcsin(np.sqrt(_square(moments)[:, 0]))


def share_below(
    moments: Float[np.ndarray, "B 3"], x: Float[np.ndarray, "B"]
) -> Float[np.ndarray, "B"]:
    """Return the share of directions on the side round the last axis that have less than x.

    (2k/π) x ∫₀^{π/2} dψ/(1 + √(1 − s)),   s = x(k² + (1 − k²) sin²ψ)
    """
    nodes, rule = np.polynomial.legendre.leggauss(64)
    sine2 = np.sin(np.pi / 4 * (1 + nodes)) ** 2
    square = _square(moments)
    s = x[:, None] * (square + (1 - square) * sine2)
    integral = np.sum(rule / (1 + np.sqrt(1 - s)), axis=1) / 2
    return np.sqrt(square[:, 0]) * x * integral


def _square(moments: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B 1"]:
    """Compute k² = (p_b − p_c)/(p_a − p_c), from differences of moments."""
    a, b, c = moments.T[:, :, None]
    return a * (c - b) / (b * (c - a))
