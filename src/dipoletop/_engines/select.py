"""Which engine works off a queue: machine code where it can, else JAX."""

import functools
import importlib
import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._base.checks import refuse
from .._base.monitoring import compiling
from .._base.stopping import Until
from .._branch import march as manifold
from . import jax_engine as lanes


@functools.cache
def _native() -> tuple[Any, str]:
    """The native engine, or why it cannot be had."""
    try:
        with compiling():
            return importlib.import_module("dipoletop._engines.native_engine"), ""
    except ImportError as error:
        return None, f"numba cannot be imported ({error})"


def engine_for(
    engine: str, equation: Any, device: Any, until: Until, judge: lanes.Judge | None = None
) -> Any:
    """The engine for such runs: a module with `integrate`; see also `judged`.

    Args:
        engine: "jax"; "native"; or "auto", the native one where it can run, with a warning if
            it is there but cannot take this equation, which it compiles.
        equation: with a trailing axis of lanes on its arrays.
        device: which shall run.
        until: when a run is finished.
        judge: what `judged` will be asked for, if anything.

    A full equation has an engine of its own, in JAX: `manifold`.
    """
    if engine not in ("auto", "jax", "native"):
        refuse("engine", "be 'auto', 'jax' or 'native'", f"is {engine!r}")
    if manifold.is_full(equation):  # which no integration forwards can follow
        if engine == "native":
            refuse("engine", "be 'auto' or 'jax' here", "is 'native', but the equation is full")
        return manifold
    if engine == "jax":
        return lanes
    native: Any
    native, reason = _native()
    if not reason:
        if jnp.result_type(float) != jnp.float64:
            reason = "float64 is off"
        elif device.platform != "cpu":
            reason = "it runs on processors only"
    if not reason:
        try:
            native.prepare(equation, until, judge=judge)
            return native
        except native.Unsupported as error:
            reason = f"it cannot take {type(equation).__name__} ({error})"
            if engine == "auto":
                warnings.warn(f"The JAX engine runs, not the native one: {reason}.", stacklevel=2)
    if engine == "native":
        refuse("engine", "be 'auto' or 'jax' here", f"is 'native', but {reason}")
    return lanes


def judged(
    engine: Any,
    judge: lanes.Judge,
    equation: Any,
    omegas: Any,
    limits: lanes.Limits,
    *,
    until: Until,
    device: Any,
    threads: int = 1,
) -> Any:
    """What a judge says of the ends of runs.

    Args:
        engine: from `engine_for`. One that has a function `judged` itself needs no JAX for it.
        judge: a pure function.
        equation: an equation whose array fields carry a trailing axis of N lanes.
        omegas: starts ω₀, shape (3, N).
        limits: tolerances, end times and budget.
        until: when a run is finished.
        device: which shall run; arrays that lie elsewhere, or in NumPy, are moved.
        threads: for an engine that has its own `judged`, how many work off the queue.
    """
    if hasattr(engine, "judged"):
        return engine.judged(judge, equation, omegas, limits, until=until, threads=threads)
    arrays, rest = eqx.partition(
        (equation, omegas, limits), lambda x: eqx.is_array(x) or isinstance(x, np.ndarray)
    )
    equation, omegas, limits = eqx.combine(jax.device_put(arrays, device), rest)
    ends = engine.integrate(equation, lifted(equation, omegas), limits, until=until)
    return _judged(judge, equation, ends, (limits.rtol, limits.atol))


@eqx.filter_jit
def lifted(equation: Any, omegas: Any) -> Any:
    """The states that start at these angular velocities."""
    return equation.lift(omegas)


@eqx.filter_jit
def _judged(judge: lanes.Judge, equation: Any, ends: lanes.Ends, scale: Any) -> Any:
    return judge(equation, (ends.y, ends.t, ends.steps, ends.status), scale)
