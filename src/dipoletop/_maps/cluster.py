"""Sweeps on a Dask cluster: its workers claim tiles, compute them, and write them to the store.

A task is one tile. Nothing comes back but how many of its starts have each outcome. A worker that
dies loses its claims, so that another one computes its tile; one that is slow keeps them, and the
tile is computed once.
"""

import functools
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from .._base.checks import refuse
from .._base.digests import digest
from .._base.parallel import as_worker
from .sweep_plan import Plan, plan_of
from .sweep_stores import Store, ZarrStore

LARGE = 1 << 20  # bytes of a sweep from which they are sent once to each worker
AHEAD = 4  # tasks in flight for each thread of the cluster
KEPT = 4  # sweeps that a worker keeps at hand
CONFIG = "jax_enable_x64", "jax_threefry_partitionable", "jax_default_prng_impl"
"""Settings of JAX on which numbers depend; they travel to the workers."""
RETRIES = 5  # of a tile whose worker died or whose task failed


def on_cluster(
    client: Any, plan: Plan, store: Store
) -> Callable[[Sequence[int]], Iterator[tuple[int, np.ndarray | None]]]:
    """A function that has tiles computed by the workers of a client, and yields those finished.

    Raises:
        ValueError: `client` is none, or there is no store.
    """
    try:
        import cloudpickle
        from distributed import Client
    except ImportError:
        must = "be None without the library distributed (`pip install 'dipoletop[dask]'`)"
        refuse("client", must, f"is {client!r}")
    if not isinstance(client, Client):
        refuse("client", "be a distributed.Client, or None", f"is {client!r}")
    if not isinstance(store, ZarrStore):
        refuse("store", "be a path that all workers see, with a `client`", "is None")
    store.close()  # the workers claim tiles, which may be threads of this process
    sweep = plan.blocks.problem, plan.blocks.over, plan.settings._replace(devices=None)
    config = {name: getattr(jax.config, name) for name in CONFIG}
    job = cloudpickle.dumps((*sweep, config))
    return functools.partial(_compute_once, client, job, str(store.folder))


def _compute_once(
    client: Any, job: bytes, folder: str, tiles: Sequence[int]
) -> Iterator[tuple[int, np.ndarray | None]]:
    from distributed import as_completed

    name = digest(job).hex()
    sent = client.scatter(job, broadcast=True, hash=False) if len(job) > LARGE else job
    left, running = iter(tiles), as_completed()

    def submit(count: int) -> None:
        for _, tile in zip(range(count), left, strict=False):
            settings = {"pure": False, "retries": RETRIES}
            running.add(client.submit(_compute_tile, sent, name, folder, tile, **settings))

    threads = sum(client.nthreads().values()) or 1
    try:
        submit(AHEAD * threads)
        for future in running:
            tile, finished, counts = future.result()
            submit(1)
            if finished:
                yield tile, counts
    finally:
        client.cancel(list(running.futures))


class _Session(NamedTuple):
    """A sweep on a worker."""

    name: str
    plan: Plan
    store: ZarrStore


_sessions: dict[str, _Session] = {}  # by the folder of the store
_lock = threading.Lock()


def _compute_tile(
    job: bytes, name: str, folder: str, tile: int
) -> tuple[int, bool, np.ndarray | None]:
    """Compute a tile on a worker: its number, whether it is finished, and its counts if found."""
    _, plan, store = _session(job, name, folder)
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


def _session(job: bytes, name: str, folder: str) -> _Session:
    """The plan and the store of a sweep on this worker, whose digests are compared."""
    import cloudpickle

    with _lock:
        session = _sessions.get(folder)
        if session is None or session.name != name:
            problem, over, settings, config = cloudpickle.loads(job)
            for option, value in config.items():
                jax.config.update(option, value)
            plan = plan_of(problem, over, settings)
            # A store has one sweep in a process; the oldest ones are given up.
            for old in [folder, *list(_sessions)[: 1 - KEPT]]:
                if old in _sessions:
                    _sessions.pop(old).store.close()
            session = _sessions[folder] = _Session(name, plan, ZarrStore(folder, plan, False))
        return session
