"""Clocks, memory, interleaved repeats, fresh processes, and the provenance of a measurement.

python -m benchmarks.reporting.measure MODULE FUNCTION '[1, "native"]'     its result in JSON
"""

import contextlib
import importlib
import json
import os
import platform
import re
import resource
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

# Fresh processes begin here: no import that takes long, or much memory.
ROOT = Path(__file__).parents[2]  # the repository
Record = dict[str, Any]
"""One run: `seconds`, `processor_seconds` (of all cores) and its results."""

CLOCKS = "seconds", "processor_seconds"
PACKAGES = ("dipoletop", "jax", "jaxlib", "diffrax", "equinox")
PACKAGES += ("numpy", "llvmlite", "scipy", "heyoka")
OURS_ONLY = "DIPOLETOP_CACHE", "JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"  # not set by users


def timed(task: Callable[..., Any], *given: Any, **settings: Any) -> tuple[Any, Record]:
    """The task's result and its cost; the task must finish all its work before it returns."""
    begin, spent = perf_counter(), process_time()
    result = task(*given, **settings)
    return result, dict(zip(CLOCKS, (perf_counter() - begin, process_time() - spent), strict=True))


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


def summary(records: list[Record]) -> Record:
    """Minimum and median of both clocks."""
    costs: Record = {"repeats": len(records)}
    for clock in CLOCKS:
        values = [record[clock] for record in records]
        costs[clock] = {"min": min(values), "median": statistics.median(values)}
    return costs


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


def cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def peak_memory(*, children: bool = False) -> int:
    """The largest resident memory of this process, or of its largest child that has ended; bytes.

    Linux's own counter first: getrusage counts the process that started this one, too.
    """
    status = Path("/proc/self/status")
    if not children and status.exists():
        found = re.search(r"VmHWM:\s*(\d+)", status.read_text())
        if found:
            return 1024 * int(found[1])
    who = resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF
    return (1 if sys.platform == "darwin" else 1024) * resource.getrusage(who).ru_maxrss


def load() -> float:
    """The load average over the last minute: how many processes want a core."""
    return os.getloadavg()[0]


def machine() -> Record:
    """Processor, cores, versions and date."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "date": date.today().isoformat(),
        "processor": _processor(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": versions,
    }


def _processor() -> str:
    """The model of the processor, and its widest vector instructions."""
    place = Path("/proc/cpuinfo")
    text = place.read_text() if place.exists() else ""
    model = re.search(r"model name\s*:\s*(.*)", text)
    vectors = next((name for name in ("avx512f", "avx2") if name in text), "")
    return ", ".join(filter(None, (model[1] if model else platform.processor(), vectors)))


def command() -> str:
    """The command line of this run."""
    script, *options = sys.argv
    spec = sys.modules["__main__"].__spec__
    name = ["-m", spec.name] if spec else [str(Path(script).resolve().relative_to(ROOT))]
    return shlex.join(["python", *name, *options])


def run_fresh(*line: str, cache: Any = None) -> str:
    """What Python prints in a process of its own, with float64; `cache`: a user's, with it."""
    environment = os.environ | {"JAX_ENABLE_X64": "1"}
    if cache is not None:
        for name in OURS_ONLY:
            environment.pop(name, None)
        environment |= {"XDG_CACHE_HOME": str(cache), "LOCALAPPDATA": str(cache)}
    settings: Any = {"check": True, "text": True, "cwd": ROOT, "env": environment}
    settings |= {"stdout": subprocess.PIPE}
    return subprocess.run([sys.executable, *line], **settings).stdout


def in_fresh_process(function: Callable[..., Any], *arguments: Any, cache: Any = None) -> Any:
    """What a function gives in a process of its own; all of it is made of JSON."""
    module = function.__module__
    if module == "__main__":
        module = sys.modules["__main__"].__spec__.name
    given = function.__name__, json.dumps(arguments)
    return json.loads(run_fresh("-m", __name__, module, *given, cache=cache))


if __name__ == "__main__":
    called = getattr(importlib.import_module(sys.argv[1]), sys.argv[2])
    print(json.dumps(called(*json.loads(sys.argv[3]))))
