"""Shares of outcomes while a sweep runs, as a short text for its progress bar."""

import numpy as np
from jaxtyping import Int

from .._base.statistics import share_of
from .._base.types import Outcome


class RunningShares:
    """Counts of the outcomes that this process has found so far.

    Args:
        random: whether the starts are random, so that shares have confidence intervals.
    """

    def __init__(self, random: bool) -> None:
        self._random = random
        self._counts = dict.fromkeys(Outcome, 0)

    def add(self, counts: Int[np.ndarray, "outcomes"]) -> None:
        """Add the counts of each outcome among further starts; see `counted_outcomes`."""
        for outcome, count in zip(Outcome, counts.tolist(), strict=True):
            self._counts[outcome] += count

    def text(self) -> str:
        """Return such as "residual 46.6%, stop 53.4%", with 95 % intervals for random starts."""
        size = sum(self._counts.values())
        parts = []
        for outcome in (Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED):
            if count := self._counts[outcome]:
                share = share_of(count, size)
                part = f"{outcome.name.lower()} {share.share:.1%}"
                if self._random:
                    part += f" ({100 * share.low:.1f}-{100 * share.high:.1f})"
                parts.append(part)
        return ", ".join(parts)
