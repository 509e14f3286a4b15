"""The engines of dipoletop driven directly: all that the benchmarks use of its private modules.

An engine is named "native" (machine code, needs numba) or "jax".
"""

import inspect
from typing import Any

import jax.numpy as jnp
import numpy as np

from dipoletop._base.monitoring import COMPILING
from dipoletop._engines import jax_engine
from dipoletop._engines.jax_engine import FINISHED, Ends, Limits
from dipoletop._engines.vector_code import Unsupported
from dipoletop.equations._common import scales_of

__all__ = [
    "COMPILING",
    "FINISHED",
    "NAMES",
    "Ends",
    "Limits",
    "block_steps",
    "block_widths",
    "integrate",
    "integrate_by_the_fastest",
    "limits",
    "scales_of",
]

NAMES = ("native", "jax")


def _engine(name: str) -> Any:
    if name == "jax":
        return jax_engine
    from dipoletop._engines import native_engine  # needs numba, the JAX engine does not

    return native_engine


def limits(rtol: Any, atol: Any, max_steps: int, t1: Any = None) -> Limits:
    """Tolerances and budget of N runs; `atol` and the last times `t1` have shape (N,)."""
    last = jnp.full(jnp.shape(atol), jnp.inf) if t1 is None else t1
    return Limits(jnp.asarray(rtol), atol, last, jnp.asarray(max_steps))


def integrate(
    name: str, equation: Any, y0: Any, bounds: Limits, *, until: Any, **settings: Any
) -> Ends:
    """All runs in one queue of the engine; y0 has shape (n, N)."""
    return _engine(name).integrate(equation, y0, bounds, until=until, **settings)


def integrate_by_the_fastest(equation: Any, y0: Any, bounds: Limits, *, until: Any) -> Ends:
    """By machine code, unless the equation is too long for it."""
    try:
        return integrate("native", equation, y0, bounds, until=until)
    except Unsupported:
        return integrate("jax", equation, y0, bounds, until=until)


def block_steps(ends: Ends) -> np.ndarray:
    """Steps that the wide and the narrow block made, shape (2,)."""
    return np.asarray(ends.sweeps)


def block_widths(name: str, starts: int) -> list[int]:
    """Lanes of an engine's wide and narrow blocks; 0 where there is no narrow one."""
    engine = _engine(name)
    if name == "native":
        return [engine.WIDTH, 0]
    width = inspect.signature(engine.integrate).parameters["width"].default
    return [min(width, starts), max(width // engine.NARROW, 1)]
