"""Report compilations that are not JAX's own to `jax.monitoring`."""

import contextlib
import time
from collections.abc import Iterator

import jax

COMPILING = "/dipoletop/compile"


@contextlib.contextmanager
def report_compile_time() -> Iterator[None]:
    """Report the duration of the block as an event `COMPILING`."""
    started = time.perf_counter()
    yield
    jax.monitoring.record_event_duration_secs(COMPILING, time.perf_counter() - started)
