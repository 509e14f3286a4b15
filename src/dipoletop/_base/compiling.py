"""Compilation of programs that the host calls a few times, and which run for milliseconds."""

import functools
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .checks import concrete

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_OPTIONS: dict[str, Any] = {}
"""Options of every program for processors: the older emitters compile in half the time."""
if version("jaxlib").startswith("0.10."):
    CPU_OPTIONS["xla_cpu_use_fusion_emitters"] = False
COMPILED_SOON: dict[str, Any] = CPU_OPTIONS | {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}
"""Options of programs that run for milliseconds and would be compiled for seconds."""


def compiled_soon(function: Function) -> Function:
    """Make `eqx.filter_jit(function)`, compiled with `COMPILED_SOON` where that is allowed.

    A call from the host on processors has these options: it is compiled two to three times sooner,
    and runs as fast within some ten per cent. A call in a trace belongs to a program of the user.
    """
    in_trace, on_host = (
        eqx.filter_jit(function),
        eqx.filter_jit(function, compiler_options=COMPILED_SOON),
    )

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        return (on_host if _is_host_call(args, kwargs) else in_trace)(*args, **kwargs)

    return call  # pyright: ignore[reportReturnType]


def _is_host_call(*arguments: Any) -> bool:
    """Whether no trace is going on, not even one that the arguments do not depend on."""
    if jax.default_backend() != "cpu" or not concrete(arguments):
        return False
    return not isinstance(jax.device_put(np.float32(0)), Tracer)
