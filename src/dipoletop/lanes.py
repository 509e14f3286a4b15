"""The lane engine: adaptive explicit Runge–Kutta steps on a block of lanes, end states only.

A queue of starts `(n, N)` is worked off by a block of `width` lanes. Each lane has its own
step size; a lane that is finished waits until a tenth of the block is, then all finished lanes
write their end states and take the next starts from the queue. So no lane pays for a slower
one, and nothing is stored but the ends. The equation is any first-order equation whose
components lie on axis 0; the method is the Butcher tableau of any explicit diffrax solver.
"""

import functools
import math
import threading
from typing import Any, Literal

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._types import Equation, Outcome, Real, State, Verdict

NAME = "jax"  # of the engine
Until = Literal["outcome", "value", "time"]
"""When a lane is finished: its outcome is certain; also ω∞ to the tolerance; or at time t1."""

SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0  # of the step size, as in diffrax
REFILL = 10  # refill when one lane in so many is finished
NARROW = 8  # the last lanes end in a block narrower by this factor
LARGE = 200  # operations of a right-hand side from which the stages become a loop
VALUE_MARGIN = 0.1  # ω∞ is settled when its estimated error is this part of the tolerance


RUNNING, FINISHED, EXHAUSTED, BROKEN = 2, 1, 0, -1  # states of a lane


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
    """FINISHED, EXHAUSTED (no steps left) or BROKEN (not finite, a runaway, a step too small)."""
    sweeps: Int[Array, "2"]
    """Steps of the wide and of the narrow block."""


class Lanes(eqx.Module):
    """The state of runs, lanes on the trailing axis of everything."""

    y: Float[Array, "n B"]
    f: Float[Array, "n B"]
    t: Float[Array, "B"]
    h: Float[Array, "B"]
    steps: Int[Array, "B"]
    status: Int[Array, "B"]
    equation: Any
    atol: Float[Array, "B"]
    t1: Float[Array, "B"]


class _Block(eqx.Module):
    """Runs with their places among the starts: the lanes at work, or the queue behind them."""

    slot: Int[Array, "B"]  # which start; past the end when idle
    at: Lanes
    taken: Int[Array, ""]  # how much of the queue has been handed out
    sweeps: Int[Array, ""]

    @property
    def running(self) -> Bool[Array, "B"]:
        return self.at.status == RUNNING


def _largest(components: Any) -> Real:
    """The largest component, lane by lane; a chain, since XLA:CPU does not vectorise `max`."""
    return functools.reduce(jnp.maximum, list(components))


def settled(verdict: Verdict, rtol: Real, atol: Real, margin: float) -> Bool[Array, "*lanes"]:
    """Whether the estimated error of ω∞ is within that part of the tolerance."""
    size = jnp.abs(verdict.omega_inf)
    within = verdict.error * size <= margin * (rtol * size + atol)
    return within | (verdict.outcome != Outcome.RESIDUAL)


def decided(verdict: Verdict, rtol: Real, atol: Real, until: Until) -> Bool[Array, "*lanes"]:
    """Whether a verdict ends a run; ω∞ need not be better than the integration is."""
    certain = verdict.outcome != Outcome.UNDECIDED
    if until == "outcome":
        return certain
    return certain & settled(verdict, rtol, atol, VALUE_MARGIN)


def sound(t: Real, y: State, rate: State) -> Bool[Array, "*lanes"]:
    """Whether a state can be integrated further: a finite rate, and no runaway.

    A runaway is too large, or large and so fast that floating-point time does not resolve it.
    """
    size, speed = _largest(jnp.abs(y)), _largest(jnp.abs(rate))
    limit = float(jnp.finfo(y.dtype).max) ** 0.1  # leaves room for the powers in the rates
    blurred = (size > 1) & (100 * jnp.finfo(y.dtype).eps * speed * t > size)
    return (size < limit) & (speed < jnp.inf) & ~blurred


def _finished(equation: Any, y: State, scale: Any, until: Until) -> Bool[Array, "*lanes"]:
    if until == "time":
        return jnp.zeros(y.shape[1:], bool)
    rtol, atol = scale
    return decided(Verdict(*equation.verdict(y)), rtol, atol, until)


def _error_ratio(error: State, y0: State, y1: State, scale: Any) -> Float[Array, "*lanes"]:
    """Largest component of the error over what is allowed."""
    rtol, atol = scale
    allowed = atol[None] + rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))
    return _largest(jnp.abs(error) / jnp.maximum(allowed, jnp.finfo(allowed.dtype).tiny))


def _first_step(equation: Equation, y: State, f: State, scale: Any, order: int) -> Real:
    """Step size to begin with (Hairer, Nørsett & Wanner I, section II.4)."""
    zero = jnp.zeros_like(y)
    d0, d1 = _error_ratio(y, y, zero, scale), _error_ratio(f, y, zero, scale)
    moves = (d0 > 0) & (d1 > 0)
    h0 = jnp.where(moves, 0.01 * d0 / jnp.where(moves, d1, 1.0), 1e-6)
    f1 = equation(h0, y + h0[None] * f, None)
    d2 = _error_ratio(f1 - f, y, zero, scale) / h0
    slope = jnp.maximum(jnp.maximum(d1, d2), jnp.finfo(h0.dtype).tiny)
    return jnp.minimum(100 * h0, jnp.exp(jnp.log(0.01 / slope) / order))


def _combine(weights: np.ndarray, slopes: list[State]) -> State:
    """Σ wᵢ kᵢ, zero weights left out."""
    terms = [float(w) * k for w, k in zip(weights, slopes, strict=True) if w != 0]
    return functools.reduce(jnp.add, terms)


def _runge_kutta(solver: Any, equation: Equation, at: Lanes, h: Real) -> tuple[State, ...]:
    """One step of the tableau: y_new, its rate, and the error."""
    tableau = solver.tableau
    if _operations(equation, at.y) > LARGE:
        slopes = _rolled_stages(tableau, equation, at, h)
    else:
        slopes = [at.f]
        for c, row in zip(tableau.c, tableau.a_lower, strict=True):
            stage = at.y + h[None] * _combine(row, slopes)
            slopes.append(equation(at.t + float(c) * h, stage, None))
    error = h[None] * _combine(tableau.b_error, slopes)
    new = at.y + h[None] * _combine(tableau.b_sol, slopes)
    if tableau.fsal:  # the last stage is the new state
        return new, slopes[-1], error
    return new, equation(at.t + h, new, None), error


def _operations(equation: Equation, y: State) -> int:
    """How long the right-hand side is."""
    like = jax.ShapeDtypeStruct(y.shape, y.dtype), jax.ShapeDtypeStruct(y.shape[1:], y.dtype)
    return len(jax.make_jaxpr(lambda y, t: equation(t, y, None))(*like).eqns)


def _rolled_stages(tableau: Any, equation: Equation, at: Lanes, h: Real) -> list[State]:
    """The slopes by a loop over the stages, which compiles a long right-hand side only once."""
    size = len(tableau.c) + 1
    rows = np.zeros((size, size))
    for i, row in enumerate(tableau.a_lower, 1):
        rows[i, :i] = row
    weights = jnp.asarray(rows, at.y.dtype)
    times = jnp.asarray(np.append(0.0, tableau.c), at.y.dtype)

    def stage(i: Any, slopes: Array) -> Array:
        shift = jnp.einsum("s,snb->nb", weights[i], slopes, precision="highest")
        return slopes.at[i].set(equation(at.t + times[i] * h, at.y + h[None] * shift, None))

    slopes = jnp.zeros((size, *at.y.shape), at.y.dtype).at[0].set(at.f)
    return list(jax.lax.fori_loop(1, size, stage, slopes))


def begin(equation: Equation, y0: State, limits: Limits, order: int, until: Until) -> Lanes:
    """Runs at their start: first slopes and step sizes; some are decided or broken at once."""
    scale = (limits.rtol, limits.atol)
    f = equation(jnp.zeros_like(limits.t1), y0, None)
    h = _first_step(equation, y0, f, scale, order)
    able = sound(0 * h, y0, f) & jnp.isfinite(h)
    done = _finished(equation, y0, scale, until) | (limits.t1 <= 0)
    status = jnp.where(limits.max_steps > 0, RUNNING, EXHAUSTED)
    status = jnp.where(able, jnp.where(done, FINISHED, status), BROKEN).astype("int32")
    zero = jnp.zeros_like(h)
    return Lanes(y0, f, zero, h, zero.astype("int32"), status, equation, limits.atol, limits.t1)


def advance(at: Lanes, rtol: Real, max_steps: Array, solver: Any, until: Until) -> Lanes:
    """Try one step in every lane that is running."""
    scale = (rtol, at.atol)
    running = at.status == RUNNING
    left = at.t1 - at.t
    last = at.h >= left
    h = jnp.where(last, left, at.h)
    new, slope, error = _runge_kutta(solver, at.equation, at, h)
    ratio = _error_ratio(error, at.y, new, scale)
    # ratio^(−1/order), the order rounded to a power of two: roots vectorise, logarithms do not.
    root = jnp.maximum(ratio, 1e-30)
    for _ in range(max(1, round(math.log2(solver.order(None))))):
        root = jnp.sqrt(root)
    factor = SAFETY / root
    regular = jnp.isfinite(ratio)  # an overflowing stage says: a smaller step
    accept = running & regular & (ratio <= 1)
    factor = jnp.where(regular, jnp.clip(factor, SHRINK, jnp.where(accept, GROW, 1.0)), SHRINK)

    y = jnp.where(accept[None], new, at.y)
    f = jnp.where(accept[None], slope, at.f)
    steps = at.steps + running.astype(at.steps.dtype)
    # A rejected step that would hardly have moved the state is the end of the line.
    eps = jnp.finfo(h.dtype).eps
    stuck = _largest(jnp.abs(h[None] * at.f)) < 1e-3 * eps * _largest(jnp.abs(at.y))
    t = jnp.where(accept, at.t + h, at.t)
    broken = ~sound(t, y, f) | (stuck & ~accept)
    done = accept & (last | _finished(at.equation, y, scale, until))
    status = jnp.where(steps < max_steps.astype(steps.dtype), RUNNING, EXHAUSTED)
    status = jnp.where(broken, BROKEN, jnp.where(done, FINISHED, status))
    status = jnp.where(running, status, at.status).astype(at.status.dtype)
    h = jnp.where(running, h * factor, at.h)
    return Lanes(y, f, t, h, steps, status, at.equation, at.atol, at.t1)


def _step(block: _Block, limits: Limits, solver: Any, until: Until) -> _Block:
    at = advance(block.at, limits.rtol, limits.max_steps, solver, until)
    return _Block(block.slot, at, block.taken, block.sweeps + 1)


def _write(ends: Ends, block: _Block) -> Ends:
    """End states of the lanes that stand still; idle lanes write outside and are dropped."""
    slot = jnp.where(block.running, ends.t.shape[0], block.slot)

    def put(into: Array, values: Array) -> Array:
        return into.at[..., slot].set(values, mode="drop")

    at = block.at
    steps, status = put(ends.steps, at.steps), put(ends.status, at.status)
    return Ends(put(ends.y, at.y), put(ends.t, at.t), steps, status, ends.sweeps)


def _refill(block: _Block, queue: _Block) -> _Block:
    """Give the lanes that stand still the next starts of the queue."""
    size = queue.slot.shape[0]
    free = ~block.running
    place = block.taken + jnp.cumsum(free) - 1
    take = free & (place < size)
    source = jnp.where(take, place, 0)
    at = jax.tree.map(lambda old, new: jnp.where(take, new[..., source], old), block.at, queue.at)
    slot = jnp.where(take, queue.slot[source], jnp.where(free, size, block.slot))
    return _Block(slot, at, block.taken + jnp.sum(take), block.sweeps)


def _narrowed(block: _Block, width: int) -> _Block:
    """The first `width` lanes after those that run have been moved to the front."""
    front = jnp.argsort(~block.running, stable=True)[:width]
    at = jax.tree.map(lambda x: x[..., front], block.at)
    return _Block(block.slot[front], at, block.taken, jnp.zeros((), int))


def _prepare(equation: Equation, y0: State, limits: Limits, order: int, until: Until) -> _Block:
    """The queue; what is decided or broken at once stands at its far end."""
    at = begin(equation, y0, limits, order, until)
    size = at.t.shape[0]
    count = jnp.sum(at.status == RUNNING)
    return _narrowed(_Block(jnp.arange(size), at, count, count), size)


def _integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: Limits,
    solver: diffrax.AbstractERK,
    until: Until,
    width: int,
) -> Ends:
    size = y0.shape[1]
    queue = _prepare(equation, y0, limits, int(solver.order(None)), until)  # pyright: ignore
    many = queue.taken  # starts that need a step
    none = jnp.zeros(size, "int32")
    ends = Ends(y0, jnp.zeros_like(limits.t1), none, none, jnp.zeros(2, int))
    ends = _write(ends, queue)
    slot = jnp.where(queue.running, queue.slot, size)
    idle = eqx.tree_at(lambda at: at.status, queue.at, none)
    queue = _Block(slot, queue.at, many, many)
    block = _Block(jnp.full(size, size), idle, jnp.zeros((), int), many)

    # The slowest lanes end in a narrow block, where a step costs less.
    sweeps = []
    narrow = max(width // NARROW, 1)
    for lanes, keep in ((width, width // NARROW), (narrow, 0)):
        block = _narrowed(block, lanes)

        def busy(block: _Block, lanes: int = lanes, keep: int = keep) -> Bool[Array, ""]:
            wanted = jnp.where(block.taken < many, lanes - lanes // REFILL, keep + 1)
            return jnp.sum(block.running) >= wanted

        def work(carry: Any, busy: Any = busy) -> tuple[_Block, Ends]:
            block, ends = carry
            block = _refill(block, queue)
            block = jax.lax.while_loop(busy, lambda b: _step(b, limits, solver, until), block)
            return block, _write(ends, block)

        def unfinished(carry: Any, keep: int = keep) -> Bool[Array, ""]:
            block, _ = carry
            return (jnp.sum(block.running) > keep) | (block.taken < many)

        block, ends = jax.lax.while_loop(unfinished, work, (block, ends))
        sweeps.append(block.sweeps)
    return Ends(ends.y, ends.t, ends.steps, ends.status, jnp.stack(sweeps))


_seen: set[Any] = set()
_first_call = threading.Lock()


@functools.cache
def _compiled(platform: str) -> Any:
    jit: Any = eqx.filter_jit
    # Wide vectors pay on CPUs that have them; the flag is unknown elsewhere.
    if platform == "cpu":
        return jit(_integrate, compiler_options={"xla_cpu_prefer_vector_width": 512})
    return jit(_integrate)


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
    device = next(iter(y0.devices()))
    run = functools.partial(_compiled(device.platform), equation, y0, limits, solver, until)
    size = min(width, y0.shape[1])
    leaves, structure = jax.tree.flatten((equation, y0, limits, solver))
    kinds = tuple((x.shape, x.dtype) for x in leaves if eqx.is_array(x))
    key = (structure, kinds, until, size, device)
    if key in _seen:
        return run(size)
    with _first_call:  # or every thread would compile the same program
        ends = run(size)
        _seen.add(key)
        return ends
