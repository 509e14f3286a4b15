"""The first outcomes by each integrator in a fresh process: its total time and its memory.

Imports, compilation and a few starts of the mixed basin are in the time; what an integrator keeps
on the disk is missing the first time and there later.
"""

import importlib
import importlib.util
import os
import tempfile
from functools import partial
from typing import Any

from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure

# Each process shall import what its integrator needs, so imports are in the functions.
RTOL = 1e-8
WAYS = ("native", "jax", "heyoka", "diffrax")


def compare(n: int, repeats: int) -> dict[str, Any]:
    """For each way that can run here the first process, the later ones, and the largest memory."""
    ways = [way for way in WAYS if way != "heyoka" or importlib.util.find_spec("heyoka")]
    with tempfile.TemporaryDirectory() as folder:
        cases: dict[Any, Any] = {way: partial(_process, way, n, folder) for way in ways}
        first = measure.interleaved(cases, 1)
        later = measure.interleaved(cases, repeats)
    rows = [
        {"name": way, "first_seconds": first[way][0]["seconds"], **measure.summary(runs)}
        | {"peak_bytes": max(run["peak_bytes"] for run in runs)}
        for way, runs in later.items()
    ]
    return {"starts": n, "rtol": RTOL, "rows": rows}


def _process(way: str, n: int, cache: str) -> measure.Record:
    """One process whose caches are in a folder; its clocks and its memory."""
    found, clocks = measure.timed(measure.in_fresh_process, report, way, n, cache=cache)
    return clocks | found


def report(way: str, n: int) -> dict[str, Any]:
    """Label n starts in this process: its memory, and its processor seconds."""
    deltas, omegas = mixed_basin.sample(n)
    if way in ("native", "jax"):
        import dipoletop as dt

        settings: Any = {"rtol": RTOL, "max_steps": mixed_basin.MAX_STEPS, "engine": way}
        dt.classify_many(dt.TransverseReduced(deltas), omegas, value=False, **settings)
    else:
        importlib.import_module(f"benchmarks.peers.with_{way}").run(deltas, omegas, RTOL)
    # heyoka's processes are as many as there are cores. (JAX starts small ones of the system.)
    helpers = (os.cpu_count() or 1) * (way == "heyoka")
    peak = measure.peak_memory() + helpers * measure.peak_memory(children=True)
    # its children's processor seconds, too
    return {"peak_bytes": peak, "processor_seconds": sum(os.times()[:4])}
