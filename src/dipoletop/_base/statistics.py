"""Estimates from samples: shares with their intervals, means with their standard errors."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Share(NamedTuple):
    """A share of the starts, with its 95 % interval (Wilson)."""

    share: float
    low: float
    high: float
    count: int


def share_of(count: int, n: int) -> Share:
    """Return the share count/n with its 95 % interval."""
    low, high = wilson(np.asarray(count), n)
    return Share(count / n, float(low), float(high), count)


def wilson(
    counts: Int[np.ndarray, "*any"], n: int | Int[np.ndarray, "*any"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return Wilson's 95 % intervals of shares k/n: all p with (p − k/n)² ≤ z²p(1 − p)/n."""
    z2 = 1.959963984540054**2  # the 97.5 % point of the normal distribution, squared
    p = counts / n
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = np.sqrt(z2 * p * (1 - p) / n + (z2 / (2 * n)) ** 2) / (1 + z2 / n)
    # The ends at 0 and 1 are exact, without rounding errors.
    low = np.where(p == 0, 0.0, middle - half)
    return low, np.where(p == 1, 1.0, middle + half)


def mean_and_error(
    values: Float[np.ndarray, "n *k"],
) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k"]]:
    """Return the mean over the first axis and its standard error s/√n; NaN for too few values."""
    n = len(values)
    unknown = np.full(values.shape[1:], np.nan)
    mean = np.mean(values, axis=0) if n else unknown
    error = np.std(values, axis=0, ddof=1) / np.sqrt(n) if n > 1 else unknown
    return np.asarray(mean), np.asarray(error)
