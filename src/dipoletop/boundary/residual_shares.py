"""The share of a segment that ends in residual rotation, and its derivatives, from the boundary.

The fates at equally spaced points of a segment show between which of them residual rotation begins
or ends; each such place s_j is then bisected to rounding. The share of the segment is the sum of
± s_j, and the implicit function theorem gives the derivative of each s_j (see `crossings`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._base.checks import names_of
from .._base.refusals import refuse
from .._base.statistics import mean_and_error
from .._base.summaries import summary
from .._base.tolerances import budget
from .._base.types import Fate
from .._maps.problems import Problem
from .crossings import (
    Crossings,
    fates_at,
    narrow,
    new_crossings,
    residual_gradient,
    unsearched_rows,
)
from .fates import is_residual


class ResidualShare(NamedTuple):
    """The mean share of segments that ends in residual rotation, and its derivatives."""

    share: float
    error: float
    """Standard error of `share` for independent random segments; NaN for a single segment."""
    slopes: dict[str, float]
    """∂share/∂p for each p of `by`; NaN if a normal of the boundary is not known."""
    errors: dict[str, float]
    """Standard errors of `slopes`, in the same sense."""
    undecided: float
    """Share of the points that are undecided or failed. Each counts like the last decided point
    before it; if a segment has no decided point, all other numbers are NaN."""

    def __repr__(self) -> str:
        return summary(self, share="error", slopes="errors")


def residual_share(
    problem: Problem,
    a: Mapping[str, Any],
    b: Mapping[str, Any],
    by: str | Sequence[str] = (),
    *,
    parts: int = 64,
    **settings: Any,
) -> ResidualShare:
    """Compute the share of segments that ends in residual rotation, and its derivatives.

    The segments are a + s(b − a), 0 ≤ s ≤ 1. The share of a segment follows from the places s_j
    where it crosses the boundary of residual rotation, which are found to rounding:

        ∂share/∂p = Σ_j ± ∂s_j/∂p,        ∂s_j/∂p = −(∂ω∞/∂p)/(∂ω∞/∂s),

    + where residual rotation lies before s_j. With segments along one coordinate, and the other
    coordinates drawn at random, the mean is the residual fraction of that population. It is far
    more accurate than by counting, and its derivative has no noise of a difference of counts.

    Args:
        problem: a problem as for `sweep`.
        a: coordinates of one end, name = a number or shape (N,): the arguments of `problem`.
        b: coordinates of the other end.
        by: coordinates or parameters, such as "delta", to differentiate by.
        parts: the number of parts of each segment: an interval of residual rotation, or a gap
            between two, that is shorter than a part may be missed.
        settings: the settings of the sweeps, as in `bisect`.

    Returns:
        A `ResidualShare`.

    Raises:
        ValueError: bad arguments.

    Example:
        Of starts with ω⊥ = ω₃ = 1/5, φ uniform, by δ:

        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.boundary import residual_share
        >>> def problem(delta, phi):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.2, phi)
        >>> ends = {"delta": -0.2, "phi": 0.0}, {"delta": -0.2, "phi": np.pi}
        >>> result = residual_share(problem, *ends, by="delta", parts=16)
        >>> round(result.share, 3), round(result.slopes["delta"], 3)
        (0.515, 4.745)
    """
    segments = new_crossings(problem, a, b, settings)
    names = names_of("by", by)
    if not set(names) <= set(segments.a) or len(set(names)) < len(names):
        refuse("by", f"name coordinates among {', '.join(segments.a)}, each once", f"is {by!r}")
    rows, undecided = _shares_and_slopes(segments, names, budget("parts", parts))
    (share, *slopes), (error, *errors) = (numbers.tolist() for numbers in mean_and_error(rows))
    slopes, errors = (dict(zip(names, numbers, strict=True)) for numbers in (slopes, errors))
    return ResidualShare(share, error, slopes, errors, undecided)


def _shares_and_slopes(
    segments: Crossings, names: tuple[str, ...], parts: int
) -> tuple[Float[np.ndarray, "N columns"], float]:
    """Return the share of each segment and its derivatives, and the share of unknown points."""
    s = np.tile(np.linspace(0, 1, parts + 1), (len(segments.bracket), 1))
    fates = fates_at(segments, s)
    known = fates > Fate.UNDECIDED
    # The last known place up to each place, or the first known place before it.
    places = np.where(known, np.arange(parts + 1), np.argmax(known, axis=1)[:, None])
    last = np.maximum.accumulate(places, axis=1)
    residual = np.take_along_axis(is_residual(fates), last, axis=1)
    rows, places = np.nonzero(residual[:, 1:] != residual[:, :-1])
    share, slopes = residual[:, -1].astype(float), np.zeros((len(s), len(names)))
    if len(rows):
        bracket = np.stack([s[rows, last[rows, places]], s[rows, places + 1]], axis=1)
        crossings = narrow(replace(unsearched_rows(segments, rows), bracket=bracket))
        sign = np.where(residual[rows, places], 1.0, -1.0)
        np.add.at(share, rows, sign * crossings.s)
        np.add.at(slopes, rows, sign[:, None] * _slopes_of_s(crossings, names))
    unknown = ~known.any(axis=1)
    share[unknown], slopes[unknown] = np.nan, np.nan
    return np.column_stack([share, slopes]), float(np.mean(~known))


def _slopes_of_s(crossings: Crossings, names: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    """Return ∂s/∂p of the crossings, by the implicit function theorem."""
    if not names:
        return np.zeros((len(crossings.bracket), 0))
    a, b = crossings.a, crossings.b
    moving = tuple(name for name in a if np.any(a[name] != b[name]))
    needed = tuple(dict.fromkeys(moving + names))
    gradient = dict(zip(needed, residual_gradient(crossings, needed, None).T, strict=True))
    along = sum(gradient[name] * (b[name] - a[name]) for name in moving)
    return -np.stack([gradient[name] for name in names], axis=1) / np.asarray(along)[:, None]
