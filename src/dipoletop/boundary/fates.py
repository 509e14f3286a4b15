"""The fate of a trajectory: the way in which it ends, as one number."""

import enum

import numpy as np
from jaxtyping import Int

from .._base.checks import instance, refuse
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.columns import MISSING


class Fate(enum.IntEnum):
    """The way in which a trajectory ends: outcome, sense of a residual rotation, kind of a stop.

    The members from STOP on are `STOP + kind` for the kinds of stop in `Stop`. FAILED and
    UNDECIDED, the members up to 0, mean that the fate is not known.
    """

    FAILED = -1
    UNDECIDED = 0
    """No outcome, or a residual rotation whose sense is not known."""
    POSITIVE = 1
    """Residual rotation with ω∞ > 0."""
    NEGATIVE = 2
    """Residual rotation with ω∞ < 0."""
    STOP = 3
    """A stop of unknown kind."""
    STOP_AXIS = 4
    STOP_ROTATING = 5
    STOP_WOBBLING = 6
    STOP_TUMBLING = 7


RESIDUAL = (Fate.POSITIVE, Fate.NEGATIVE)


def fate(basin: Basin) -> Int[np.ndarray, "*shape"]:
    """Return the fate of every start, as the number of a member of `Fate`.

    Args:
        basin: a result of `sweep` with `value=True` or `value="unchecked"`, since the sign of ω∞
            is a part of the fate.

    Returns:
        −1 FAILED; 0 UNDECIDED, also where the sign of ω∞ is not known; 1 or 2 RESIDUAL with ω∞ > 0
        or ω∞ < 0; 3 + kind for STOP, the kind being a member of `Stop`. Shape of the basin.

    Raises:
        ValueError: `basin` is not a `Basin`, or an unfinished one.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import Fate, fate
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> fates = fate(dt.sweep(problem, dt.Points(phi=[0.1, 1.0, 3.2])))
        >>> fates, Fate(fates[1]).name
        (array([1, 5, 2]), 'STOP_ROTATING')
    """
    instance("basin", basin, Basin)
    outcome, value = basin.outcome.astype(int), basin.omega_inf
    if missing := int(np.sum(outcome == MISSING["int8"])):
        refuse("basin", "be finished", f"lacks {missing} of its {outcome.size} starts")
    residual = np.select([value > 0, value < 0], RESIDUAL, Fate.UNDECIDED)
    ended = [outcome == Outcome.RESIDUAL, outcome == Outcome.STOP]
    return np.select(ended, [residual, Fate.STOP + basin.stop.astype(int)], outcome)


def is_residual(fates: Int[np.ndarray, "*shape"]) -> np.ndarray:
    """Return whether fates are a residual rotation."""
    return np.isin(fates, RESIDUAL)
