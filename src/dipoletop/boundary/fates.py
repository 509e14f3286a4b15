"""The fate of a trajectory: the way in which it ends, as one number."""

import numpy as np
from jaxtyping import Int

from .._base.checks import instance
from .._base.refusals import refuse
from .._base.types import Fate, Outcome, Stop
from .._maps.basin import Basin
from .._maps.columns import MISSING


def fate(basin: Basin) -> Int[np.ndarray, "*shape"]:
    """Return the fate of every start, as the number of a member of `Fate`.

    Args:
        basin: a result of `sweep` with `value=True` or `value="unchecked"`, since the sign of ω∞
            is a part of the fate.

    Returns:
        Members of `Fate`, as numbers: UNDECIDED also where the sign of ω∞ is not known. Shape of
        the basin.

    Raises:
        ValueError: `basin` is not a `Basin`, or an unfinished one.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import fate
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> fates = fate(dt.sweep(problem, dt.Points(phi=[0.1, 1.0, 3.2])))
        >>> [dt.Fate(number).name for number in fates]
        ['POSITIVE', 'ROTATING', 'NEGATIVE']
    """
    instance("basin", basin, Basin)
    outcome, value = basin.outcome.astype(int), basin.omega_inf
    if missing := int(np.sum(outcome == MISSING["int8"])):
        refuse("basin", "be finished", f"lacks {missing} of its {outcome.size} starts")
    fates = np.full(outcome.shape, int(Fate.UNDECIDED))
    fates[outcome == Outcome.FAILED] = Fate.FAILED
    residual = outcome == Outcome.RESIDUAL
    fates[residual & (value > 0)] = Fate.POSITIVE
    fates[residual & (value < 0)] = Fate.NEGATIVE
    for kind in Stop:
        found = (outcome == Outcome.STOP) & (basin.stop == kind)
        fates[found] = Fate[kind.name] if kind else Fate.STOP
    return fates


def is_residual(fates: Int[np.ndarray, "*shape"]) -> np.ndarray:
    """Return whether fates are a residual rotation."""
    return np.isin(fates, (Fate.POSITIVE, Fate.NEGATIVE))
