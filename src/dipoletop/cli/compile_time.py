"""How long anything was being compiled."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax

from .._base.monitoring import COMPILING


@contextlib.contextmanager
def measure_compile_time() -> Iterator[Callable[[], float]]:
    """A function that returns for how many seconds any thread was tracing or compiling.

    JAX reports the end and the duration of every such event. Threads may compile at the same time,
    so the result is the length of the union of all these intervals.
    """
    intervals: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith(("/jax/core/compile/", COMPILING)):
            now = time.perf_counter()
            intervals.append((now - duration_secs, now))

    def length_of_union() -> float:
        total, covered_until = 0.0, -math.inf
        for begin, end in sorted(intervals):
            total += max(0.0, end - max(begin, covered_until))
            covered_until = max(covered_until, end)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield length_of_union
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
