"""The accuracy that a slow motion needs if only its outcome is wanted.

Where all slow motions have the same outcome, an absolute tolerance saves many steps. Elsewhere a
slow motion may still be near the boundary between outcomes, and an error that is larger than the
motion could change the outcome.
"""

from typing import Any

import numpy as np

from .._base.checks import concrete
from ..equations._families import LONGITUDINAL, TRANSVERSE
from ..equations._verdicts.transverse import has_boundary_at_rest
from ..equations.levels import Level
from .classification import Value


def exact_when_slow(equation: Any, value: Value) -> Any:
    """Return whether runs need a relative accuracy to the end: one value, or one for each δ."""
    if value or type(equation) not in (*TRANSVERSE, *LONGITUDINAL):
        return True
    if type(equation) in LONGITUDINAL:  # always residual
        return False
    delta = equation.delta
    if concrete(delta):  # in NumPy, since JAX compiles for each number of lanes
        delta = np.asarray(delta)
    return has_boundary_at_rest(delta, level_of_top(equation))


def level_of_top(equation: Any) -> Level:
    """Return the level whose basin boundaries a top has: SEMI for the full equation."""
    order = getattr(equation, "order", None)
    return Level.SEMI if order is None else Level.of_order(order)
