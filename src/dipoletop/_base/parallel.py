"""Threads for all cores and all devices, each with its own dispatch."""

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
_thread = threading.local()


def worker_devices(devices: Sequence[Any] | None = None) -> list[Device]:
    """One entry for each worker thread: the device that it feeds.

    An accelerator is fed by one thread. A processor runs a small program on one core, so there are
    as many threads for its devices as the process may use cores.
    """
    if getattr(_thread, "is_worker", False):  # it would wait for itself
        refuse(
            "problem",
            "not itself call `sweep` or `classify_many`, whose workers would wait for each other",
            "does (find what it needs beforehand, and let it use the numbers)",
        )
    devices = jax.devices() if devices is None else _device_list(devices)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    hosts = [device for device in devices if device.platform == "cpu"]
    others = [device for device in devices if device.platform != "cpu"]
    threads = max(len(hosts), cores or 1) if hosts else 0
    return others + [hosts[i % len(hosts)] for i in range(threads)]


def _device_list(devices: Any) -> list[Device]:
    several = isinstance(devices, Iterable) and not isinstance(devices, str)
    listed = list(devices) if several else []
    if not listed or not all(isinstance(device, Device) for device in listed):
        refuse(
            "devices",
            "list at least one of JAX's devices, as `jax.devices('cpu')` does, or be None",
            f"is {devices!r}",
        )
    return listed


@contextlib.contextmanager
def as_worker() -> Iterator[None]:
    """Mark this thread as one that other threads wait for: `worker_devices` then refuses."""
    before = getattr(_thread, "is_worker", False)
    _thread.is_worker = True
    try:
        yield
    finally:
        _thread.is_worker = before


@functools.cache
def pool(threads: int) -> ThreadPoolExecutor:
    """A cached pool: creating a thread costs as much as thousands of integrations."""
    return ThreadPoolExecutor(threads, "dipoletop")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=pool.cache_clear)  # threads do not survive a fork


def in_parallel(
    task: Callable[[int, Device], T], jobs: Iterable[int], devices: Sequence[Device]
) -> Iterator[tuple[int, T]]:
    """Yield (job, task(job, device)) as the jobs are done.

    At most two jobs for each worker are in flight, to bound memory.
    """
    idle = list(devices)

    def run(job: int) -> tuple[int, T]:
        device = idle.pop()  # `pop` and `append` of a list are atomic
        try:
            with jax.default_device(device), as_worker():
                return job, task(job, device)
        finally:
            idle.append(device)

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
