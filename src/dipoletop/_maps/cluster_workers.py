"""The part of a sweep that a worker of a Dask cluster does: claim a tile, compute it, write it.

A worker that dies loses its claims, so that another one computes its tile. A slow worker keeps
them, so that the tile is computed once.
"""

import importlib.metadata
import platform
import sys
import threading
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from .._base.checks import refuse
from .._base.digests import digest
from .._base.parallel import as_worker
from .store.errors import StoreMismatch
from .sweep_plan import Plan, plan_of
from .sweep_stores import ZarrStore

KEPT = 4  # sweeps that a worker keeps in memory
CONFIG = "jax_enable_x64", "jax_threefry_partitionable", "jax_default_prng_impl"
"""Settings of JAX on which numbers depend; they travel to the workers."""
LIBRARIES = "dipoletop", "jax", "jaxlib", "numpy", "llvmlite"
"""Libraries on whose versions a sweep may depend."""


class ClusterJob(NamedTuple):
    """A sweep in the form in which it is sent to the workers."""

    folder: str
    """The folder of its store."""
    sweep: bytes
    """The problem, the points, the settings and JAX's settings, pickled."""
    name: str
    """A digest of `sweep`."""
    versions: dict[str, str]
    """Versions in the process that called the sweep."""


def job_of(plan: Plan, folder: Path) -> ClusterJob:
    """Return the sweep of a plan in the form in which it is sent to workers."""
    import cloudpickle

    config = {name: getattr(jax.config, name) for name in CONFIG}
    problem, over = plan.blocks.problem, plan.blocks.over
    settings = plan.settings._replace(devices=None)
    sweep = cloudpickle.dumps((problem, over, settings, config))
    return ClusterJob(str(folder), sweep, digest(sweep).hex(), versions_here())


def versions_here() -> dict[str, str]:
    """Return the versions of Python and of the libraries in this process."""
    found = {"Python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "none"
    return found


def compute_tile(job: ClusterJob, tile: int) -> tuple[int, bool, np.ndarray | None]:
    """Compute a tile; return its number, whether it is finished, and its counts if found here.

    Raises:
        ValueError: this worker cannot work on the sweep.
    """
    _, plan, store = _session(job)
    if not store.claim(tile):
        return tile, store.is_finished(tile), None
    device = plan.devices[tile % len(plan.devices)]
    try:
        with jax.default_device(device), as_worker():
            (computed,) = plan.compute([tile], device)
        store.write(computed)
    except BaseException:
        store.give_back(tile)
        raise
    return tile, True, computed.outcomes


class _Session(NamedTuple):
    """A sweep on a worker."""

    name: str
    plan: Plan
    store: ZarrStore


_sessions: dict[str, _Session] = {}  # by the folder of the store
_lock = threading.Lock()


def _session(job: ClusterJob) -> _Session:
    """Return the plan and the store of a sweep on this worker, after comparing their digests."""
    import cloudpickle

    with _lock:
        session = _sessions.get(job.folder)
        if session is None or session.name != job.name:
            _check_python(job)
            problem, over, settings, config = cloudpickle.loads(job.sweep)
            for option, value in config.items():
                jax.config.update(option, value)
            plan = plan_of(problem, over, settings)
            # A store has one sweep in a process; the oldest sweeps are dropped.
            for old in [job.folder, *list(_sessions)[: 1 - KEPT]]:
                if old in _sessions:
                    _sessions.pop(old).store.close()
            session = _sessions[job.folder] = _Session(job.name, plan, _store(job, plan))
        return session


def _check_python(job: ClusterJob) -> None:
    """Refuse another Python version: functions are pickled as byte code, which it cannot read."""
    there = job.versions["Python"]
    if there.split(".")[:2] != [str(part) for part in sys.version_info[:2]]:
        has = f"the one on {platform.node()} has Python {platform.python_version()}"
        refuse("client", f"have workers with Python {there}, as its process has", has)


def _store(job: ClusterJob, plan: Plan) -> ZarrStore:
    """Return the store that the client has made."""
    node = platform.node()
    if not Path(job.folder).is_dir():  # a folder made here may be invisible to others
        was = f"is {job.folder}, where the worker on {node} finds nothing"
        refuse("store", "be a path that all workers see", was)
    try:
        return ZarrStore(job.folder, plan, False)
    except StoreMismatch as error:  # the client could open it, so this worker differs
        here, there = versions_here(), job.versions
        others = [f"{x} {here[x]}, not {there[x]}" for x in here if here[x] != there[x]]
        remark = f" (it has {'; '.join(others)})" if others else ""
        does = f"the one on {node} does not{remark}: {error.reason}"
        refuse("client", "have workers that compute this very sweep", does)
