"""The peer diffrax: Dopri8 with an event, under vmap.

Three ways of driving it. `whole`: one vmap over all starts. `chunked`: starts sorted by |ω|
(slow ones together), one vmap for each chunk, chunks on all cores. `repacked`: rounds of a few
steps, after each of which the finished starts are dropped, so that nobody waits long for the
slowest. A vmap of an adaptive loop is lockstep: a batch costs its slowest lane.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import problem
from jaxtyping import Float


def _solver(as_tuple: bool, max_steps: int) -> Callable:
    """A jitted batch solve: (δ (b,), ω (b, 3), rtol, |ω₀| (b,)) -> ω, label, steps."""

    def field(t: Any, y: Any, delta: Any) -> Any:
        rate = problem.rate(delta, y)
        return rate if as_tuple else jnp.stack(rate)

    def decided(t: Any, y: Any, delta: Any, **unused: Any) -> Any:
        return problem.certificate(delta, y, jnp) != problem.UNDECIDED

    def solve(delta: Any, omega: Any, rtol: Any, amplitude: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            t0=0.0,
            t1=problem.HORIZON,
            dt0=None,
            y0=tuple(omega) if as_tuple else omega,
            args=delta,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * amplitude),
            event=diffrax.Event(decided),
            adjoint=diffrax.ForwardMode(),
            max_steps=max_steps,
            throw=False,
        )
        end = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
        state = jnp.stack(end) if as_tuple else end
        return state, problem.certificate(delta, state, jnp), solution.stats["num_steps"]

    return jax.jit(jax.vmap(solve, in_axes=(0, 0, None, 0)))
