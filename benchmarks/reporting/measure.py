"""Clocks, interleaved repeats, fresh processes, and the provenance of a measurement."""

import contextlib
import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import diffrax

ROOT = Path(__file__).parents[2]  # the repository
Record = dict[str, Any]
"""One run: `seconds`, `processor_seconds` (of all cores) and its results."""

PACKAGES = ("dipoletop", "jax", "jaxlib", "diffrax", "equinox")
PACKAGES += ("numpy", "numba", "llvmlite", "scipy", "heyoka")


def timed(task: Callable[[], Any]) -> tuple[Any, Record]:
    """The task's result and its cost; the task must finish all its work before it returns."""
    begin, spent = perf_counter(), process_time()
    result = task()
    return result, {
        "seconds": perf_counter() - begin,
        "processor_seconds": process_time() - spent,
    }


def interleaved(
    cases: dict[Any, Callable[[], Record]], repeats: int, once: tuple[Any, ...] = ()
) -> dict[Any, list[Record]]:
    """Run A B C, A B C, …, so that other load on the machine slows all cases alike.

    Cases named in `once` take part in the first round only.
    """
    records: dict[Any, list[Record]] = {name: [] for name in cases}
    for round_ in range(repeats):
        for name, case in cases.items():
            if round_ == 0 or name not in once:
                records[name].append(case())
    return records


def evaluations(steps: float, starts: float, solver: Any = None) -> float:
    """Right-hand sides of so many steps, and two for each start to choose its first step.

    All methods here reuse the last stage of a step (FSAL), accepted or not.
    """
    tableau = (diffrax.Dopri8() if solver is None else solver).tableau
    assert tableau.fsal
    return steps * len(tableau.c) + 2 * starts


@contextlib.contextmanager
def confined(count: int) -> Iterator[None]:
    """Confine this thread, and the processes that it starts, to so many cores (Linux only)."""
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
    costs: Record = {"repeats": len(records)}
    for clock in ("seconds", "processor_seconds"):
        values = [record[clock] for record in records]
        costs[clock] = {"min": min(values), "median": statistics.median(values)}
    return costs


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
    """The command line of this run."""
    script, *options = sys.argv
    spec = sys.modules["__main__"].__spec__
    name = ["-m", spec.name] if spec else [str(Path(script).resolve().relative_to(ROOT))]
    return shlex.join(["python", *name, *options])


def this_run() -> str:
    """Command, date and number of cores of this run."""
    return f"`{command()}`, {date.today().isoformat()}, {cores()} cores"


def in_fresh_process(module: str, *arguments: Any) -> Any:
    """The JSON that a module prints when it is run in a process of its own."""
    line = [sys.executable, "-m", module, *map(str, arguments)]
    run = subprocess.run(line, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    return json.loads(run.stdout)


def load() -> float | None:
    """The load average over the last minute: how many processes want a core."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def _versions() -> dict[str, str]:
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def _processor() -> str:
    """The model of the processor, and its widest vector instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    pairs = (line.partition(":") for line in lines)
    about = {key.strip(): value.strip() for key, _, value in pairs}
    flags = about.get("flags", "").split()
    vectors = next((name for name in ("avx512f", "avx2") if name in flags), "")
    return ", ".join(part for part in (about.get("model name", ""), vectors) if part)
