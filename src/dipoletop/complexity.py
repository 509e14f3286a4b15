"""Entropy of basins, dimension of their boundary, and predictability of a fate.

The numbers describe the resolved scales: a smooth boundary has dimension 1 in a plane, a fractal
boundary a larger one. Standard errors do not include the effect of unresolved scales.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from ._base.checks import finite, instance
from ._base.refusals import refuse
from ._base.statistics import mean_and_error
from ._base.summaries import summary
from ._base.tolerances import budget, check_settings, whole
from ._maps.basin import Basin
from ._maps.grids import Grid, Points
from ._maps.problems import Problem
from ._maps.sweep import sweep
from ._runs.classification import UNCHECKED
from .boundary import fate

OFFSETS = np.array((-1, 0, 1))  # of a point and its two companions, in units of ε

Numbers = Float[np.ndarray, "k"]
"""A number for each ε, or for each side of the boxes."""


class BasinEntropy(NamedTuple):
    """Basin entropies with their standard errors, in nats."""

    entropy: float
    """S_b, the mean over all boxes."""
    error: float
    """Standard error of `entropy`."""
    boundary_entropy: float
    """S_bb, the mean over the boxes with more than one label; NaN if there are no such boxes."""
    boundary_error: float
    """Standard error of `boundary_entropy`."""
    boxes: int
    """Number of boxes."""
    boundary_boxes: int
    """Number of boxes with more than one label."""

    def __repr__(self) -> str:
        return summary(self, entropy="error", boundary_entropy="boundary_error")


class BoundaryDimension(NamedTuple):
    """A box-counting dimension D with its standard error, and the points of the fitted line."""

    dimension: float
    """D, the slope of the line."""
    error: float
    """Standard error of `dimension`."""
    scales: Int[np.ndarray, "k"]
    """Sides s of the boxes, in points of the grid."""
    counts: Int[np.ndarray, "k"]
    """N(s), the number of boxes that the boundary enters."""

    def __repr__(self) -> str:
        return summary(self, dimension="error")


class UncertaintyExponent(NamedTuple):
    """An uncertainty exponent α with its standard error, and the points of the fitted line."""

    exponent: float
    """α, the slope of the line."""
    error: float
    """Standard error of `exponent`."""
    dimension: float
    """D − α, the dimension of the boundary in a D-dimensional region, with the same `error`."""
    epsilons: Float[np.ndarray, "k"]
    """The displacements ε."""
    fractions: Float[np.ndarray, "k"]
    """f(ε), the share of ε-uncertain points."""
    fraction_errors: Float[np.ndarray, "k"]
    """Standard errors of `fractions`."""

    def __repr__(self) -> str:
        return summary(self, "fraction_errors", exponent="error")


def basin_entropy(labels: Any, *, box: Any = 5) -> BasinEntropy:
    """Compute S_b = (1/N) Σᵢ Sᵢ and S_bb = (1/N_b) Σᵢ Sᵢ over N boxes, Sᵢ = −Σⱼ p_ij ln p_ij.

    p_ij is the share of label j in box i and N_b the number of boxes with more than one label.
    Two labels contribute at most ln 2, so S_bb > ln 2 needs many boxes with three or more labels: a
    sufficient sign of a fractal boundary, not a necessary one. As boxes with a fixed number of
    points shrink, S_b falls as side^α, with the uncertainty exponent α.

    Args:
        labels: whole numbers or booleans, shape (n, m), or a `Basin` over two axes, whose fates
            are used in the order of rising values; UNDECIDED and FAILED are labels like any other.
        box: side of a box in points; last rows and columns that do not fill a box are not used.

    Returns:
        `BasinEntropy`. The errors hold for the mean of independent boxes; on a regular grid they
        are too large for a smooth boundary.

    Raises:
        ValueError: labels that are not a plane of whole numbers, or a box that does not fit.

    Source: A. Daza, A. Wagemakers, B. Georgeot, D. Guéry-Odelin and M. A. F. Sanjuán, Basin
    entropy: a new tool to analyze uncertainty in dynamical systems, Sci. Rep. 6, 31416 (2016).

    Example:
        >>> import numpy as np
        >>> result = basin_entropy(np.arange(16)[:, None] < np.full(16, 6), box=4)
        >>> result.boundary_boxes, bool(np.isclose(result.boundary_entropy, np.log(2)))
        (4, True)
    """
    plane = _label_plane(labels)
    side = whole("box", box, 2, "be a whole number from 2 on")
    if side > min(plane.shape):
        refuse("box", f"fit into labels of shape {plane.shape}", f"is {side}")
    rows, columns = plane.shape[0] // side, plane.shape[1] // side
    covered = plane[: rows * side, : columns * side]
    boxes = covered.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, -1)
    entropies = np.zeros(len(boxes))
    for label in np.unique(boxes):
        share = np.mean(boxes == label, axis=1)
        entropies -= share * np.log(np.where(share > 0, share, 1.0))
    mixed = entropies[np.any(boxes != boxes[:, :1], axis=1)]
    mean, error = map(float, mean_and_error(entropies))
    boundary_mean, boundary_error = map(float, mean_and_error(mixed))
    return BasinEntropy(mean, error, boundary_mean, boundary_error, len(boxes), len(mixed))


def boundary_dimension(labels: Any, *, scales: Any = None) -> BoundaryDimension:
    """Compute D in N(s) ~ s^−D, where N(s) boxes of side s contain a part of the boundary.

    The boundary goes through every square of 2 × 2 neighbours with different labels.

    Args:
        labels: as in `basin_entropy`.
        scales: sides of the boxes in points, whole numbers; None means 1, 2, 4, … up to a
            sixteenth of the shorter side.

    Returns:
        `BoundaryDimension`, by least squares of ln N against −ln s, with the standard error of the
        slope from the scatter about the line.

    Raises:
        ValueError: bad labels, labels without a boundary, or fewer than three scales.

    Source: box counting, as in S. W. McDonald, C. Grebogi, E. Ott and J. A. Yorke, Fractal basin
    boundaries, Physica D 17, 125 (1985).

    Example:
        >>> import numpy as np
        >>> round(boundary_dimension(np.arange(65)[:, None] < np.full(65, 20)).dimension, 12)
        1.0
    """
    plane = _label_plane(labels)
    if scales is None:
        scales = [1 << k for k in range((min(plane.shape) // 16).bit_length())]
    sides = np.unique([budget("scales", side) for side in np.ravel(np.asarray(scales, object))])
    if len(sides) < 3 or sides[-1] >= min(plane.shape):
        must = f"hold three different sides or more, all below {min(plane.shape)}"
        refuse("scales", must, f"holds {sides.tolist()}")
    # Whether the four corners of each square have different labels.
    first, others = plane[:-1, :-1], (plane[1:, :-1], plane[:-1, 1:], plane[1:, 1:])
    mixed = np.any([first != other for other in others], axis=0)
    if not mixed.any():
        refuse("labels", "have a boundary", "have the same value everywhere")
    counts = np.array([_count_boxes(mixed, int(side)) for side in sides])
    slope, _, error = _fitted_slope(-np.log(sides), np.log(counts), np.ones(len(sides)))
    return BoundaryDimension(slope, error, sides, counts)


def uncertainty_exponent(
    problem: Problem,
    over: Grid,
    *,
    epsilons: Sequence[float] | Float[np.ndarray, "k"],
    n: int = 4096,
    seed: int = 0,
    along: str | None = None,
    **settings: Any,
) -> UncertaintyExponent:
    """Compute α in f(ε) ~ ε^α, the share of points whose fate changes if a coordinate moves by ±ε.

    The boundary then has dimension D − α in D dimensions, and α = 1 if it is smooth. The smaller α,
    the less does a better knowledge of the start improve the prediction of its fate.

    Args:
        problem: as in `sweep`.
        over: a grid whose axes span the region, from the least to the largest value on each; an
            axis of length 1 is fixed.
        epsilons: the displacements on the axis `along`; they may lead out of the region.
        n: random points for each ε; points of different ε are independent.
        seed: seed of the random points.
        along: the coordinate to move; None means the last axis that is not fixed.
        settings: rtol, atol, max_steps, devices and engine, as in `sweep`.

    Returns:
        `UncertaintyExponent`, by least squares of ln f against ln ε with the binomial weights
        n f/(1 − f), from which the standard errors follow.

    Raises:
        ValueError: bad arguments, or an ε at which none or all of the points are uncertain.

    Source: C. Grebogi, S. W. McDonald, E. Ott and J. A. Yorke, Final state sensitivity: an
    obstruction to predictability, Phys. Lett. A 99, 415 (1983).

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> def problem(w3, phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
        >>> region = dt.Grid(w3=[0.1, 0.4], phi=[0.2, 1.4])
        >>> result = uncertainty_exponent(problem, region, epsilons=[0.01, 0.03, 0.1], n=1000)
        >>> bool(abs(result.exponent - 1) < 3 * result.error)
        True
    """
    check_settings(settings)
    steps = np.asarray(finite("epsilons", epsilons, (-1,), batch=False))
    if len(np.unique(steps)) < 2 or np.any(steps <= 0):
        refuse("epsilons", "hold two different positive numbers or more", f"is {epsilons}")
    count, rng = budget("n", n), np.random.default_rng(whole("seed", seed, 0))
    low, high, along = _region(over, along)
    drawn = rng.random((len(low), len(steps), count, 1))
    points = {}
    for name, unit in zip(low, drawn, strict=True):
        moved = steps[:, None, None] * OFFSETS * (name == along)
        points[name] = (low[name] + (high[name] - low[name]) * unit + moved).ravel()
    fates = fate(sweep(problem, Points(**points), value=UNCHECKED, progress=False, **settings))
    share = _uncertain_shares(fates.reshape(len(steps), count, len(OFFSETS)), steps)
    weights = count * share / (1 - share)
    slope, error, _ = _fitted_slope(np.log(steps), np.log(share), weights)
    free = sum(bool(low[name] < high[name]) for name in low)
    return UncertaintyExponent(slope, error, free - slope, steps, share, share / np.sqrt(weights))


def _uncertain_shares(fates: Int[np.ndarray, "k n 3"], steps: Numbers) -> Numbers:
    """Return for every ε the share of points with a companion that has another fate."""
    count = fates.shape[1]
    uncertain = np.sum(np.any(fates != fates[:, :, :1], axis=2), axis=1)
    for step, many in zip(steps.tolist(), uncertain.tolist(), strict=True):
        if many in (0, count):
            was = f"{many} of {count} are at {step:g}"
            refuse("epsilons", "leave some points uncertain and others not", was)
    return uncertain / count


def _region(over: Any, along: str | None) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Return the least and the largest value on every axis, and the axis to move along."""
    instance("over", over, Grid)
    for name, values in over.axes.items():
        if values.ndim > 1:
            refuse("over", "have axes of numbers", f"its axis {name} is made of vectors")
    low = {name: np.min(values) for name, values in over.axes.items()}
    high = {name: np.max(values) for name, values in over.axes.items()}
    free = [name for name in low if low[name] < high[name]]
    if not free:
        refuse("over", "have an axis that is not fixed", "has none")
    if along is not None and along not in free:
        refuse("along", f"be one of {', '.join(free)}", f"is {along!r}")
    return low, high, along or free[-1]


def _label_plane(labels: Any) -> Integer[np.ndarray, "n m"]:
    """Return the labels, or the fates of a basin over two axes."""
    must = "be whole numbers over two axes"
    try:
        array = _ordered_fates(labels) if isinstance(labels, Basin) else np.asarray(labels)
    except ValueError:  # rows of different lengths
        refuse("labels", must, "are not")
    if array.dtype == bool:
        array = array.view(np.uint8)
    if array.ndim != 2 or array.dtype.kind not in "iu":
        was = f"have shape {array.shape} and dtype {array.dtype}"
        refuse("labels", must, was)
    return array


def _ordered_fates(basin: Basin) -> Integer[np.ndarray, "..."]:
    """Return the fates of a basin with ascending values on its axes, without axes of length 1.

    In another order neighbouring fates would not belong to neighbouring starts.
    """
    fates = fate(basin)
    for axis, name in enumerate(basin.dims):
        values = basin.coords.get(name)
        if values is not None and values.ndim == 1:
            fates = np.take(fates, np.argsort(values, kind="stable"), axis)
    return fates.squeeze()


def _count_boxes(mixed: Bool[np.ndarray, "n m"], side: int) -> int:
    """Return the number of boxes with a mixed square; boxes at the far edges may be smaller."""
    hit = mixed
    for axis, length in enumerate(mixed.shape):
        hit = np.logical_or.reduceat(hit, np.arange(0, length, side), axis=axis)
    return int(np.sum(hit))


def _fitted_slope(x: Numbers, y: Numbers, weights: Numbers) -> tuple[float, float, float]:
    """Return the slope of y over x, its error for inverse-variance `weights`, and from scatter."""
    total = np.sum(weights)
    dx, dy = x - np.sum(weights * x) / total, y - np.sum(weights * y) / total
    spread = np.sum(weights * dx**2)
    slope = np.sum(weights * dx * dy) / spread
    scatter = np.sum(weights * (dy - slope * dx) ** 2) / max(len(x) - 2, 1)
    return float(slope), float(1 / np.sqrt(spread)), float(np.sqrt(scatter / spread))
