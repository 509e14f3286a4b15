"""How long importing takes, beside the packages that any such program imports."""

import statistics
import subprocess
import sys
from functools import partial
from time import perf_counter
from typing import Any

import measure

OURS, BASE = "import dipoletop", "import jax, diffrax, equinox"


def _fresh(statement: str) -> dict[str, Any]:
    begin = perf_counter()
    # What the process itself spent, told by itself: start, imports and all.
    told = f"{statement}\nimport time; print(time.process_time())"
    answer = subprocess.run(
        [sys.executable, "-c", told], check=True, capture_output=True, text=True
    )
    return {"seconds": perf_counter() - begin, "processor_seconds": float(answer.stdout)}


def compare(repeats: int) -> dict[str, Any]:
    """Both statements in fresh processes, and the median of the ratios of neighbours."""
    cases = {statement: partial(_fresh, statement) for statement in (OURS, BASE)}
    measure.interleaved(cases, 1)  # files come from the disk the first time
    records = measure.interleaved(cases, repeats)
    pairs = list(zip(records[OURS], records[BASE], strict=True))
    ratios = {
        clock: statistics.median(ours[clock] / base[clock] for ours, base in pairs)
        for clock in ("seconds", "processor_seconds")
    }
    return {name: measure.summary(found) for name, found in records.items()} | {"ratio": ratios}
