"""Clocks, interleaved repeats, and what is said of the machine."""

import contextlib
import os
import platform
import shlex
import statistics
import sys
from collections.abc import Callable, Iterator
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import diffrax

Record = dict[str, Any]
"""One run: `seconds`, `processor_seconds` (all cores together) and whatever else came out."""

PACKAGES = (
    *("dipoletop", "jax", "jaxlib", "diffrax", "equinox", "numpy", "numba", "llvmlite"),
    *("scipy", "heyoka"),
)


def timed(task: Callable[[], Any]) -> tuple[Any, Record]:
    """What the task returns, and what it cost; it must not leave work behind."""
    begin, spent = perf_counter(), process_time()
    found = task()
    return found, {
        "seconds": perf_counter() - begin,
        "processor_seconds": process_time() - spent,
    }


def interleaved(
    cases: dict[Any, Callable[[], Record]], repeats: int, once: tuple[Any, ...] = ()
) -> dict[Any, list[Record]]:
    """A B C, A B C, …: so that whatever else the machine does harms all alike.

    Cases named in `once` take part in the first round only.
    """
    records: dict[Any, list[Record]] = {name: [] for name in cases}
    for round_ in range(repeats):
        for name, case in cases.items():
            if round_ == 0 or name not in once:
                records[name].append(case())
    return records


def evaluations(steps: float, starts: float, solver: Any = None) -> float:
    """Right-hand sides that so many steps take: two to choose the first step of each start.

    All methods here reuse the last slope of a step, accepted or not.
    """
    tableau = (diffrax.Dopri8() if solver is None else solver).tableau
    assert tableau.fsal
    return steps * len(tableau.c) + 2 * starts


@contextlib.contextmanager
def confined(count: int) -> Iterator[None]:
    """This thread, and the processes that it starts, on so many cores, where that can be had."""
    if not hasattr(os, "sched_setaffinity"):  # not Linux
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def summary(records: list[Record]) -> Record:
    """Minimum and median of both clocks."""
    found: Record = {"repeats": len(records)}
    for clock in ("seconds", "processor_seconds"):
        values = [record[clock] for record in records]
        found[clock] = {"min": min(values), "median": statistics.median(values)}
    return found


def cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine() -> Record:
    """Processor, cores, versions and date."""
    return {
        "date": date.today().isoformat(),
        "processor": _processor(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": {"python": platform.python_version()} | _versions(),
    }


def command() -> str:
    """The one that runs."""
    script, *options = sys.argv
    return shlex.join(["python", f"benchmarks/{Path(script).name}", *options])


def this_run() -> str:
    """The command, when, and on how much."""
    return f"`{command()}`, {date.today().isoformat()}, {cores()} cores"


def load() -> float | None:
    """How many processes want a core, averaged over a minute."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _processor() -> str:
    """The model, and the widest vectors it has."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    about = dict(line.split(":", 1) for line in lines if ":" in line)
    about = {key.strip(): value.strip() for key, value in about.items()}
    flags = about.get("flags", "").split()
    vectors = next((name for name in ("avx512f", "avx2") if name in flags), "")
    return ", ".join(part for part in (about.get("model name", ""), vectors) if part)
