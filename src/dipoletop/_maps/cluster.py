"""Sweeps on a Dask cluster: its workers compute the tiles, and write them to the store.

A task is one tile: a worker claims it, computes it and writes it. It returns only how many of its
starts have each outcome. If the scheduler is lost, its queue of tasks is lost, but not the finished
tiles. A worker that dies loses its claims, so that another one computes its tile. A slow worker
keeps them, so that the tile is computed once.
"""

import contextlib
import functools
import importlib.metadata
import itertools
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from .._base.digests import digest
from .._base.parallel import as_worker
from .._base.refusals import one_line, refuse
from .._engines.processors import host_processor
from .store.errors import StoreMismatch
from .sweep_plan import Plan, plan_of
from .sweep_stores import Store, ZarrStore

LARGE = 1 << 20  # bytes; a larger sweep is sent only once to each worker
AHEAD = 4  # tasks in flight for each thread of the cluster
LOOK = 1.0  # seconds until the threads of the cluster are counted again
RETRIES = 5  # for a tile whose task failed
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


def on_cluster(
    client: Any, plan: Plan, store: Store
) -> Callable[[Sequence[int]], Iterator[tuple[int, np.ndarray | None]]]:
    """Return a function that has the workers of a client compute tiles, and yields finished ones.

    Raises:
        ValueError: `client` is not a client, or is closed; its cluster has no dipoletop; there is
            no store on disk.
        ConnectionError: the scheduler is lost.
    """
    try:
        from distributed import Client
    except ImportError:
        must = "be None without the library distributed (`pip install 'dipoletop[dask]'`)"
        refuse("client", must, f"is {client!r}")
    if not isinstance(client, Client):
        refuse("client", "be a distributed.Client, or None", f"is {client!r}")
    if client.status in ("closing", "closed"):
        refuse("client", "be connected to a scheduler", "is closed")
    if not isinstance(store, ZarrStore):
        refuse("store", "be a path that all workers see, with a `client`", "is None")
    with _reaching(client, store):
        await_worker(client)
    store.close()  # the workers claim tiles, which may be threads of this process
    job = job_of(plan, store.tiles.folder)
    return functools.partial(_compute_once, client, job, store)


def await_worker(client: Any, seconds: float | None = None) -> None:
    """Wait until a worker has answered, at most `seconds`.

    Raises:
        ValueError: the worker or the scheduler has no dipoletop, so that tasks would fail.
        TimeoutError: no worker has answered.
    """
    what = importlib.metadata.version, "dipoletop"
    asked = "scheduler"
    try:
        client.run_on_scheduler(*what)
        asked = "worker that has answered"
        # The question is sent as a task, since some clusters start workers only for tasks.
        client.submit(*what, pure=False).result(timeout=seconds)
    except importlib.metadata.PackageNotFoundError:
        refuse(
            "client", "have a scheduler and workers with dipoletop", f"the {asked} is without it"
        )


def _compute_once(
    client: Any, job: ClusterJob, store: ZarrStore, tiles: Sequence[int]
) -> Iterator[tuple[int, np.ndarray | None]]:
    """Yield the tiles as they are finished; tiles claimed by other processes are left out.

    Raises:
        ConnectionError: the scheduler is lost, or too many workers are.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    left, running, at_most, until = iter(tiles), as_completed(loop=client.loop), 0, 0.0

    def submit() -> None:
        """Keep all threads busy; workers come and go."""
        nonlocal at_most, until
        if time.monotonic() >= until:
            at_most = AHEAD * max(sum(client.nthreads().values()), 1)
            until = time.monotonic() + LOOK
        for tile in itertools.islice(left, max(at_most - running.count(), 0)):
            running.add(client.submit(compute_tile, sent, tile, pure=False, retries=RETRIES))

    with contextlib.ExitStack() as stack:
        with _reaching(client, store):
            sent = _kept_by_workers(client, job) if len(job.sweep) > LARGE else job
            stack.callback(_cancel, client, running)
            submit()
        for future in running:
            try:
                if future.status == "error":
                    future.result()  # raises the error of the tile
            except KilledWorker as error:
                died = f"The workers died {error.allowed_failures + 1} times with the same tile"
                raise ConnectionError(f"{died}; {_kept(store)}") from error
            with _reaching(client, store):
                tile, finished, counts = future.result()
                submit()
            if finished:
                yield tile, counts


def _kept_by_workers(client: Any, job: ClusterJob) -> Any:
    """Return a job that is sent once to each worker, and again if all workers with it are lost.

    Dask would not send scattered data again.
    """
    import dask.config

    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 EB"}):
        return client.submit(ClusterJob, *job, pure=False)


@contextlib.contextmanager
def _reaching(client: Any, store: ZarrStore) -> Iterator[None]:
    """Raise an error that says what is kept if the scheduler is lost or has lost its tasks."""
    from distributed import CancelledError
    from distributed.client import ClosedClientError

    try:
        yield
    except (CancelledError, ClosedClientError, OSError) as error:
        lost = f"The Dask scheduler {client.scheduler.address} was lost, or lost its tasks"
        reason = getattr(error, "reason", None) or one_line(error)
        raise ConnectionError(f"{lost} ({reason}); {_kept(store)}") from error


def _kept(store: ZarrStore) -> str:
    finished, count = store.progress()
    return (
        f"{finished} of the {count} tiles of {store.tiles.folder} are finished and kept, and the "
        "same sweep goes on from there."
    )


def _cancel(client: Any, running: Any) -> None:
    """End the tasks of this sweep that the scheduler still has."""
    if client.status == "running":
        client.cancel(list(running.futures))


def job_of(plan: Plan, folder: Path) -> ClusterJob:
    """Return the sweep of a plan in the form in which it is sent to workers."""
    import cloudpickle

    config = {name: getattr(jax.config, name) for name in CONFIG}
    blocks, settings = plan.blocks, plan.settings._replace(devices=None)
    more = {"derivatives": blocks.derivatives, "confirm": plan.confirm, "reduction": plan.reduction}
    sweep = cloudpickle.dumps(((blocks.problem, blocks.over, settings), more, config))
    return ClusterJob(str(folder), sweep, digest(sweep).hex(), versions_here())


def versions_here() -> dict[str, str]:
    """Return the versions of Python and of the libraries in this process."""
    found = {"Python": platform.python_version(), "the processor": host_processor()}
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
            arguments, more, config = cloudpickle.loads(job.sweep)
            for option, value in config.items():
                jax.config.update(option, value)
            plan = plan_of(*arguments, **more)
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
