"""How bodies end, as means over isotropic directions of L.

A slow motion depends on the direction of L by h alone, except for the sign of its last spin. So a
mean over isotropic directions is a mean over h. On the side round the axis c, with a the other
extreme axis, b the middle one, and x = (h − p_c)/(p_b − p_c), the share of directions between x
and x + dx is

    (k/π) K(m)/√(1 − k²x) dx,   k² = (p_b − p_c)/(p_a − p_c),   m = x(1 − k²)/(1 − k²x),

with a logarithmic singularity at the separatrix, x = 1. The integral over x is (2/π) arcsin k, the
share of this side, a pair of lunes.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from .._base.types import RESIDUAL_FATES
from .free_rotation import quarter_period
from .predicted_ends import End
from .untimed_ends import ends_of_many

STARTS = 16
"""The number of values of h on each side of the separatrix."""
SECTIONS, ROUNDS = 66, 2
"""The sections into which an interval of h is cut if its ends have different outcomes, and how
often."""
CHUNK = 4096
"""The number of motions between two reports of progress."""
SMALL = 1e-20
"""|L| of the starts, so small that the slow flow is exact to rounding."""


class IsotropicEnds(NamedTuple):
    """How B bodies end."""

    probability: Float[np.ndarray, "B 8"]
    """The probability of each of the `PREDICTED_FATES`, a mean over directions."""
    ratio: Float[np.ndarray, "B"]
    """The mean of L∞/L₀."""
    error: Float[np.ndarray, "B"]
    """The largest estimated relative error."""


class _Sides(NamedTuple):
    """The two sides of B bodies: first round the axes of J₃, then round those of J₁."""

    moments: Float[np.ndarray, "2*B 3"]
    dipole: Float[np.ndarray, "2*B 3"]

    def ends(
        self, rows: Int[np.ndarray, "M"], x: Float[np.ndarray, "M"], progress: bool = False
    ) -> End:
        """Return how the motions of some rows end, from given x."""
        moments, dipole = self.moments[rows], self.dipole[rows]
        omega = SMALL * momentum_at(moments, x) / moments
        inertia = moments[:, :, None] * np.eye(3)
        parts = _parts(len(rows), progress)
        ends = [ends_of_many(inertia[part], dipole[part], omega[part]) for part in parts]
        return jax.tree.map(lambda *each: np.concatenate(each), *ends)


def isotropic_ends(
    moments: Float[np.ndarray, "B 3"], dipole: Float[np.ndarray, "B 3"], progress: bool = False
) -> IsotropicEnds:
    """Return how bodies end: means over isotropic directions of L.

    Args:
        moments: J₁ < J₂ < J₃.
        dipole: direction cosines of the dipole.
        progress: whether to show a progress bar.
    """
    # With the axes in reversed order, the side round J₁ is described like the one round J₃.
    sides = _Sides(*(np.concatenate([axes, axes[:, ::-1]]) for axes in (moments, dipole)))
    nodes, weights = isotropic_shapes(sides.moments, STARTS)
    rows = np.repeat(np.arange(len(sides.moments)), STARTS)
    ends = sides.ends(rows, np.tile(nodes, len(sides.moments)), progress)
    kinds = _merged(np.asarray(ends.probability)).reshape(len(weights), STARTS, 8)
    shares = _shares(sides, nodes, kinds)
    ratio = np.sum(weights * ends.ratio.reshape(weights.shape), axis=1)
    error = np.max(ends.error.reshape(weights.shape), axis=1)
    low, high = np.split(np.arange(len(weights)), 2)
    return IsotropicEnds(
        shares[low] + shares[high], ratio[low] + ratio[high], np.maximum(error[low], error[high])
    )


def _merged(probability: Float[np.ndarray, "M 8"]) -> Float[np.ndarray, "M 8"]:
    """Give both senses of residual rotation their mean probability: L and −L are as frequent."""
    merged = probability.copy()
    merged[:, RESIDUAL_FATES] = np.mean(probability[:, RESIDUAL_FATES], axis=1, keepdims=True)
    return merged


def _shares(
    sides: _Sides, nodes: Float[np.ndarray, "K"], kinds: Float[np.ndarray, "S K 8"]
) -> Float[np.ndarray, "S 8"]:
    """Return the share of directions with each end, on every side.

    The ends change at isolated values of x, which are found by cutting intervals into sections.
    """
    rows, before = np.nonzero(_differ(kinds[:, 1:], kinds[:, :-1]))
    low, high = nodes[before], nodes[before + 1]
    parts = np.arange(1, SECTIONS) / SECTIONS
    for _ in range(ROUNDS if len(rows) else 0):
        points = low[:, None] + (high - low)[:, None] * parts
        found = sides.ends(np.repeat(rows, len(parts)), points.ravel()).probability
        after = _merged(np.asarray(found)).reshape(*points.shape, 8)
        changed = _differ(after, kinds[rows, before][:, None])
        passed = np.where(np.any(changed, axis=1), np.argmax(changed, axis=1), len(parts))
        edges = np.concatenate([low[:, None], points, high[:, None]], axis=1)
        each = np.arange(len(rows))
        low, high = edges[each, passed], edges[each, passed + 1]
    steps = kinds[rows, before] - kinds[rows, before + 1]
    shares = share_of_side(sides.moments)[:, None] * kinds[:, -1]
    np.add.at(shares, rows, share_below(sides.moments[rows], (low + high) / 2)[:, None] * steps)
    return shares


def _differ(
    first: Float[np.ndarray, "*#any 8"], second: Float[np.ndarray, "*#any 8"]
) -> Bool[np.ndarray, "..."]:
    return np.any(np.abs(first - second) > 1e-9, axis=-1)


def _parts(size: int, progress: bool) -> Iterator[slice]:
    """Yield parts of all motions, with a progress bar."""
    with tqdm(total=size, unit=" motions", disable=not progress, leave=False) as bar:
        for begin in range(0, size, CHUNK):
            part = slice(begin, min(begin + CHUNK, size))
            yield part
            bar.update(part.stop - part.start)


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
