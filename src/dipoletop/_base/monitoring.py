"""What JAX's monitoring is told of compilations that are not JAX's own."""

import contextlib
import time
from collections.abc import Iterator

import jax

COMPILING = "/dipoletop/compile"


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Report how long something takes to be compiled."""
    began = time.perf_counter()
    yield
    jax.monitoring.record_event_duration_secs(COMPILING, time.perf_counter() - began)
