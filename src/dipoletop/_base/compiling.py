"""Compilation of programs that the host calls a few times, and which run for milliseconds."""

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .checks import concrete
from .digests import digest
from .refusals import refuse

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_OPTIONS: dict[str, Any] = {}
"""Options of every program for CPUs: the older emitters compile in half the time."""
if version("jaxlib").startswith("0.10."):
    CPU_OPTIONS["xla_cpu_use_fusion_emitters"] = False
LANE_OPTIONS = CPU_OPTIONS | {"xla_cpu_prefer_vector_width": 512}  # faster if the CPU has them
"""Options of programs that run for long, on blocks of lanes."""
FOR_MANY = LANE_OPTIONS | {"xla_llvm_disable_expensive_passes": True}
"""Options of programs on blocks of lanes that are as long to compile as to run."""
COMPILED_SOON: dict[str, Any] = CPU_OPTIONS | {
    "xla_backend_optimization_level": 1,
    "xla_llvm_disable_expensive_passes": True,
}
"""Options of programs that run for milliseconds but would take seconds to compile.

Not level 0: XLA's code for a derivative of a verdict was then wrong, 0 (jaxlib 0.10.2, x86).
"""


@contextlib.contextmanager
def special_numbers() -> Iterator[None]:
    """Let NaN and inf be values, of what is not known or has no end, where JAX debugs them."""
    with jax.debug_nans(False), jax.debug_infs(False):
        yield


def compiled_soon(function: Function, options: dict[str, Any] = COMPILED_SOON) -> Function:
    """Return `eqx.filter_jit(function)`, compiled with these options where that is allowed.

    A call from the host on CPUs uses these options: compilation is two to three times faster, and
    the run time is the same within some ten per cent. A call in a trace belongs to a user's
    program, which has options of its own.
    """
    jit: Any = eqx.filter_jit
    in_trace, on_host = jit(function), jit(function, compiler_options=options)

    @functools.wraps(function)
    @special_numbers()
    def call(*args: Any, **kwargs: Any) -> Any:
        if not _is_host_call(args, kwargs):
            return in_trace(*args, **kwargs)
        try:
            return on_host(*args, **kwargs)
        except ValueError as error:  # a function among the arguments holds a traced number
            if "compiler_options" not in str(error):
                raise
            return in_trace(*args, **kwargs)

    return call  # pyright: ignore[reportReturnType]


def _is_host_call(*arguments: Any) -> bool:
    """Return whether no trace is active, even one on which the arguments do not depend."""
    if jax.default_backend() != "cpu" or not concrete(arguments):
        return False
    return not in_a_trace()


def in_a_trace() -> bool:
    """Return whether every computation is traced at present, as in `jax.jit`."""
    return isinstance(jax.device_put(np.float32(0)), Tracer)


@contextlib.contextmanager
def untraced(*values: Any) -> Iterator[None]:
    """Compute what follows at once, even in a trace, if it depends on known values only."""
    # Not where nothing is traced: each constant of a program would be compiled on its own.
    at_once = concrete(values) and in_a_trace()
    with jax.ensure_compile_time_eval() if at_once else contextlib.nullcontext():
        yield


KEPT = 64  # largest number of kept programs of users' functions
_programs: dict[bytes, jax.stages.Compiled] = {}
_lock = threading.Lock()


UNTRACED = "be swept where nothing is traced (`classify` works in jit, grad and vmap)"


class CompiledPrograms:
    """Compiled programs of one function of arrays, for CPUs, by the shapes of its arguments.

    A function is traced again for each instance, since values that it refers to may have changed.
    Equal programs are compiled once in a process, except those with a callback to Python.
    """

    def __init__(self) -> None:
        self._own: dict[Any, jax.stages.Compiled] = {}

    def __call__(self, function: Callable[[Any], list[Any]], arguments: Any) -> list[Any]:
        """Return the function's value at these arguments, a list of arrays."""
        leaves, structure = jax.tree.flatten(arguments)

        def flat(*leaves: Any) -> list[Any]:
            return function(jax.tree.unflatten(structure, leaves))

        key = structure, tuple((x.shape, x.dtype) for x in leaves)
        with _lock:
            if key not in self._own:
                traced = jax.jit(flat).trace(*leaves)
                if len(traced.jaxpr.in_avals) > len(leaves):  # a tracer outside of the function
                    refuse("problem", UNTRACED, "depends on a value that is")
                self._own[key] = _compiled(traced.lower())
        return self._own[key](*leaves)


def _compiled(lowered: jax.stages.Lowered) -> jax.stages.Compiled:
    text = lowered.as_text()
    if "callback" in text:
        return lowered.compile(COMPILED_SOON)
    key = digest(text.encode())
    program = _programs.pop(key, None) or lowered.compile(COMPILED_SOON)
    _programs[key] = program  # at the end: the most recently used
    while len(_programs) > KEPT:
        del _programs[next(iter(_programs))]
    return program
