"""All cores and all devices: one thread for each, with its own dispatch."""

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any, TypeVar

import jax

from .checks import refuse

if TYPE_CHECKING:  # for a type checker `jax.Device` is a variable, no type
    from jaxlib._jax import Device
else:
    Device = jax.Device

T = TypeVar("T")
_here = threading.local()


def workers(devices: Sequence[Any] | None = None) -> list[Any]:
    """The devices to use, each as often as threads shall feed it.

    An accelerator is fed by one thread. A processor runs a small program on one core, so its
    devices get as many threads as the process may use cores.
    """
    if getattr(_here, "inside", False):  # of a worker, who would wait for himself
        refuse(
            "problem",
            "not itself call `sweep` or `classify_many`, whose workers would wait for each other",
            "does (find what it needs beforehand, and let it use the numbers)",
        )
    devices = jax.devices() if devices is None else _listed(devices)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    hosts = [device for device in devices if device.platform == "cpu"]
    others = [device for device in devices if device.platform != "cpu"]
    threads = max(len(hosts), cores or 1) if hosts else 0
    return others + [hosts[i % len(hosts)] for i in range(threads)]


def _listed(devices: Any) -> list[Any]:
    listed = [] if isinstance(devices, str) or not isinstance(devices, Iterable) else list(devices)
    if not listed or not all(isinstance(device, jax.Device) for device in listed):
        refuse(
            "devices",
            "list at least one of JAX's devices, as `jax.devices('cpu')` does, or be None",
            f"is {devices!r}",
        )
    return listed


@contextlib.contextmanager
def inside() -> Iterator[None]:
    """Marks this thread as one that others wait for: it must not ask for workers."""
    before = getattr(_here, "inside", False)
    _here.inside = True
    try:
        yield
    finally:
        _here.inside = before


@functools.cache
def pool(threads: int) -> ThreadPoolExecutor:
    """So many threads, which stay: to start one takes as long as thousands of starts."""
    return ThreadPoolExecutor(threads, "dipoletop")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=pool.cache_clear)  # a child has none of these threads


def in_parallel(
    task: Callable[[int, Any], T], jobs: Iterable[int], devices: Sequence[Any]
) -> Iterator[tuple[int, T]]:
    """(job, task(job, device)) as they are done; two jobs wait for each worker: bounded memory."""
    free = list(devices)

    def run(job: int) -> tuple[int, T]:
        device = free.pop()  # list.pop and append are atomic
        try:
            with jax.default_device(device), inside():
                return job, task(job, device)
        finally:
            free.append(device)

    jobs = iter(jobs)
    pending: set[Future[tuple[int, T]]] = set()
    try:
        while True:
            while len(pending) < 2 * len(devices) and (job := next(jobs, None)) is not None:
                pending.add(pool(len(devices)).submit(run, job))
            if not pending:
                return
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        for future in pending:
            future.cancel()
        wait(pending)
