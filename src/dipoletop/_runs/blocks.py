"""A block of runs on one device: the passes in which they are made, and their results.

An outcome is certain long before a motion is known exactly, and almost every start lies far from
the boundary between outcomes. So if only outcomes are wanted, a first pass is loose and brief. Runs
that did not end in it, or whose label is in doubt (`label_doubt`), are repeated at the requested
tolerance.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.compiling import special_numbers
from .._base.parallel import Device
from .._base.types import DecidingEquation, Equation
from .._engines.interface import Engine, Limits, Paused, Queue
from ..equations._common import physical
from .classification import Classification, stopping_rule
from .conditioning import with_error_estimates, without_error_estimates
from .label_doubt import CERTAIN, Ended, finish_of, made_twice
from .memory_limits import Lanes, in_fitting_parts, part_of, put_back
from .run_settings import RunSettings
from .slow_runs import Origins, first_budget, is_open, why_unpredictable

LOOSE = 1e-4  # relative tolerance of the first pass
BRIEF = 100  # largest number of steps in the first pass: all longer runs would be in doubt


class Place(NamedTuple):
    """Where runs are made."""

    engine: Engine
    device: Device
    threads: int = 1
    """How many threads share the queue, for an engine that has its own."""


def classify_block(
    equation: Equation,
    omegas: Float[np.ndarray, "3 N"] | Float[Array, "3 N"],
    limits: Limits,
    settings: RunSettings,
    place: Place,
) -> Classification:
    """Classify N runs on one device; the fields of `equation` carry a trailing axis of N lanes.

    Blocks that do not fit into the memory of the device are divided.
    """
    runs, size = (equation, omegas, limits, settings, place), omegas.shape[1]
    with special_numbers():
        return in_fitting_parts(_classified, runs, size, place.device)


def _classified(
    equation: Any, omegas: Any, limits: Limits, settings: RunSettings, place: Place
) -> Classification:
    """Return the classifications of all N runs at once, each by the law that is chosen for it."""
    block = RunBlock(physical(equation), omegas, settings, place)
    if settings.slow_flow is False or why_unpredictable(equation):
        ended = block.integrated(limits)
        return block.with_errors(ended.runs, ended.around, limits)
    every, label_only, t1 = settings.slow_flow is True, settings.value is False, limits.t1
    slow, size = np.ones(omegas.shape[1], bool), omegas.shape[1]
    if not every:
        slow = Origins.at_starts(equation, omegas).are_slow(limits, label_only)
    rest = limits._replace(t1=np.where(slow, 0.0, t1).astype(t1.dtype)) if slow.any() else limits
    rest = rest._replace(max_steps=first_budget(equation, limits))
    ended = block.integrated(rest, pauses=True)
    around = ended.around
    # Also to be predicted are runs that turn out to be long.
    slow = np.asarray((t1 > 0) & (slow | (ended.runs.steps >= rest.max_steps)))
    runs, again = _filled_in(equation, omegas, ended, slow, limits, settings, place.threads)
    if again.size:
        equation, omegas = part_of((equation, omegas), again, size)
        ended, slow = block.some_integrated(again, limits, ended.paused), np.ones(again.size, bool)
        more, _ = _filled_in(equation, omegas, ended, slow, limits, settings, place.threads)
        runs = put_back(runs, again, more)
    return block.with_errors(runs, around, limits)


def _filled_in(
    equation: Any,
    omegas: Any,
    ended: Ended,
    slow: Bool[np.ndarray, "N"],
    limits: Limits,
    settings: RunSettings,
    threads: int,
) -> tuple[Classification, Lanes]:
    """Predict what slow runs leave open; return also which of them their budget would decide."""
    every, label_only, size = settings.slow_flow is True, settings.value is False, slow.size
    lanes = np.flatnonzero(slow & is_open(ended.runs, label_only))
    if not lanes.size:
        return ended.runs, lanes
    equation, omegas, ended_here = part_of((equation, omegas, ended), lanes, size)
    runs, steps = ended_here.runs, np.asarray(ended_here.runs.steps)
    origins = Origins.of_runs(equation, omegas, ended_here.omega, steps)
    spent = np.full(lanes.size, every) | (steps >= limits.max_steps)
    predicted = (spent | origins.are_slow(limits, label_only)) & origins.may_have_law
    long, hopeful = spent, np.flatnonzero(predicted)
    if hopeful.size:
        found = part_of(origins, hopeful, lanes.size).predictions(threads)
        filled = found.filled_in(part_of(runs, hopeful, lanes.size), label_only)
        runs = put_back(runs, hopeful, filled)
        # The predicted L∞ shows which runs are not long after all.
        left = origins.left(limits)[hopeful]
        long[hopeful] |= found.need_more_than(left, limits, label_only)
    return put_back(ended.runs, lanes, runs), lanes[~long]


@dataclass(frozen=True)
class RunBlock:
    """N runs of one equation on one device, which the engine integrates.

    Attributes:
        equation: the equation to integrate; its array fields have a trailing axis of N lanes.
        omegas: the starts ω₀.
        settings: how they are run.
        place: where they are run.
    """

    equation: DecidingEquation
    omegas: Float[np.ndarray, "3 N"] | Float[Array, "3 N"]
    settings: RunSettings
    place: Place

    def integrated(
        self, limits: Limits, paused: Paused | None = None, *, pauses: bool = False
    ) -> Ended:
        """Return how all runs end; a run with t1 ≤ 0 by its first state.

        Args:
            limits: their limits.
            paused: where the runs go on; None: they begin.
            pauses: whether it is wanted where runs that are out of steps go on.
        """
        in_passes = self.settings.value is False and self.settings.in_two_passes
        if in_passes and paused is None:
            return self._outcomes(limits, pauses)
        return self.run(limits, paused, pauses)

    def with_errors(self, runs: Classification, around: Any, limits: Limits) -> Classification:
        """Add the errors of the integration, if ω∞ is wanted.

        Args:
            runs: the runs.
            around: the vicinity of their starts.
            limits: the limits of their neighbours.
        """
        value = self.settings.value
        if value is False:
            return runs
        if value is True:
            given = self.omegas, around
            return with_error_estimates(runs, self.run_around, given, limits)
        return without_error_estimates(runs, value, np)

    def _outcomes(self, limits: Limits, pauses: bool) -> Ended:
        """Return how runs end whose outcome alone is wanted.

        There are two passes, unless the second one would cost as much without the first.
        """
        factor = LOOSE / float(limits.rtol)
        if factor <= 1 or self.place.engine.compiles_for_size or not made_twice(self.equation):
            return self.run(limits, pauses=pauses)
        brief = limits.loosened(factor)._replace(max_steps=np.minimum(BRIEF, limits.max_steps))
        ended = self.run(brief, pauses=pauses)
        doubt: Any = ended.doubt
        lanes = np.flatnonzero((doubt >= CERTAIN) & (np.asarray(limits.t1) > 0))
        return put_back(ended, lanes, self.run_some(lanes, limits, pauses)) if lanes.size else ended

    def some_integrated(self, lanes: Lanes, limits: Limits, paused: Paused | None) -> Ended:
        """Return how some runs end, from where all were paused, if they were.

        If a new number of runs would need a compilation, all are passed and the others rest.
        """
        size = self.omegas.shape[1]
        if self.place.engine.compiles_for_size:
            return part_of(self.integrated(_only(lanes, limits, size)), lanes, size)
        block, limits = self.part(lanes, limits)
        return block.integrated(limits, part_of(paused, lanes, size))

    def part(self, lanes: Lanes, limits: Limits) -> tuple["RunBlock", Limits]:
        """Return some of the runs, and their limits."""
        parts = part_of((self.equation, self.omegas, limits), lanes, self.omegas.shape[1])
        equation, omegas, limits = parts
        return replace(self, equation=equation, omegas=omegas), limits

    def run(self, limits: Limits, paused: Paused | None = None, pauses: bool = False) -> Ended:
        """Make all runs, see `integrated`; the result is in NumPy."""
        value, (engine, device, threads) = self.settings.value, self.place
        until = stopping_rule(self.equation, value)
        queue = Queue(self.equation, self.omegas, limits, until, paused, pauses)
        ended, paused = engine.classify(finish_of(value), queue, device, threads)
        return jax.device_get(ended)._replace(paused=paused)  # all arrays in one transfer

    def run_some(self, lanes: Lanes, limits: Limits, pauses: bool = False) -> Ended:
        """Make some of the runs, as in `some_integrated`."""
        size = self.omegas.shape[1]
        if self.place.engine.compiles_for_size:
            return part_of(self.run(_only(lanes, limits, size)), lanes, size)
        block, limits = self.part(lanes, limits)
        return block.run(limits, pauses=pauses)

    def run_around(
        self, lanes: Lanes, limits: Limits, starts: Float[np.ndarray, "k 3 some"]
    ) -> Classification:
        """Make some of the runs from k other starts each; the results have shape (k, some)."""
        size, shape = self.omegas.shape[1], (len(starts), len(lanes))
        if self.place.engine.compiles_for_size:
            each = []
            for moved in starts:
                omegas = np.array(self.omegas)
                omegas[:, lanes] = moved
                each.append(replace(self, omegas=omegas).run_some(lanes, limits).runs)
            return jax.tree.map(lambda *x: np.stack(x), *each)
        equation, limits = part_of((self.equation, limits), np.tile(lanes, len(starts)), size)
        omegas = np.swapaxes(starts, 0, 1).reshape(3, -1)
        runs = replace(self, equation=equation, omegas=omegas).run(limits).runs
        return jax.tree.map(lambda x: x.reshape(*x.shape[:-1], *shape), runs)


def _only(lanes: Lanes, limits: Limits, size: int) -> Limits:
    """Return the limits with which only some of all runs take steps."""
    t1 = np.zeros(size, np.asarray(limits.t1).dtype)
    t1[lanes] = np.asarray(limits.t1)[lanes]
    return limits._replace(t1=t1)
