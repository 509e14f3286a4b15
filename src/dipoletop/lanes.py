"""The lane engine: adaptive explicit Runge–Kutta steps on a block of lanes, end states only.

A queue of starts `(n, N)` is worked off by a block of `width` lanes. Each lane has its own
step size; a lane that is finished waits until a tenth of the block is, then all finished lanes
write their end states and take the next starts from the queue. So no lane pays for a slower
one, and nothing is stored but the ends. The equation is any first-order equation whose
components lie on axis 0; the method is the Butcher tableau of any explicit diffrax solver.
"""

import functools
from typing import Any, Literal

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._types import Equation, Outcome, Real, State, Verdict

Until = Literal["outcome", "value", "time"]
"""When a lane is finished: its outcome is certain; also ω∞ to the tolerance; or at time t1."""

SAFETY, SHRINK, GROW = 0.9, 0.2, 8.0
NARROW = 8  # the last lanes end in a block narrower by this factor
REFILL = 10  # refill when one lane in so many is finished
VALUE_MARGIN = 0.1  # ω∞ is settled when its estimated error is this part of rtol


class Limits(eqx.Module):
    """Tolerances and budget of a run, all traced: a new value compiles nothing.

    The error of a step is kept below atol + rtol·max(|y|, |y_new|) in every component.
    """

    rtol: Float[Array, ""]
    atol: Float[Array, "N"]
    t1: Float[Array, "N"]
    max_steps: Int[Array, ""]


class Ends(eqx.Module):
    """Where the runs ended, one entry for each start."""

    y: Float[Array, "n N"]
    t: Float[Array, "N"]
    steps: Int[Array, "N"]
    """Steps tried, rejected ones included."""
    status: Int[Array, "N"]
    """1 finished, 0 out of budget, −1 failed (not finite, or the step size underflowed)."""
    sweeps: Int[Array, ""]
    """Block steps made; Σ steps / (sweeps · width) is the lane efficiency."""


class _Block(eqx.Module):
    """The lanes at work and the queue behind them."""

    slot: Int[Array, "B"]  # which start a lane works on; N when idle
    running: Bool[Array, "B"]
    y: Float[Array, "n B"]
    f: Float[Array, "n B"]
    t: Float[Array, "B"]
    h: Float[Array, "B"]
    steps: Int[Array, "B"]
    status: Int[Array, "B"]
    equation: Any  # parameters of these lanes
    atol: Float[Array, "B"]
    t1: Float[Array, "B"]
    taken: Int[Array, ""]  # how much of the queue has been handed out
    sweeps: Int[Array, ""]


def decided(verdict: Verdict, rtol: Real, atol: Real, until: Until) -> Bool[Array, "*lanes"]:
    """Whether a verdict ends a run; ω∞ need not be better than the integration is."""
    certain = verdict.outcome != Outcome.UNDECIDED
    if until == "outcome":
        return certain
    size = jnp.abs(verdict.omega_inf)
    settled = verdict.error * size <= VALUE_MARGIN * (rtol * size + atol)
    return certain & (settled | (verdict.outcome != Outcome.RESIDUAL))


def sound(y: State, rate: State) -> Bool[Array, "*lanes"]:
    """Whether a state can be integrated further: no runaway, and a finite rate."""
    limit = float(jnp.finfo(y.dtype).max) ** 0.1  # leaves room for the powers in the rates
    return (jnp.max(jnp.abs(y), 0) < limit) & jnp.all(jnp.isfinite(rate), 0)


def _finished(equation: Any, y: State, limits: Any, until: Until) -> Bool[Array, "*lanes"]:
    if until == "time":
        return jnp.zeros(y.shape[1:], bool)
    rtol, atol = limits
    return decided(Verdict(*equation.verdict(y)), rtol, atol, until)


def _error_ratio(error: State, y0: State, y1: State, scale: Any) -> Float[Array, "*lanes"]:
    """Largest component of the error over what is allowed."""
    atol, rtol = scale
    return jnp.max(jnp.abs(error) / (atol[None] + rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))), 0)


def first_step(equation: Equation, y: State, f: State, scale: Any, order: int) -> Array:
    """Step size to begin with (Hairer, Nørsett & Wanner I, section II.4)."""
    zero = jnp.zeros_like(y)
    d0, d1 = _error_ratio(y, y, zero, scale), _error_ratio(f, y, zero, scale)
    safe = jnp.where((d0 > 0) & (d1 > 0), d1, 1.0)
    h0 = jnp.where((d0 > 0) & (d1 > 0), 0.01 * d0 / safe, 1e-6)
    f1 = equation(jnp.zeros_like(h0), y + h0[None] * f, None)
    d2 = _error_ratio(f1 - f, y, zero, scale) / h0
    slope = jnp.maximum(jnp.maximum(d1, d2), jnp.finfo(h0.dtype).tiny)
    return jnp.minimum(100 * h0, jnp.exp(jnp.log(0.01 / slope) / order))


def _combine(weights: np.ndarray, slopes: list[State]) -> State:
    """Σ wᵢ kᵢ, zero weights left out."""
    terms = [float(w) * k for w, k in zip(weights, slopes, strict=True) if w != 0]
    return functools.reduce(jnp.add, terms)


def _runge_kutta(solver: diffrax.AbstractERK, equation: Equation, y: State, f: State, h: Array):
    """One step of the tableau from (y, f = equation(y)); returns y_new, f_new and the error."""
    tableau = solver.tableau
    slopes, stage = [f], y
    for row in tableau.a_lower:
        stage = y + h[None] * _combine(row, slopes)
        slopes.append(equation(h, stage, None))
    error = h[None] * _combine(tableau.b_error, slopes)
    if tableau.fsal:
        return stage, slopes[-1], error
    new = y + h[None] * _combine(tableau.b_sol, slopes)
    return new, equation(h, new, None), error


def _step(block: _Block, limits: Limits, solver: diffrax.AbstractERK, until: Until) -> _Block:
    """Try one step in every lane that is running."""
    eps = jnp.finfo(block.h.dtype).eps
    left = block.t1 - block.t
    last = block.h >= left
    h = jnp.where(last, left, block.h)
    new, slope, error = _runge_kutta(solver, block.equation, block.y, block.f, h)
    ratio = _error_ratio(error, block.y, new, (block.atol, limits.rtol))
    order = solver.order(None)  # pyright: ignore[reportArgumentType]
    factor = SAFETY * jnp.exp(-jnp.log(jnp.maximum(ratio, 1e-30)) / order)
    regular = jnp.isfinite(ratio)  # an overflowing stage says: a smaller step
    accept = block.running & regular & (ratio <= 1)
    factor = jnp.where(regular, jnp.clip(factor, SHRINK, jnp.where(accept, GROW, 1.0)), SHRINK)

    y = jnp.where(accept[None], new, block.y)
    f = jnp.where(accept[None], slope, block.f)
    steps = block.steps + block.running.astype(int)
    # A rejected step that would not have moved the state is the end of the line.
    stuck = jnp.max(jnp.abs(h[None] * block.f), 0) < 1e-3 * eps * jnp.max(jnp.abs(block.y), 0)
    broken = block.running & (~sound(y, f) | (stuck & ~accept))
    done = accept & (last | _finished(block.equation, y, (limits.rtol, block.atol), until))
    status = jnp.where(broken, -1, jnp.where(done, 1, block.status))
    return eqx.tree_at(
        lambda b: (b.y, b.f, b.t, b.h, b.steps, b.status, b.running, b.sweeps),
        block,
        (
            y,
            f,
            jnp.where(accept, block.t + h, block.t),
            jnp.where(block.running, h * factor, block.h),
            steps,
            status,
            block.running & ~broken & ~done & (steps < limits.max_steps),
            block.sweeps + 1,
        ),
    )


def _write(ends: Ends, block: _Block) -> Ends:
    """End states of the lanes that stand still; idle lanes write outside and are dropped."""
    slot = jnp.where(block.running, ends.t.shape[0], block.slot)

    def put(into, values):
        return into.at[..., slot].set(values, mode="drop")

    return Ends(
        put(ends.y, block.y),
        put(ends.t, block.t),
        put(ends.steps, block.steps),
        put(ends.status, block.status),
        block.sweeps,
    )


def _refill(block: _Block, queue: _Block) -> _Block:
    """Give the lanes that stand still the next starts of the queue."""
    size = queue.running.shape[0]
    free = ~block.running
    place = block.taken + jnp.cumsum(free) - 1
    take = free & (place < size)
    source = jnp.where(take, place, 0)

    def mix(old, new):
        return jnp.where(take, new[..., source], old)

    slot = jnp.where(take, queue.slot[source], jnp.where(free, size, block.slot))
    lanes = jax.tree.map(mix, _lanes(block), _lanes(queue))
    running = block.running | (take & queue.running[source])
    return _Block(slot, running, *lanes, block.taken + jnp.sum(take), block.sweeps)


def _lanes(b: _Block):
    return b.y, b.f, b.t, b.h, b.steps, b.status, b.equation, b.atol, b.t1


def _prepare(equation: Equation, y0: State, limits: Limits, order: int, until: Until) -> _Block:
    """The queue: first slopes and step sizes; what is decided at once stands at its far end."""
    f = equation(jnp.zeros_like(limits.t1), y0, None)
    h = first_step(equation, y0, f, (limits.atol, limits.rtol), order)
    able = sound(y0, f) & jnp.isfinite(h)
    done = _finished(equation, y0, (limits.rtol, limits.atol), until) | (limits.t1 <= 0)
    status = jnp.where(able, jnp.where(done, 1, 0), -1)
    running = able & ~done & (limits.max_steps > 0)
    first = jnp.argsort(~running, stable=True)
    zero = jnp.zeros_like(status)
    whole = (y0, f, jnp.zeros_like(h), h, zero, status, equation, limits.atol, limits.t1)
    lanes = jax.tree.map(lambda x: x[..., first], whole)
    return _Block(first, running[first], *lanes, jnp.sum(running), jnp.zeros((), int))


def _integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: Limits,
    solver: diffrax.AbstractERK,
    until: Until,
    width: int,
) -> Ends:
    size = y0.shape[1]
    order = int(solver.order(None))  # pyright: ignore[reportArgumentType]
    queue = _prepare(equation, y0, limits, order, until)
    many = queue.taken  # starts that need work
    ends = Ends(y0, jnp.zeros(size), jnp.zeros(size, int), jnp.zeros(size, int), queue.sweeps)
    ends = _write(ends, eqx.tree_at(lambda q: q.running, queue, jnp.zeros(size, bool)))
    idle = jnp.full(size, size)
    block = _Block(idle, jnp.zeros(size, bool), *_lanes(queue), jnp.zeros((), int), queue.sweeps)
    queue = eqx.tree_at(lambda q: q.slot, queue, jnp.where(queue.running, queue.slot, size))

    # The slowest lanes end in a narrow block, where a step costs less.
    for lanes, keep in ((width, width // NARROW), (max(width // NARROW, 1), 0)):
        block = _narrowed(block, lanes)

        def busy(block: _Block, lanes=lanes, keep=keep):
            wanted = jnp.where(block.taken < many, lanes - lanes // REFILL, keep + 1)
            return jnp.sum(block.running) >= wanted

        def work(carry, busy=busy):
            block, ends = carry
            block = _refill(block, queue)
            block = jax.lax.while_loop(busy, lambda b: _step(b, limits, solver, until), block)
            return block, _write(ends, block)

        def unfinished(carry, keep=keep):
            block, _ = carry
            return (jnp.sum(block.running) > keep) | (block.taken < many)

        block, ends = jax.lax.while_loop(unfinished, work, (block, ends))
    return ends


def _narrowed(block: _Block, width: int) -> _Block:
    """The first `width` lanes after those that run have been moved to the front."""
    front = jnp.argsort(~block.running, stable=True)[:width]
    lanes = jax.tree.map(lambda x: x[..., front], _lanes(block))
    return _Block(block.slot[front], block.running[front], *lanes, block.taken, block.sweeps)


@functools.cache
def _compiled(platform: str):
    # Wide vectors pay on CPUs that have them; the flag is unknown elsewhere.
    options = {"xla_cpu_prefer_vector_width": 512} if platform == "cpu" else None
    return eqx.filter_jit(_integrate, compiler_options=options)


def integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: Limits,
    *,
    solver: diffrax.AbstractERK | None = None,
    until: Until = "value",
    width: int = 128,
) -> Ends:
    """Work off a queue of starts on one device.

    Args:
        equation: a first-order equation whose array fields carry a trailing axis of N lanes.
        y0: starts, shape (n, N).
        limits: tolerances, end times and budget.
        solver: any explicit Runge–Kutta solver of diffrax; `diffrax.Dopri8()` by default.
        until: when a lane is finished, see `Until`.
        width: lanes stepped together.

    Returns:
        The end states, in the order of the starts.
    """
    solver = diffrax.Dopri8() if solver is None else solver
    platform = next(iter(y0.devices())).platform
    return _compiled(platform)(equation, y0, limits, solver, until, min(width, y0.shape[1]))
