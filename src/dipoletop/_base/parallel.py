"""Worker threads for all cores and devices; each dispatches work to its own device."""

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import jax
import jax.numpy as jnp

from .refusals import refuse

if TYPE_CHECKING:  # for a type checker `jax.Device` is a variable, not a type
    from jaxlib._jax import Device
else:
    Device = jax.Device

T = TypeVar("T")
_thread = threading.local()
_busy: list[Device] = []
stop_requested = threading.Event()
"""Set by a signal handler that raises KeyboardInterrupt, since Python drops an exception raised
during a callback, such as JAX's at garbage collection."""
LOOK = 1.0  # seconds between checks of `stop_requested`


def worker_devices(devices: Sequence[Any] | None = None) -> list[Device]:
    """Return the device of each worker thread.

    An accelerator has one thread. A CPU runs a small program on one core, so the CPU devices
    together have as many threads as the process may use cores.
    """
    if getattr(_thread, "is_worker", False):  # it would wait for itself
        must = "not itself call `sweep` or `classify_many`, whose workers would wait for each other"
        refuse("problem", must, "does (find what it needs beforehand, and let it use the numbers)")
    devices = jax.local_devices() if devices is None else _device_list(devices)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    hosts = [device for device in devices if device.platform == "cpu"]
    others = [device for device in devices if device.platform != "cpu"]
    threads = max(len(hosts), cores or 1) if hosts else 0
    return others + [hosts[i % len(hosts)] for i in range(threads)]


def _device_list(devices: Any) -> list[Device]:
    several = isinstance(devices, Iterable) and not isinstance(devices, str)
    listed = list(devices) if several else []
    if not listed or not all(isinstance(device, Device) for device in listed):
        must = "list at least one of JAX's devices, as `jax.devices('cpu')` does, or be None"
        refuse("devices", must, f"is {devices!r}")
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
    """Return a cached thread pool: making a thread costs as much as thousands of integrations."""
    return ThreadPoolExecutor(threads, "dipoletop")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=pool.cache_clear)  # threads do not survive a fork


def workers_are_busy() -> bool:
    """Return whether a worker is running a job, for which the end of the process would wait."""
    return bool(_busy)


class ParallelJobs(Generic[T]):
    """Jobs on all devices; at most two for each worker are in progress, to bound memory.

    Args:
        task: function of a job and a device.
        jobs: the jobs, which are drawn as workers become free.
        devices: the devices, each repeated once for each of its threads.
    """

    def __init__(
        self, task: Callable[[int, Device], T], jobs: Iterable[int], devices: Sequence[Device]
    ) -> None:
        self._task, self._jobs, self._workers = task, iter(jobs), len(devices)
        # A thread does not inherit the context of the one that begins it.
        self._is_64_bit = jnp.result_type(float) == jnp.float64
        self._idle = list(devices)
        self._pending: set[Future[tuple[int, T]]] = set()

    def results(self) -> Iterator[tuple[int, T]]:
        """Yield (job, result) as the jobs are done."""
        while True:
            self._submit()
            if not self._pending:
                return
            done, _ = wait(self._pending, LOOK, FIRST_COMPLETED)
            for future in done:
                self._pending.discard(future)
                yield future.result()
            if stop_requested.is_set():
                raise KeyboardInterrupt

    def rest(self, seconds: float) -> Iterator[tuple[int, T]]:
        """Yield (job, result) of running jobs that end within `seconds`, without beginning more."""
        self._jobs = iter(())
        self.cancel()
        done, _ = wait(self._pending, timeout=seconds)
        for future in done:
            self._pending.discard(future)
            if not future.cancelled() and future.exception() is None:
                yield future.result()

    def cancel(self) -> None:
        """Drop the jobs that no worker has begun."""
        for future in self._pending:
            future.cancel()

    def _submit(self) -> None:
        while len(self._pending) < 2 * self._workers:
            job = next(self._jobs, None)
            if job is None:
                return
            self._pending.add(pool(self._workers).submit(self._run, job))

    def _run(self, job: int) -> tuple[int, T]:
        device = self._idle.pop()  # `pop` and `append` of a list are atomic
        _busy.append(device)
        try:
            with jax.enable_x64(self._is_64_bit), jax.default_device(device), as_worker():
                return job, self._task(job, device)
        finally:
            _busy.remove(device)
            self._idle.append(device)

    def wait(self) -> None:
        """Wait until no worker is busy with these jobs."""
        self.cancel()
        wait(self._pending)


def in_parallel(
    task: Callable[[int, Device], T], jobs: Iterable[int], devices: Sequence[Device]
) -> Iterator[tuple[int, T]]:
    """Yield (job, task(job, device)) as the jobs are done; see `ParallelJobs`."""
    running = ParallelJobs(task, jobs, devices)
    try:
        yield from running.results()
    finally:
        running.wait()
