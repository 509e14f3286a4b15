"""Reports to `jax.monitoring` of compilations outside JAX."""

import contextlib
import time
from collections.abc import Iterator

import jax

COMPILING = "/dipoletop/compile"
NATIVE_COMPILATION = "/dipoletop/native_compilation"


@contextlib.contextmanager
def report_compile_time() -> Iterator[None]:
    """Report the duration of the block as an event `COMPILING`."""
    started = time.perf_counter()
    yield
    jax.monitoring.record_event_duration_secs(COMPILING, time.perf_counter() - started)


def report_native_compilation() -> None:
    """Report that a function is compiled to machine code, as an event `NATIVE_COMPILATION`."""
    jax.monitoring.record_event(NATIVE_COMPILATION)
