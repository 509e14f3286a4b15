"""The fate of a trajectory: the way in which it ends, as one number."""

import numpy as np
from jaxtyping import Int

from .._base.checks import instance
from .._base.refusals import refuse
from .._base.types import Fate, fate_of
from .._maps.basin import Basin
from .._maps.columns import MISSING


def fate(basin: Basin) -> Int[np.ndarray, "*shape"]:
    """Return the fate of every start, as the number of a member of `Fate`.

    Args:
        basin: a result of `sweep` with `value=True` or `value="unchecked"`, since the sign of ω∞
            is a part of the fate.

    Returns:
        Members of `Fate`, as numbers, in the shape of the basin.

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
    outcome = basin.outcome
    if missing := int(np.sum(outcome == MISSING["int8"])):
        refuse("basin", "be finished", f"lacks {missing} of its {outcome.size} starts")
    return fate_of(outcome, basin.stop, basin.omega_inf)


def is_residual(fates: Int[np.ndarray, "*shape"]) -> np.ndarray:
    """Return whether fates are a residual rotation."""
    return np.isin(fates, (Fate.POSITIVE, Fate.NEGATIVE))
