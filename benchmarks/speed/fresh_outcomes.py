"""The first outcomes by each integrator in a fresh process: its total time and its memory.

The time includes imports, compilation and a few starts of the mixed basin. An integrator's cache
on disk is empty the first time and full later.

    python -m benchmarks.speed.fresh_outcomes heyoka 4096     one process: its memory in JSON
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

# Each process should import only what its integrator needs, so imports are in the functions.
RTOL = 1e-8
WAYS = ("native", "jax", "heyoka", "diffrax")


def compare(n: int, repeats: int) -> dict[str, Any]:
    """Measure for each available integrator the first process, later ones, and the memory."""
    from benchmarks.reporting import measure

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        cases: dict[Any, Any] = {way: partial(_process, way, n, Path(folder)) for way in WAYS}
        cases = {way: case for way, case in cases.items() if _runs_here(way)}
        first = measure.interleaved(cases, 1)
        later = measure.interleaved(cases, repeats)
    for way, runs in later.items():
        peaks = [run["peak_bytes"] for run in runs if run["peak_bytes"] is not None]
        row = {"name": way, "first_seconds": first[way][0]["seconds"], **measure.summary(runs)}
        rows.append(row | {"peak_bytes": max(peaks, default=None)})
    return {"starts": n, "rtol": RTOL, "rows": rows}


def _runs_here(way: str) -> bool:
    return way != "heyoka" or importlib.util.find_spec("heyoka") is not None


def _process(way: str, n: int, cache: Path) -> dict[str, Any]:
    """Run a process with its caches in a folder; return its clocks and its memory."""
    from benchmarks.reporting import measure

    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "LOCALAPPDATA": str(cache)}
    environment.pop("DIPOLETOP_CACHE", None)
    line = [sys.executable, "-m", __name__, way, str(n)]
    settings: Any = {"check": True, "stdout": subprocess.PIPE, "text": True, "env": environment}
    run, clocks = measure.timed(lambda: subprocess.run(line, cwd=measure.ROOT, **settings))
    return clocks | json.loads(run.stdout)


def report(way: str, n: int) -> dict[str, Any]:
    """Label n starts in this process; return its memory and its processor seconds."""
    from benchmarks.problems import mixed_basin
    from benchmarks.reporting.memory import peak_memory, peak_memory_of_children

    deltas, omegas = mixed_basin.sample(n)
    if way in ("native", "jax"):
        jax = importlib.import_module("jax")
        jax.config.update("jax_enable_x64", True)
        import dipoletop as dt

        equations = dt.TransverseReduced(jax.numpy.asarray(deltas))
        settings: Any = {"rtol": RTOL, "max_steps": mixed_basin.MAX_STEPS, "engine": way}
        dt.classify_many(equations, omegas, value=False, **settings)
    elif way == "heyoka":
        importlib.import_module("benchmarks.peers.with_heyoka").run(deltas, omegas, RTOL)
    else:
        importlib.import_module("jax").config.update("jax_enable_x64", True)
        importlib.import_module("benchmarks.peers.with_diffrax").run(deltas, omegas, RTOL)
    own, child = peak_memory(), peak_memory_of_children()
    # heyoka has one process for each core. (JAX starts small system processes.)
    helpers = (os.cpu_count() or 1) * (child or 0) if way == "heyoka" else 0
    return {
        "peak_bytes": None if own is None or child is None else own + helpers,
        "processor_seconds": sum(os.times()[:4]),  # its children's too
    }


if __name__ == "__main__":
    print(json.dumps(report(sys.argv[1], int(sys.argv[2]))))
