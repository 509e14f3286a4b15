"""Work and precision: end states at a fixed time, cost against true error.

Isotropic starts with |ω| = 0.2 of the top with δ = −1/5, at τ = 1000. The error is the largest
component of the difference from a reference, over |ω₀|. Every method has one core, in a process
that may use no other, because XLA counts the cores once.
"""

from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers.end_states import AMPLITUDE, SCIPY, Starts, Task, methods, reference, starts
from benchmarks.reporting import measure


def alone(small: bool) -> dict[str, Any]:
    """`compare` in a process with one core."""
    few, many = (64, 2, (1e-6, 1e-9)), (16384, 7, [10.0**-k for k in range(6, 13)])
    with measure.confined(1):
        return measure.in_fresh_process(compare, *(few if small else many))


def compare(n: int, repeats: int, tolerances: tuple[float, ...]) -> dict[str, Any]:
    """Measure cost and true error of all methods at all tolerances."""
    omegas = starts(n)
    truth, about = reference(omegas)
    everybody, missing = methods()
    cases, first = {}, {}
    for name, prepare in everybody.items():
        for rtol in tolerances:
            ready, clocks = measure.timed(lambda p=prepare, rtol=rtol: _warm(p(omegas, rtol)))
            first.setdefault(name, clocks["seconds"])
            cases[name, rtol] = partial(_case, ready)
    slow = tuple(case for case in cases if case[0] == SCIPY)
    records = measure.interleaved(cases, repeats, once=slow)
    rows = [
        measure.summary(runs)
        | {"name": name, "rtol": rtol, "starts": len(runs[0]["ends"])}
        | errors(runs[0]["ends"], truth)
        for (name, rtol), runs in records.items()
    ]
    about = {"starts": n, "repeats": repeats, "reference": about, "missing": missing}
    return about | {"first_seconds": first, "rows": rows}


def _warm(task: Task) -> Task:
    task()
    return task


def _case(task: Task) -> dict[str, Any]:
    ends, clocks = measure.timed(task)
    return clocks | {"ends": ends}


def errors(ends: Starts, truth: Starts) -> dict[str, float]:
    """Return the largest and the median error over the common starts."""
    both = min(len(ends), len(truth))
    error = np.max(np.abs(ends[:both] - truth[:both]), axis=1) / AMPLITUDE
    return {"largest_error": float(np.max(error)), "median_error": float(np.median(error))}
