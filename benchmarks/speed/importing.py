"""Fresh processes: importing, and the first map, compared with importing the dependencies."""

import os
import statistics
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.reporting import measure
from benchmarks.reporting.speed import BASE, COLD_BASE, FIRST_MAP, LATER_MAP

OURS = "import dipoletop; dipoletop.sweep"  # names are loaded at their first use
MAP = "import sys; from dipoletop.cli import main; main(sys.argv[1:], standalone_mode=False)"


def _fresh(
    statement: str, *arguments: str, cwd: Path | None = None, cache: Path | None = None
) -> measure.Record:
    begin = perf_counter()
    # The process itself prints its processor time, including its start.
    code = f"{statement}\nimport time; print(time.process_time())"
    environment = dict(os.environ)
    if cache is not None:
        environment |= {"XDG_CACHE_HOME": str(cache), "LOCALAPPDATA": str(cache)}
        environment.pop("DIPOLETOP_CACHE", None)
    answer = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        check=True,
        capture_output=True,
        text=True,
        env=environment,
        cwd=cwd,
    )
    seconds = perf_counter() - begin
    return {"seconds": seconds, "processor_seconds": float(answer.stdout.split()[-1])}


def _map(size: int, cache: Path | None = None) -> measure.Record:
    """Measure `dipoletop map` in a new folder, with the given or an empty cache of machine code."""
    with tempfile.TemporaryDirectory() as folder:
        empty = Path(folder) / "cache"
        empty.mkdir()
        return _fresh(MAP, "map", f"--size={size}", cwd=Path(folder), cache=cache or empty)


def _compared(cases: dict[str, Any], base: str, repeats: int) -> dict[str, Any]:
    """Measure the cases, and the medians of their ratios to neighbouring runs of `base`."""
    measure.interleaved(cases, 1)  # a first time, to read the files from the disk
    records = measure.interleaved(cases, repeats)
    ratios = {}
    for name in cases:
        pairs = list(zip(records[name], records[base], strict=True))
        ratios[name] = {
            clock: statistics.median(ours[clock] / other[clock] for ours, other in pairs)
            for clock in ("seconds", "processor_seconds")
        }
    summaries = {name: measure.summary(runs) for name, runs in records.items()}
    return summaries | {"ratio": {name: ratios[name] for name in cases if name != base}}


def compare(repeats: int) -> dict[str, Any]:
    """Measure importing dipoletop and its dependencies; `ratio` compares neighbouring runs."""
    cases = {statement: partial(_fresh, statement) for statement in (OURS, BASE)}
    found = _compared(cases, BASE, repeats)
    return found | {"ratio": found["ratio"][OURS]}


def cold_start(repeats: int, size: int = 512) -> dict[str, Any]:
    """Measure the default map in fresh processes, with an empty and a full cache of machine code.

    `ratio` has for each of the two the median of the ratios to neighbouring runs of `COLD_BASE`.
    """
    with tempfile.TemporaryDirectory() as cache:
        cases = {
            FIRST_MAP: partial(_map, size),
            LATER_MAP: partial(_map, size, Path(cache)),
            COLD_BASE: partial(_fresh, COLD_BASE),
        }
        return _compared(cases, COLD_BASE, repeats) | {"points": size}
