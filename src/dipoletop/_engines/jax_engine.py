"""The lane engine: adaptive explicit Runge–Kutta steps on a block of lanes, end states only.

A queue of starts `(n, N)` is worked off by a block of `width` lanes. Each lane has its own
step size; a lane that is finished waits until a part of the block is, then all finished lanes
write their end states and take the next starts from the queue. So no lane pays for a slower
one, and nothing is stored but the ends. The equation is any first-order equation whose
components lie on axis 0; the method is the Butcher tableau of any explicit diffrax solver.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.stopping import Until, decided, sound
from .._base.types import Equation, Real, State
from ..equations._common import error_scale_of
from .step_sizes import error_ratio, first_step, root

NAME = "jax"  # of the engine
Judge = Callable[[Any, tuple[Any, ...], tuple[Any, Any]], Any]
"""From an equation, where runs of it ended (y, t, steps, status) and (rtol, atol) to a tree of
arrays with the lanes behind."""

SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0  # of the step size, as in diffrax
REFILL = 6  # refill when one lane in so many is finished
NARROW = 8  # the last lanes end in a block narrower by this factor
LARGE, WIDE = 500, 10  # operations and numbers of a rate beyond which the stages become a loop
CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}  # pays on CPUs that have such vectors

RUNNING, FINISHED, EXHAUSTED, BROKEN = 2, 1, 0, -1  # states of a lane


class Limits(eqx.Module):
    """Tolerances and budget of a run, all traced: a new value compiles nothing.

    The error of a step is kept below atol + rtol·max(size(y), size(y_new)) in every component, a
    size being that of `error_scale_of`.
    """

    rtol: Float[Array, ""]
    atol: Float[Array, "N"] | Float[np.ndarray, "N"]
    t1: Float[Array, "N"] | Float[np.ndarray, "N"]
    max_steps: Int[Array, ""]


class Ends(eqx.Module):
    """Where the runs ended, one entry for each start."""

    y: Float[Array, "n N"] | Float[np.ndarray, "n N"]
    t: Float[Array, "N"] | Float[np.ndarray, "N"]
    steps: Int[Array, "N"] | Int[np.ndarray, "N"]
    """Steps tried, rejected ones included."""
    status: Int[Array, "N"] | Int[np.ndarray, "N"]
    """FINISHED, EXHAUSTED (no steps left) or BROKEN (not finite, a runaway, a step too small)."""
    sweeps: Int[Array, "2"] | Int[np.ndarray, "2"]
    """Steps of the wide and of the narrow block."""


class Lanes(eqx.Module):
    """The state of runs, lanes on the trailing axis of everything."""

    y: Float[Array, "n B"]
    f: Float[Array, "n B"]
    t: Float[Array, "B"]
    rest: Float[Array, "B"]
    """What t lacks: the rounding errors of its sum (Kahan), so that long runs keep their time."""
    h: Float[Array, "B"]
    steps: Int[Array, "B"]
    status: Int[Array, "B"]
    equation: Any
    atol: Float[Array, "B"]
    t1: Float[Array, "B"]


class _Block(eqx.Module):
    """Runs with their places among the starts: the lanes at work, the queue, or what has ended."""

    slot: Int[Array, "B"]  # which start; past the end when idle
    at: Lanes

    @property
    def running(self) -> Bool[Array, "B"]:
        return self.at.status == RUNNING

    def part(self, first: Any, width: int) -> "_Block":
        """So many neighbours."""
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, width, axis=-1), self)


def _combine(weights: np.ndarray, slopes: list[State]) -> State:
    """Σ wᵢ kᵢ, zero weights left out."""
    terms = [float(w) * k for w, k in zip(weights, slopes, strict=True) if w != 0]
    return functools.reduce(jnp.add, terms)


def _runge_kutta(solver: Any, equation: Equation, at: Lanes, h: Real) -> tuple[State, ...]:
    """One step of the tableau: y_new, its rate, and the error."""
    tableau = solver.tableau
    if len(at.y) > WIDE or _operations(equation, at.y) > LARGE:
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
    h = first_step(equation, error_scale_of(equation), y0, f, scale, order)
    able = sound(0 * h, y0, f) & jnp.isfinite(h)
    done = decided(equation, y0, scale, until) | (limits.t1 <= 0)
    status = jnp.where(limits.max_steps > 0, RUNNING, EXHAUSTED)
    status = jnp.where(able, jnp.where(done, FINISHED, status), BROKEN).astype("int32")
    zero = jnp.zeros_like(h)
    none = zero.astype("int32")
    atol, t1 = jnp.asarray(limits.atol), jnp.asarray(limits.t1)
    return Lanes(y0, f, zero, zero, h, none, status, equation, atol, t1)


def advance(at: Lanes, rtol: Real, max_steps: Array, solver: Any, until: Until) -> Lanes:
    """Try one step in every lane that is running."""
    scale = (rtol, at.atol)
    running = at.status == RUNNING
    left = at.t1 - at.t - at.rest
    last = at.h >= left
    h = jnp.where(last, left, at.h)
    new, slope, error = _runge_kutta(solver, at.equation, at, h)
    ratio = error_ratio(error_scale_of(at.equation), error, (at.y, new), scale)
    factor = SAFETY / root(jnp.maximum(ratio, 1e-30), solver.order(None))
    regular = jnp.isfinite(ratio)  # an overflowing stage says: a smaller step
    accept = running & regular & (ratio <= 1)
    factor = jnp.where(regular, jnp.clip(factor, SHRINK, jnp.where(accept, GROW, 1.0)), SHRINK)

    y = jnp.where(accept[None], new, at.y)
    f = jnp.where(accept[None], slope, at.f)
    steps = at.steps + running.astype(at.steps.dtype)
    # A rejected step that moves no number by more than its rounding is the end of the line.
    rounding = 4 * jnp.finfo(h.dtype).eps * jnp.abs(at.y)
    stuck = jnp.all(jnp.abs(h[None] * at.f) <= rounding, axis=0)
    gain = h + at.rest
    later = jnp.where(last, at.t1, at.t + gain)
    t = jnp.where(accept, later, at.t)
    rest = jnp.where(accept, gain - (later - at.t), at.rest)
    # Of the new state, whether it is accepted or not: so machine code need not wait for that.
    broken = jnp.where(accept, ~sound(later, new, slope), stuck)
    done = accept & (last | decided(at.equation, new, scale, until))
    status = jnp.where(steps < max_steps.astype(steps.dtype), RUNNING, EXHAUSTED)
    status = jnp.where(broken, BROKEN, jnp.where(done, FINISHED, status))
    status = jnp.where(running, status, at.status).astype(at.status.dtype)
    h = jnp.where(running, h * factor, at.h)
    return Lanes(y, f, t, rest, h, steps, status, at.equation, at.atol, at.t1)


def _in_front(chosen: Bool[Array, "B"]) -> tuple[Int[Array, "B"], Array]:
    """The order in which the chosen come first, as it was otherwise; and how many they are."""
    every, so_far = jnp.arange(chosen.size), jnp.cumsum(chosen)
    count = so_far[-1]
    place = jnp.where(chosen, so_far - 1, count + every - so_far)
    # A scatter: XLA:CPU takes thirty times as long to sort.
    order = jnp.zeros(chosen.size, int).at[place].set(every, unique_indices=True)
    return order, count


def _still_first(block: _Block) -> tuple[_Block, Array]:
    """The lanes that stand still moved to the front, and how many they are."""
    order, count = _in_front(~block.running)
    return jax.tree.map(lambda x: x[..., order], block), count


def _result(block: _Block) -> tuple[Array, ...]:
    """What is kept of runs that have ended, and which they were."""
    at = block.at
    return block.slot, at.y, at.t, at.steps, at.status


def _queue(begun: Lanes, width: int) -> tuple[_Block, Array]:
    """The runs, those that need a step in front, and how many these are; idle lanes behind."""
    front, count = _in_front(begun.status == RUNNING)
    size = front.size
    padded = jnp.concatenate([front, jnp.zeros(width, int)])
    at = jax.tree.map(lambda x: x[..., padded], begun)
    idle = jnp.arange(padded.size) >= size
    at = eqx.tree_at(lambda at: at.status, at, jnp.where(idle, FINISHED, at.status))
    return _Block(jnp.where(idle, size, padded), at), count


def _stepped(
    block: _Block, least: Any, limits: Limits, solver: Any, until: Until
) -> tuple[_Block, Array]:
    """Step while at least so many lanes are running; how many steps."""

    def step(carry: Any) -> Any:
        block, count = carry
        at = advance(block.at, limits.rtol, limits.max_steps, solver, until)
        return _Block(block.slot, at), count + 1

    def busy(carry: Any) -> Bool[Array, ""]:
        return jnp.sum(carry[0].running) >= least

    return jax.lax.while_loop(busy, step, (block, jnp.zeros((), int)))


def _put(out: Any, block: _Block, written: Array) -> Any:
    """Results of a block behind those that are written."""
    return jax.tree.map(
        lambda into, x: jax.lax.dynamic_update_slice_in_dim(into, x, written, axis=-1),
        out,
        _result(block),
    )


def _integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: Limits,
    solver: diffrax.AbstractERK,
    until: Until,
    width: int,
) -> Ends:
    size = y0.shape[1]
    narrow = max(width // NARROW, 1)
    begun = begin(equation, y0, limits, int(solver.order(None) or 0), until)
    queue, many = _queue(begun, width)

    def work(carry: Any) -> Any:
        block, taken, written, out, sweeps = carry
        block, count = _still_first(block)
        out = _put(out, block, written)  # what runs stands behind: the next results cover it
        fresh, here = queue.part(taken, width), jnp.arange(width) < count
        block = jax.tree.map(lambda new, old: jnp.where(here, new, old), fresh, block)
        taken = taken + count
        least = jnp.where(taken < many, width - width // REFILL, narrow + 1)
        block, more = _stepped(block, least, limits, solver, until)
        return block, taken, written + count, out, sweeps + more

    def unfinished(carry: Any) -> Bool[Array, ""]:
        return (carry[1] < many) | (jnp.sum(carry[0].running) > narrow)

    room = size + 4 * width  # idle lanes are written too, at both ends
    out = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), _result(queue))
    zero = jnp.zeros((), int)
    carry = queue.part(size, width), zero, zero, (jnp.full(room, size), *out[1:]), zero
    block, _, written, out, wide = jax.lax.while_loop(unfinished, work, carry)

    # The slowest lanes end in a narrow block, where a step costs less.
    block, count = _still_first(block)
    out = _put(out, block, written)
    block = block.part(width - narrow, narrow)
    block = eqx.tree_at(lambda b: b.slot, block, jnp.where(block.running, block.slot, size))
    block, last = _stepped(block, 1, limits, solver, until)
    slot, *late = _put(out, block, written + count)

    found = jnp.full(size, -1).at[slot].set(jnp.arange(room), mode="drop")
    _, *early = _result(_Block(slot, begun))
    pairs = zip(late, early, strict=True)
    y, t, steps, status = (jnp.where(found >= 0, x[..., found], at_once) for x, at_once in pairs)
    return Ends(y, t, steps, status, jnp.stack([wide, last]))


_seen: set[Any] = set()
_first_call = threading.Lock()


@functools.cache
def _compiled(platform: str) -> Any:
    jit: Any = eqx.filter_jit
    return jit(_integrate, compiler_options=CPU_OPTIONS) if platform == "cpu" else jit(_integrate)


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
