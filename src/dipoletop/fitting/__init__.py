"""Inverse problems: parameters that fit a time series, and parameters that maximise an objective.

Both `fit` and `design` take a problem as `sweep` does: a function from named parameters to an
equation and a start.
"""

from .designs import Design, DesignEnd, Objective, design, speed
from .fits import Fit, FitEnd, Observe, fit, velocity

__all__ = [
    "Design",
    "DesignEnd",
    "Fit",
    "FitEnd",
    "Objective",
    "Observe",
    "design",
    "fit",
    "speed",
    "velocity",
]
