"""Derivatives by central differences of order 6, with a step size at which two of them agree."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

SHIFTS = np.array([-3, -2, -1, 1, 2, 3])
WEIGHTS = np.array([-1, 9, -45, 45, -9, 1]) / 60  # of the central difference of order 6
RATIO = 0.4  # of a step size to the one before
STEPS = 3e-3 * RATIO ** np.arange(8)  # step sizes; short ones are needed next to the boundary
CERTAIN = 1e-8  # differences that agree less well are not used

Function = Callable[[np.ndarray], np.ndarray]
"""A function from rows of arguments to a row of values for each."""


def chosen_steps(
    function: Function,
    rows: Float[np.ndarray, "n k"],
    directions: Float[np.ndarray, "d k"],
) -> Float[np.ndarray, "n d"]:
    """Return for each row and direction the step size that agrees best with the following ones."""
    n, d = len(rows), len(directions)
    every = along(function, rows, directions, np.tile(STEPS[:, None, None], (1, n, d)))
    apart = np.max(np.abs(np.diff(every, axis=0)), axis=-1)
    apart = np.nan_to_num(np.maximum(apart[1:], apart[:-1]), nan=np.inf)
    return STEPS[np.argmin(apart, axis=0) + 1]


def along(
    function: Function,
    rows: Float[np.ndarray, "n k"],
    directions: Float[np.ndarray, "d k"],
    steps: Float[np.ndarray, "s n d"],
) -> Float[np.ndarray, "s n d c"]:
    """Return central differences of order 6 of c functions, with given step sizes."""
    moves = SHIFTS[:, None, None, None, None] * steps[..., None] * directions
    around = rows[:, None] + moves
    values = function(around.reshape(-1, rows.shape[1])).reshape(*around.shape[:-1], -1)
    return np.tensordot(WEIGHTS, values, 1) / steps[..., None]


def differences(
    function: Function,
    rows: Float[np.ndarray, "n k"],
    directions: Float[np.ndarray, "d k"],
    steps: Float[np.ndarray, "n d"],
) -> tuple[Float[np.ndarray, "n d c"], Float[np.ndarray, "n d c"]]:
    """Return derivatives of c functions of rows, and the difference between two step sizes."""
    both = along(function, rows, directions, np.stack([steps, steps / RATIO]))
    return both[0], np.abs(both[0] - both[1])


def largest(each: np.ndarray) -> np.ndarray:
    """Return the largest size in each row."""
    return np.max(np.abs(each), axis=tuple(range(1, each.ndim)))


def certain(exact: np.ndarray, apart: np.ndarray) -> Int[np.ndarray, "m"]:
    """Return the rows at which two step sizes agree well enough; exit if there are none."""
    sure = np.flatnonzero(largest(apart) < CERTAIN * largest(exact))
    if sure.size == 0:
        raise SystemExit(f"Differences agree to {CERTAIN:.0e} at no start: take a larger --pool.")
    return sure


def off(derivatives: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Return median and largest error, relative to the largest element of each derivative."""
    errors = largest(derivatives - exact) / largest(exact)
    return {"median": float(np.median(errors)), "largest": float(np.max(errors))}
