"""Time of `import dipoletop`, and of importing the packages that it stands on."""

import statistics
import subprocess
import sys
from functools import partial
from time import perf_counter
from typing import Any

from benchmarks.reporting import measure
from benchmarks.reporting.speed import BASE

OURS = "import dipoletop"


def _fresh(statement: str) -> dict[str, Any]:
    begin = perf_counter()
    # The process itself prints the processor time that it spent, its start included.
    code = f"{statement}\nimport time; print(time.process_time())"
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    return {"seconds": perf_counter() - begin, "processor_seconds": float(answer.stdout)}


def compare(repeats: int) -> dict[str, Any]:
    """Both statements in fresh processes, and the median of the ratios of neighbours."""
    cases = {statement: partial(_fresh, statement) for statement in (OURS, BASE)}
    measure.interleaved(cases, 1)  # the first time the files are read from the disk
    records = measure.interleaved(cases, repeats)
    pairs = list(zip(records[OURS], records[BASE], strict=True))
    ratios = {
        clock: statistics.median(ours[clock] / base[clock] for ours, base in pairs)
        for clock in ("seconds", "processor_seconds")
    }
    return {name: measure.summary(runs) for name, runs in records.items()} | {"ratio": ratios}
