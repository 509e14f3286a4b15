"""Importing in fresh processes, compared with importing the dependencies."""

import statistics
from functools import partial
from typing import Any

from benchmarks.reporting import measure

OURS = "import dipoletop; dipoletop.sweep"  # names are loaded when they are used
BASE = "import jax, diffrax, equinox"


def _fresh(statement: str) -> measure.Record:
    # The process itself prints the processor time that it spent, its start included.
    code = f"{statement}\nimport time; print(time.process_time())"
    printed, clocks = measure.timed(measure.run_fresh, "-c", code)
    return clocks | {"processor_seconds": float(printed)}


def compare(repeats: int) -> dict[str, Any]:
    """Measure importing dipoletop and its dependencies; `ratio` compares neighbouring runs."""
    cases: dict[Any, Any] = {statement: partial(_fresh, statement) for statement in (OURS, BASE)}
    measure.interleaved(cases, 1)  # a first time, to read the files from the disk
    records = measure.interleaved(cases, repeats)
    pairs = list(zip(records[OURS], records[BASE], strict=True))
    ratio = {
        clock: statistics.median(ours[clock] / other[clock] for ours, other in pairs)
        for clock in measure.CLOCKS
    }
    return {name: measure.summary(runs) for name, runs in records.items()} | {"ratio": ratio}
