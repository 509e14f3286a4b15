"""The choice of an engine for an equation: machine code where it can run, else JAX."""

import functools
import warnings
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from .._base.monitoring import report_compile_time
from .._base.parallel import Device
from .._base.refusals import refuse
from .._base.stopping import Until
from .._base.types import Equation
from ..equations._common import is_full, physical
from .branch_engine import BranchEngine
from .interface import Engine, Finish, Unsupported
from .jax_engine import JaxEngine


def select_engines(
    name: str, equation: Equation, devices: Sequence[Device], *rule: Any, warn: bool = True
) -> dict[Device, Engine]:
    """Choose the engine of each device for the physical motions of an equation.

    The `rule` is `until`, and perhaps `finish`, of `select_engine`.
    """
    motion = physical(equation)
    return {each: select_engine(name, motion, each, *rule, warn=warn) for each in set(devices)}


def select_engine(
    name: str,
    equation: Equation,
    device: Device,
    until: Until,
    finish: Finish[Any] | None = None,
    *,
    warn: bool = True,
) -> Engine:
    """Choose the engine for runs of an equation on a device.

    Args:
        name: "jax"; "native"; or "auto", the native one where it can run, with a warning if
            llvmlite is installed but this equation cannot be compiled.
        equation: the equation, with a trailing axis of lanes on its arrays.
        device: the device of the runs.
        until: when a run is finished.
        finish: the `finish` of a later call of `Engine.classify`, if any.
        warn: whether to warn where "auto" chooses the slower engine.

    A full equation has an engine of its own, which follows its physical branch.
    """
    if name not in ("auto", "jax", "native"):
        refuse("engine", "be 'auto', 'jax' or 'native'", f"is {name!r}")
    if is_full(equation):  # no integration forwards in time can follow it
        if name == "native":
            refuse("engine", "be 'auto' or 'jax' here", "is 'native', but the equation is full")
        return BranchEngine()
    if name == "jax":
        return JaxEngine()
    native, reason = _native_engine()
    reason = reason or _missing_for_native(device)
    if native is not None and not reason:
        try:
            native.prepare(equation, until, finish)
            return native
        except Unsupported as error:
            reason = f"it cannot take {type(equation).__name__} ({error})"
            if name == "auto" and warn:
                warnings.warn(f"The JAX engine runs, not the native one: {reason}.", stacklevel=2)
    if name == "native":
        refuse("engine", "be 'auto' or 'jax' here", f"is 'native', but {reason}")
    return JaxEngine()


@functools.cache
def _native_engine() -> tuple[Any, str]:
    """Return the native engine, or None and the reason why it cannot be imported."""
    try:
        with report_compile_time():
            from .native_engine import NativeEngine
    except ImportError as error:
        return None, f"llvmlite cannot be imported ({error})"
    return NativeEngine(), ""


def _missing_for_native(device: Device) -> str:
    """Return the reason why the native engine cannot run here, or an empty text."""
    if jnp.result_type(float) != jnp.float64:
        return "float64 is off"
    return "" if device.platform == "cpu" else "it runs on processors only"
