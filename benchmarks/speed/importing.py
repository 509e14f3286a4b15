"""Fresh processes: importing, and the first map, compared with importing the dependencies."""

import statistics
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.reporting import measure

OURS = "import dipoletop; dipoletop.sweep"  # names are loaded when they are used
BASE = "import jax, diffrax, equinox"
COLD_BASE = "import jax, diffrax, equinox, matplotlib.pyplot, xarray, zarr"
FIRST_MAP, LATER_MAP = "dipoletop map, the first time ever", "dipoletop map, later"
MAP = "import sys; from dipoletop.cli import main; main(sys.argv[1:], standalone_mode=False)"


def _fresh(statement: str, *arguments: str, **where: Any) -> measure.Record:
    # The process itself prints the processor time that it spent, its start included.
    code = f"{statement}\nimport time; print(time.process_time())"
    printed, clocks = measure.timed(measure.run_fresh, "-c", code, *arguments, quiet=True, **where)
    return clocks | {"processor_seconds": float(printed.split()[-1])}


def _map(size: int, cache: str | None = None) -> measure.Record:
    """`dipoletop map` in a new folder; with an empty cache of machine code unless one is given."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as empty:
        return _fresh(MAP, "map", f"--size={size}", cwd=Path(folder), cache=cache or empty)


def _compared(cases: dict[str, Any], base: str, repeats: int) -> dict[str, Any]:
    """Measure the cases, and the medians of their ratios to neighbouring runs of `base`."""
    measure.interleaved(cases, 1)  # a first time, to read the files from the disk
    records = measure.interleaved(cases, repeats)
    ratios = {
        name: {
            clock: statistics.median(
                ours[clock] / other[clock] for ours, other in zip(runs, records[base], strict=True)
            )
            for clock in measure.CLOCKS
        }
        for name, runs in records.items()
        if name != base
    }
    return {name: measure.summary(runs) for name, runs in records.items()} | {"ratio": ratios}


def compare(repeats: int) -> dict[str, Any]:
    """Measure importing dipoletop and its dependencies; `ratio` compares neighbouring runs."""
    cases = {statement: partial(_fresh, statement) for statement in (OURS, BASE)}
    found = _compared(cases, BASE, repeats)
    return found | {"ratio": found["ratio"][OURS]}


def cold_start(repeats: int, size: int) -> dict[str, Any]:
    """The default map in fresh processes, with an empty cache of machine code and with a full one.

    `ratio` has for each of the two the median of the ratios to neighbouring runs of `COLD_BASE`.
    """
    with tempfile.TemporaryDirectory() as cache:
        cases = {
            FIRST_MAP: partial(_map, size),
            LATER_MAP: partial(_map, size, cache),
            COLD_BASE: partial(_fresh, COLD_BASE),
        }
        return _compared(cases, COLD_BASE, repeats) | {"points": size}
