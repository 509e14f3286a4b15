"""How much of a segment ends in residual rotation, and how that moves: by the boundary."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._base.checks import refuse
from .._base.tolerances import budget
from .._maps.sweep import Problem
from .crossings import (
    NEGATIVE,
    POSITIVE,
    UNDECIDED,
    Crossings,
    asked,
    cut,
    fates_at,
    gradient_inwards,
    segments,
)


class ResidualShare(NamedTuple):
    """The mean share of segments from which tops keep rotating, and its derivatives."""

    share: float
    error: float
    """Standard error of `share` if the segments are independent random ones; NaN of one alone."""
    slopes: dict[str, float]
    """∂share/∂p for each p of `by`; NaN if a normal of the boundary is not known."""
    errors: dict[str, float]
    """Standard errors of `slopes`, likewise."""
    undecided: float
    """Share of the points looked at that are undecided or failed. Each counts as the one before;
    if a segment has no others, nothing is known, and all but this is NaN."""


def residual_share(
    problem: Problem,
    a: Mapping[str, Any],
    b: Mapping[str, Any],
    by: str | Sequence[str] = (),
    *,
    parts: int = 64,
    **settings: Any,
) -> ResidualShare:
    """How much of the segments a + s(b − a), 0 ≤ s ≤ 1, ends in residual rotation, and ∂/∂p of it.

    The share of a segment is made of the places s_j where it crosses the boundary of residual
    rotation, which are found to rounding; so its derivative is that of these places,

        ∂share/∂p = Σ_j ± ∂s_j/∂p,        ∂s_j/∂p = −(∂ω∞/∂p)/(∂ω∞/∂s),

    + where residual rotation lies before s_j. With segments along one coordinate, their other
    coordinates drawn at random, the mean is the residual fraction of that population, far more
    exact than by counting; and its derivative has no noise of its own, as a difference of counts.

    Args:
        problem: a problem as for `sweep`.
        a: coordinates of one end, name = a number or shape (N,): the arguments of `problem`.
        b: those of the other end.
        by: coordinates or parameters, such as "delta", to differentiate by.
        parts: in how many parts each segment is searched: an interval of residual rotation, or
            a gap between two, that is shorter than a part may be missed.
        settings: of the sweeps, as in `bisect`.

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
        >>> found = residual_share(problem, *ends, by="delta", parts=16)
        >>> round(found.share, 3), round(found.slopes["delta"], 3)
        (0.515, 4.745)
    """
    whole = asked(problem, a, b, settings)
    names = (by,) if isinstance(by, str) else tuple(by)
    if not set(names) <= set(whole.a) or len(set(names)) < len(names):
        refuse("by", f"name coordinates among {', '.join(whole.a)}, each once", f"is {by!r}")
    s = np.tile(np.linspace(0, 1, budget("parts", parts) + 1), (len(whole.bracket), 1))
    fates = fates_at(whole, s)
    known = fates > UNDECIDED
    last = _last_known(known)
    residual = np.take_along_axis(np.isin(fates, (POSITIVE, NEGATIVE)), last, axis=1)
    rows, places = np.nonzero(residual[:, 1:] != residual[:, :-1])
    share, slopes = residual[:, -1].astype(float), np.zeros((len(s), len(names)))
    if len(rows):
        found = cut(_between(whole, rows, s[rows, last[rows, places]], s[rows, places + 1]))
        sign = np.where(residual[rows, places], 1.0, -1.0)
        np.add.at(share, rows, sign * found.s)
        np.add.at(slopes, rows, sign[:, None] * _moves(found, names))
    unknown = ~known.any(axis=1)
    share[unknown], slopes[unknown] = np.nan, np.nan
    (mean, *means), (error, *errors) = _means(np.column_stack([share, slopes]))
    return ResidualShare(
        mean,
        error,
        dict(zip(names, means, strict=True)),
        dict(zip(names, errors, strict=True)),
        float(np.mean(fates <= UNDECIDED)),
    )


def _last_known(known: Bool[np.ndarray, "N m"]) -> Int[np.ndarray, "N m"]:
    """For each place that itself or the last known one before it; before the first, that one."""
    first = np.argmax(known, axis=1)[:, None]
    return np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), first), axis=1)


def _between(
    whole: Crossings, rows: np.ndarray, low: Float[np.ndarray, "n"], high: Float[np.ndarray, "n"]
) -> Crossings:
    """The segments of these rows, with brackets to begin with."""
    a, b = ({name: x[rows] for name, x in end.items()} for end in (whole.a, whole.b))
    fresh = segments(whole.problem, a, b, whole.settings)
    fresh.bracket[:] = np.stack([low, high], axis=1)
    return fresh


def _moves(found: Crossings, names: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    """∂s/∂p of the crossings, by the implicit function theorem."""
    if not names:
        return np.zeros((len(found.bracket), 0))
    moving = tuple(name for name in found.a if np.any(found.a[name] != found.b[name]))
    every = (*dict.fromkeys(moving + names),)
    slope = dict(zip(every, gradient_inwards(found, every, None).T, strict=True))
    along = sum(slope[name] * (found.b[name] - found.a[name]) for name in moving)
    return -np.stack([slope[name] for name in names], axis=1) / np.asarray(along)[:, None]


def _means(values: Float[np.ndarray, "N k"]) -> tuple[list[float], list[float]]:
    """The mean of each column, and its standard error."""
    size = len(values)
    spread = np.std(values, axis=0, ddof=1) if size > 1 else np.full(values.shape[1], np.nan)
    return np.mean(values, axis=0).tolist(), (spread / size**0.5).tolist()
