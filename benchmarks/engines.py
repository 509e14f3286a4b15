"""The engines of dipoletop driven directly: all that the benchmarks use of its private modules.

An engine is named "native" (machine code, needs llvmlite) or "jax".
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from dipoletop._base.monitoring import COMPILING as COMPILING
from dipoletop._base.stopping import FINISHED as FINISHED
from dipoletop._engines.interface import EndStates, Engine, Limits, Unsupported
from dipoletop._engines.jax_engine import NARROW, ON_PROCESSOR, JaxEngine
from dipoletop.equations._common import omega_scale_of as omega_scale_of

NAMES = ("native", "jax")


def _engine(name: str, **settings: Any) -> Engine:
    if name == "jax":
        return JaxEngine(**settings)
    # It needs llvmlite, the JAX engine does not.
    from dipoletop._engines.native_engine import NativeEngine

    return NativeEngine(**settings)


def limits(rtol: Any, atol: Any, max_steps: int, t1: Any = None) -> Limits:
    """Tolerances and budget of N runs; `atol` and the last times `t1` have shape (N,)."""
    last = jnp.full(jnp.shape(atol), jnp.inf) if t1 is None else t1
    return Limits(jnp.asarray(rtol), atol, last, jnp.asarray(max_steps))


def integrate(
    name: str, equation: Any, y0: Any, bounds: Limits, *, until: Any, **settings: Any
) -> EndStates:
    """All runs in one queue of the engine; y0 has shape (n, N)."""
    return _engine(name, **settings).end_states(equation, y0, bounds, until=until)


def integrate_by_the_fastest(equation: Any, y0: Any, bounds: Limits, *, until: Any) -> EndStates:
    """By machine code, unless the equation is too long for it."""
    try:
        return integrate("native", equation, y0, bounds, until=until)
    except Unsupported:
        return integrate("jax", equation, y0, bounds, until=until)


def block_steps(ends: EndStates) -> np.ndarray:
    """Steps that the wide and the narrow block made, shape (2,)."""
    return np.asarray(ends.block_steps)


def block_widths(name: str, starts: int) -> list[int]:
    """Lanes of an engine's wide and narrow blocks on processors; 0: there is none."""
    if name == "native":
        from dipoletop._engines.native_queue import WIDTH

        return [WIDTH, 0]
    return [min(ON_PROCESSOR, starts), ON_PROCESSOR // NARROW]
