"""diffrax: Dopri8 with an event, under vmap, on all cores.

A vmap of an adaptive loop runs in lockstep: a batch costs as much as its slowest lane. So there are
three ways of using it, each a plan of (width, steps). `whole`: one vmap over all starts. `chunked`:
starts sorted by |ω| (so that slow ones are together), one vmap for each chunk. `repacked`: a few
steps at a time; finished starts are dropped in between, and batches become narrower.
"""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure


def end_state(
    delta: Any, omega: Any, rtol: Any, atol: Any, t1: float, *, as_tuple: bool, **settings: Any
) -> tuple[Any, Any]:
    """Return ω at time t1 or at an event, and the number of steps; `settings` are diffrax's."""

    def field(t: Any, y: Any, delta: Any) -> Any:
        rate = mixed_basin.rate(delta, y)
        return rate if as_tuple else jnp.stack(rate)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        t0=0.0,
        t1=t1,
        dt0=None,
        y0=tuple(omega) if as_tuple else omega,
        args=delta,
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
        adjoint=diffrax.ForwardMode(),
        throw=False,
        **settings,
    )
    end = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
    return jnp.stack(end) if as_tuple else end, solution.stats["num_steps"]


@functools.cache
def _solver(as_tuple: bool, max_steps: int) -> Callable:
    """Return a jitted batch solve: (δ (b,), ω (b, 3), rtol, |ω₀| (b,)) -> ω, label, steps."""

    def decided(t: Any, y: Any, delta: Any, **unused: Any) -> Any:
        return mixed_basin.certificate(delta, y, jnp) != mixed_basin.UNDECIDED

    settings: Any = {"as_tuple": as_tuple, "max_steps": max_steps, "event": diffrax.Event(decided)}

    def solve(delta: Any, omega: Any, rtol: Any, amplitude: Any) -> Any:
        atol, until = rtol * amplitude, mixed_basin.HORIZON
        state, steps = end_state(delta, omega, rtol, atol, until, **settings)
        return state, mixed_basin.certificate(delta, state, jnp), steps

    return jax.jit(jax.vmap(solve, in_axes=(0, 0, None, 0)))


def _plan(way: str, lanes: int, most: int) -> list[tuple[int, int]]:
    """Widths and steps, widest first: a round takes the widest that the running starts fill."""
    repacked = [(512, 16), (128, 64), (32, 256), (8, most)]
    return {"whole": [(lanes, most)], "chunked": [(32, most)], "repacked": repacked}[way]


def _classify(
    deltas: Float[np.ndarray, " n"],
    omegas: Float[np.ndarray, "n 3"],
    rtol: float,
    plan: list[tuple[int, int]],
    solvers: dict[int, Callable],
) -> tuple[Int[np.ndarray, " n"], int]:
    """Return labels, and the number of lane steps (without padding)."""
    labels = mixed_basin.certificate(deltas, omegas.T)
    live = np.flatnonzero(labels == mixed_basin.UNDECIDED)
    amplitude = np.linalg.norm(omegas, axis=1)
    live = live[np.argsort(amplitude[live])]
    states = omegas.copy()
    budget, made = plan[-1][1], 0
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        while live.size and budget > 0:
            width, steps = next((p for p in plan if p[0] <= live.size), plan[-1])
            chunks = -(-live.size // width)
            # The last chunk is filled up with copies of its last lane.
            packed = live[np.minimum(np.arange(chunks * width), live.size - 1)]

            def solve(lanes: Any, advance: Callable = solvers[steps]) -> Any:
                batch = (deltas[lanes], states[lanes], rtol, amplitude[lanes])
                return jax.device_get(advance(*batch))

            rounds = list(threads.map(solve, packed.reshape(chunks, width)))
            ends, decided, count = (
                np.concatenate(part)[: live.size] for part in zip(*rounds, strict=True)
            )
            states[live], labels[live] = ends, decided
            made += int(count.sum())
            budget -= steps
            live = live[decided == mixed_basin.UNDECIDED]
    return labels, made


def run(
    deltas: Float[np.ndarray, " n"],
    omegas: Float[np.ndarray, "n 3"],
    rtol: float,
    *,
    as_tuple: bool = True,
    way: str = "repacked",
    max_steps: int = mixed_basin.MAX_STEPS,
) -> dict[str, Any]:
    """Label all starts by diffrax; the state is a tuple of scalars or a vector (3,)."""
    undecided = mixed_basin.certificate(deltas, omegas.T) == mixed_basin.UNDECIDED
    plan = _plan(way, int(undecided.sum()), max_steps)
    solvers = {steps: _solver(as_tuple, steps) for _, steps in plan}

    def compiled() -> None:
        for width, steps in plan:  # a start that stops at once, so that it only compiles
            start = np.tile([[0.1, 0.0, 0.0]], (width, 1))
            jax.block_until_ready(solvers[steps](np.full(width, 0.1), start, rtol, np.ones(width)))

    _, first = measure.timed(compiled)
    (labels, made), clocks = measure.timed(_classify, deltas, omegas, rtol, plan, solvers)
    return clocks | {"labels": labels, "compile_seconds": first["seconds"], "steps": made}
