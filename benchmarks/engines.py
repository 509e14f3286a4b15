"""The engines of dipoletop driven directly: all that the benchmarks use of its private modules.

An engine is named "native" (machine code, needs llvmlite) or "jax".
"""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple
from unittest.mock import patch

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._base.stopping import FINISHED as FINISHED
from dipoletop._base.stopping import decided, verdict_on
from dipoletop._base.tolerances import Tolerances
from dipoletop._engines.interface import EndStates, Engine, Limits, Unsupported
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._runs import blocks, run_settings
from dipoletop._runs.blocks import LOOSE
from dipoletop.equations._common import omega_scale_of as omega_scale_of

NAMES = ("native", "jax")


def limits(rtol: Any, atol: Any, max_steps: int, t1: Any = None) -> Limits:
    """Tolerances and budget of N runs; `atol` and the last times `t1` have shape (N,)."""
    last = jnp.full(jnp.shape(atol), jnp.inf) if t1 is None else t1
    return Limits(jnp.asarray(rtol), atol, last, jnp.asarray(max_steps))


def integrate(
    name: str, equation: Any, y0: Any, bounds: Limits, *, until: Any, **settings: Any
) -> EndStates:
    """All runs in one queue of the engine; y0 has shape (n, N)."""
    if name == "native":  # it needs llvmlite, the JAX engine does not
        from dipoletop._engines.native_engine import NativeEngine as Chosen
    else:
        Chosen = JaxEngine
    return Chosen(**settings).end_states(equation, y0, bounds, until=until)


def integrate_by_the_fastest(equation: Any, y0: Any, bounds: Limits, *, until: Any) -> EndStates:
    """By machine code, unless the equation is too long for it."""
    try:
        return integrate("native", equation, y0, bounds, until=until)
    except Unsupported:
        return integrate("jax", equation, y0, bounds, until=until)


def evaluations(steps: float, starts: float) -> float:
    """Right-hand sides of so many steps, and two for each start to choose its first step.

    Dopri8 reuses the last stage of a step (FSAL), accepted or not.
    """
    return steps * len(diffrax.Dopri8().tableau.c) + 2 * starts


class Pass(NamedTuple):
    """What one call of an engine did."""

    runs: int
    """How many were integrated."""
    ended: Any
    """What is kept of each, in NumPy: `runs`, a classification, and the `doubt` of its label."""


class _Recorder:
    """An engine that also keeps what its calls gave."""

    def __init__(self, engine: Engine, passes: list[Pass]) -> None:
        self.engine, self.passes = engine, passes

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)

    def classify(self, finish: Any, queue: Any, *place: Any) -> Any:
        ended, paused = self.engine.classify(finish, queue, *place)
        # Copies: the second pass writes its results into those of the first.
        kept = jax.tree.map(np.array, jax.device_get(ended))
        self.passes.append(Pass(int(np.sum(np.asarray(queue.limits.t1) > 0)), kept))
        return ended, paused


@contextlib.contextmanager
def driven(
    *, method: Any = None, once: bool = False, passes: list[Pass] | None = None
) -> Iterator[None]:
    """Within it `classify_many` is driven in another way.

    Args:
        method: the solver of diffrax that its engine uses; None: its own.
        once: outcomes are found in one pass at the tolerance that is asked for.
        passes: to which a `Pass` is added for each call of the engine.
    """
    select = run_settings.select_engines

    def selected(*args: Any, **kwargs: Any) -> Mapping[Any, Any]:
        engines: Any = select(*args, **kwargs)
        if method is not None:
            engines = {device: replace(engine, solver=method) for device, engine in engines.items()}
        if passes is not None:
            engines = {device: _Recorder(engine, passes) for device, engine in engines.items()}
        return engines

    loose = 0.0 if once else LOOSE
    with (
        patch.object(run_settings, "select_engines", selected),
        patch.object(blocks, "LOOSE", loose),
    ):
        yield


def known_end(equation: Any, y: Any, rtol: Any) -> tuple[Any, Any, Any]:
    """Whether outcome and ω∞ are known to the tolerance at states (3, N), and both."""
    tolerances = Tolerances(rtol, jnp.zeros(y.shape[1]))
    verdict = verdict_on(equation, y)
    return decided(equation, y, tolerances, "value"), verdict.outcome, verdict.omega_inf
