"""Which engine works off a queue: machine code where it can, else JAX."""

import functools
import importlib
import warnings
from typing import Any

import jax.numpy as jnp

from . import lanes, manifold
from ._checks import refuse
from ._monitoring import compiling


@functools.cache
def _native() -> tuple[Any, str]:
    """The native engine, or why it cannot be had."""
    try:
        with compiling():
            return importlib.import_module("dipoletop.native"), ""
    except ImportError as error:
        return None, f"numba cannot be imported ({error})"


def engine_for(engine: str, equation: Any, y0: Any, until: lanes.Until) -> Any:
    """The engine for such runs, with the equation compiled: a module with `integrate`.

    Args:
        engine: "jax"; "native"; or "auto", the native one where it can run, with a warning if
            it is there but cannot take this equation.
        equation: with a trailing axis of lanes on its arrays.
        y0: starts, (n, N), on the device that shall run.
        until: when a run is finished.

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
        if y0.dtype != jnp.float64:
            reason = "float64 is off"
        elif any(device.platform != "cpu" for device in y0.devices()):
            reason = "it runs on processors only"
    if not reason:
        try:
            native.prepare(equation, y0.shape[0], until)
            return native
        except native.Unsupported as error:
            reason = f"it cannot take {type(equation).__name__} ({error})"
            if engine == "auto":
                warnings.warn(f"The JAX engine runs, not the native one: {reason}.", stacklevel=2)
    if engine == "native":
        refuse("engine", "be 'auto' or 'jax' here", f"is 'native', but {reason}")
    return lanes
