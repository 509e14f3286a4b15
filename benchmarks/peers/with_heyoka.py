"""heyoka in batch mode, in the fastest way that we found.

All starts advance by rounds of a few steps, `propagate_for(..., max_steps=k)` on batches of the
SIMD width; after each round one vectorised certificate tests every start, and the undecided ones
are packed together. Not faster are `ensemble_propagate_for_batch` (it copies the compiled
integrator for every batch, which takes as long as about a thousand steps), a Python callback or the
certificate after every `step()` (numpy on 8 lanes costs tens of steps), threads (half of the time
is Python's), wider batches, and compact mode.

heyoka's tolerance is absolute below 1, so the variables are y = ω/|ω₀| and s = |ω₀|τ. The tolerance
is then relative to |ω₀|, as for the other integrators.
Coefficients that depend on δ and |ω₀| only are parameters, computed once for each start.
"""

import multiprocessing
import os
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from time import perf_counter, process_time
from typing import Any

import heyoka
import numpy as np
from jaxtyping import Float, Int

from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure

FOREVER = 1e200  # a time s that no run reaches; the number of steps is the limit

_integrator: Any = None  # one for each worker process


def batch_integrator(system: list[tuple[Any, Any]], rtol: float, parameters: int = 0) -> Any:
    """Compile an integrator of batches of the SIMD width."""
    width = heyoka.recommended_simd_size()
    return heyoka.taylor_adaptive_batch(
        system,
        np.zeros((3, width)),
        tol=rtol,
        pars=np.zeros((parameters, width)),
        compact_mode=False,
        fast_math=True,
    )


def in_batches(
    integrator: Any,
    states: Float[np.ndarray, "3 n"],
    parameters: Float[np.ndarray, "p n"],
    advance: Callable[[], Any],
) -> Float[np.ndarray, "3 n"]:
    """Advance every start by a call of the integrator; the last batch is filled up with copies."""
    lanes, width = states.shape[1], integrator.batch_size
    batches = -(-lanes // width)
    padded = np.minimum(np.arange(batches * width), lanes - 1)
    blocks = np.ascontiguousarray(states[:, padded].reshape(3, batches, width).swapaxes(0, 1))
    given = parameters[:, padded].reshape(len(parameters), batches, width).swapaxes(0, 1)
    state, pars = integrator.state, integrator.pars  # views; the time may run on
    for block, parameter in zip(blocks, given, strict=True):
        state[:] = block
        pars[:] = parameter
        advance()
        block[:] = state
    return blocks.swapaxes(0, 1).reshape(3, -1)[:, :lanes]


def rounds(max_steps: int) -> list[int]:
    """Return the steps of each round: a quarter of the steps so far, from 12 up to the budget."""
    made, found = 0, []
    while made < max_steps:
        found.append(min(max(12, made // 4), max_steps - made))
        made += found[-1]
    return found


def _coefficients(
    delta: Float[np.ndarray, " n"], amplitude: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "6 n"]:
    """Return the factors of the monomials of `_system`; the first two are δ and |ω₀|."""
    first = amplitude * (1 + delta + delta**2)
    third = amplitude / (1 - delta)
    return np.stack([delta, amplitude, first, third * (1 + 2 * delta), third * (1 - delta), third])


def _system() -> list[tuple[Any, Any]]:
    """Return (4.2)–(4.4) in y and s, expanded so that parameters need not be combined in a run."""
    y1, y2, y3 = heyoka.make_vars("y1", "y2", "y3")
    delta, amplitude, k23, k31, k32, k33 = (heyoka.par[i] for i in range(6))
    a, b, c = y1 * y1, y2 * y2, y3 * y3
    return [
        (y1, delta * (y2 * y3)),
        (y2, -delta * (y1 * y3) - (amplitude * (a + b) + k23 * c) * y2),
        (y3, -(k31 * a + k32 * b + k33 * c) * y3),
    ]


def _prepare(rtol: float) -> None:
    """Compile this process's integrator."""
    global _integrator
    _integrator = batch_integrator(_system(), rtol, 6)


def _classify(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], int, float]:
    """Return labels, the number of lane steps (without padding), and processor seconds."""
    begin = process_time()
    labels = mixed_basin.certificate(deltas, omegas.T)
    live = np.flatnonzero(labels == mixed_basin.UNDECIDED)
    amplitude = np.linalg.norm(omegas[live], axis=1)
    states = omegas[live].T / amplitude
    coefficients = _coefficients(deltas[live], amplitude)
    made = 0
    for steps in rounds(mixed_basin.MAX_STEPS):
        if live.size == 0:
            break
        advance = partial(_integrator.propagate_for, FOREVER, max_steps=steps)
        states = in_batches(_integrator, states, coefficients, advance)
        made += steps * live.size
        decided = mixed_basin.certificate(coefficients[0], states * coefficients[1])
        labels[live] = decided
        left = decided == mixed_basin.UNDECIDED
        live, states, coefficients = live[left], states[:, left], coefficients[:, left]
    return labels, made, process_time() - begin


def run(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"], rtol: float
) -> dict[str, Any]:
    """Label all starts by heyoka, with one process for each core."""
    cores = os.cpu_count() or 1
    order = np.argsort(np.linalg.norm(omegas, axis=1))  # neighbours need similar numbers of steps
    parts = [order[k::cores] for k in range(cores)]
    begin = perf_counter()
    with ExitStack() as stack:
        # Spawned, because jax may run here too. A pool for each core, so that no worker waits.
        context = multiprocessing.get_context("spawn")
        pools = [stack.enter_context(context.Pool(1, _prepare, (rtol,))) for _ in range(cores)]

        def everywhere() -> list[Any]:
            tasks = [(deltas[part], omegas[part]) for part in parts]
            pending = [p.apply_async(_classify, task) for p, task in zip(pools, tasks, strict=True)]
            return [answer.get() for answer in pending]

        everywhere()  # everybody is measured warm
        compiled = perf_counter() - begin
        answers, clocks = measure.timed(everywhere)
    labels = np.empty(len(deltas), dtype=np.int64)
    for part, (part_labels, *_) in zip(parts, answers, strict=True):
        labels[part] = part_labels
    return clocks | {
        "labels": labels,
        "processor_seconds": sum(spent for *_, spent in answers),
        "compile_seconds": compiled,
        "steps": sum(made for _, made, _ in answers),
    }
