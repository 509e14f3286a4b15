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
from jaxtyping import Array, Float

from .._base.compiling import special_numbers
from .._base.parallel import Device
from .._base.types import DecidingEquation, Equation
from .._engines.interface import Engine, Limits, Queue
from ..equations._common import physical
from .classification import Classification, stopping_rule
from .conditioning import with_error_estimates, without_error_estimates
from .label_doubt import CERTAIN, finish_of, made_twice
from .memory_limits import Lanes, in_fitting_parts, part_of, put_back
from .run_settings import RunSettings
from .slow_runs import (
    awaits_slow_flow,
    first_budget,
    is_open,
    may_be_predicted,
    predictions,
    why_unpredictable,
)

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
        return block.classified(limits)
    every, label_only, t1 = settings.slow_flow is True, settings.value is False, limits.t1
    possible = may_be_predicted(equation, omegas)
    slow = awaits_slow_flow(equation, omegas, limits, every, label_only) & (possible | every)
    rest = limits._replace(t1=np.where(slow, 0.0, t1).astype(t1.dtype)) if slow.any() else limits
    rest = rest._replace(max_steps=first_budget(equation, limits))
    runs = block.classified(rest)
    # Also to be predicted are runs that turn out to be long.
    slow |= runs.steps >= rest.max_steps
    unknown = is_open(runs, label_only) & (t1 > 0) & slow
    lanes = np.flatnonzero(unknown & possible)
    if not lanes.size:
        return runs
    found = predictions(*part_of((equation, omegas), lanes, slow.size), place.threads)
    if not every:  # the predicted L∞ shows which runs are not long after all
        steps = np.asarray(runs.steps[lanes])
        long = found.exceed_budget(limits, label_only, steps > 0)
        again = lanes[~long & (steps < limits.max_steps)]
        if again.size:
            runs = put_back(runs, again, block.some_classified(again, limits))
    filled = found.filled_in(part_of(runs, lanes, slow.size), label_only)
    return put_back(runs, lanes, filled)


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

    def classified(self, limits: Limits) -> Classification:
        """Return the classifications of all runs; of a run with t1 ≤ 0 by its first state."""
        value = self.settings.value
        if value is False and self.settings.in_two_passes:
            return self._outcomes(limits)
        runs, _, around = self.run(limits)
        if value is True:
            return with_error_estimates(runs, self.run_around, (self.omegas, around), limits)
        return runs if value is False else without_error_estimates(runs, value, np)

    def _outcomes(self, limits: Limits) -> Classification:
        """Return the classifications of runs whose outcome alone is wanted.

        There are two passes, unless the second one would cost as much without the first.
        """
        factor = LOOSE / float(limits.rtol)
        if factor <= 1 or self.place.engine.compiles_for_size or not made_twice(self.equation):
            return self.run(limits).runs
        brief = limits.loosened(factor)._replace(max_steps=np.minimum(BRIEF, limits.max_steps))
        runs, doubt, _ = self.run(brief)
        lanes = np.flatnonzero((doubt >= CERTAIN) & (np.asarray(limits.t1) > 0))
        return put_back(runs, lanes, self.run_some(lanes, limits)) if lanes.size else runs

    def some_classified(self, lanes: Lanes, limits: Limits) -> Classification:
        """Return the classifications of some runs.

        If a new number of runs would need a compilation, all are passed and the others rest.
        """
        size = self.omegas.shape[1]
        if self.place.engine.compiles_for_size:
            return part_of(self.classified(_only(lanes, limits, size)), lanes, size)
        block, limits = self.part(lanes, limits)
        return block.classified(limits)

    def part(self, lanes: Lanes, limits: Limits) -> tuple["RunBlock", Limits]:
        """Return some of the runs, and their limits."""
        parts = part_of((self.equation, self.omegas, limits), lanes, self.omegas.shape[1])
        equation, omegas, limits = parts
        return replace(self, equation=equation, omegas=omegas), limits

    def run(self, limits: Limits) -> Any:
        """Make all runs; return `Ended` in NumPy."""
        value, (engine, device, threads) = self.settings.value, self.place
        queue = Queue(self.equation, self.omegas, limits, stopping_rule(self.equation, value))
        # All arrays in one transfer.
        return jax.device_get(engine.classify(finish_of(value), queue, device, threads))

    def run_some(self, lanes: Lanes, limits: Limits) -> Classification:
        """Make some of the runs, as in `some_classified`."""
        size = self.omegas.shape[1]
        if self.place.engine.compiles_for_size:
            return part_of(self.run(_only(lanes, limits, size)).runs, lanes, size)
        block, limits = self.part(lanes, limits)
        return block.run(limits).runs

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
                each.append(replace(self, omegas=omegas).run_some(lanes, limits))
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
