"""The JAX engine: blocks of lanes with refilling, on any device.

A block of `width` lanes works off a queue of runs. Each lane has its own step size. A finished lane
waits until a part of the block is finished; then all finished lanes write their end states and
take the next runs from the queue. So no lane waits long for a slower one, and only end states are
stored.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.compiling import LANE_OPTIONS
from .._base.parallel import Device
from .._base.stopping import FINISHED, RUNNING, Until
from .._base.types import Equation
from .interface import EndStates, Finish, Limits, Queue, T, on_device
from .step import LaneState, advance, begin

REFILL = 4  # lanes are refilled when 1/REFILL of them are finished
NARROW = 8  # the last lanes of a wide block end in a block that is narrower by this factor
WIDE = 32  # number of lanes from which a block is wide
ON_PROCESSOR, ON_ACCELERATOR = 128, 65536
"""Lanes of a block: the overhead of an operation equals the work on ten lanes on a processor, and
on some ten thousand on an accelerator (not measured)."""
_Method = tuple[diffrax.AbstractERK, int]
"""The solver and the number of lanes of a block, known when the program is compiled."""


@final
@dataclass(frozen=True)
class JaxEngine:
    """An engine with blocks of lanes and refilling, compiled by XLA.

    Attributes:
        solver: any explicit Runge–Kutta solver of diffrax.
        width: the number of lanes stepped together; None: a number for the device.
    """

    name: ClassVar[str] = "jax"
    has_own_threads: ClassVar[bool] = False
    compiles_for_size: ClassVar[bool] = True
    solver: diffrax.AbstractERK = field(default_factory=diffrax.Dopri8)
    width: int | None = None

    def end_states(
        self, equation: Equation, y0: Float[Array, "n N"], limits: Limits, *, until: Until = "value"
    ) -> EndStates:
        """Integrate from the states `y0`, on their device."""
        platform = next(iter(y0.devices())).platform
        return _INTEGRATE[platform == "cpu"](equation, y0, limits, until, self.method(platform))

    def classify(
        self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1
    ) -> tuple[T, None]:
        """Lift, integrate and finish the runs in one program."""
        jitted, method = _CLASSIFY[device.platform == "cpu"], self.method(device.platform)
        return jitted(finish, on_device(queue, device), method), None

    def method(self, platform: str) -> "_Method":
        """Return the solver, and the number of lanes of a block on a platform."""
        width = ON_PROCESSOR if platform == "cpu" else ON_ACCELERATOR
        return self.solver, self.width or width


def _classify(finish: Finish[T], queue: Queue, method: _Method) -> T:
    equation, starts, limits, until, *_ = queue
    omegas = jnp.asarray(starts)
    ends = _integrate(equation, equation.lift(omegas), limits, until, method)
    return finish(equation, omegas, ends, limits.tolerances)


class _Lanes(eqx.Module):
    """Runs with their places in the queue: running, waiting or finished."""

    slot: Int[Array, "B"]  # index of the run; past the last one when idle
    lanes: LaneState

    @property
    def running(self) -> Bool[Array, "B"]:
        return self.lanes.status == RUNNING

    def at(self, lanes: Int[Array, "K"]) -> "_Lanes":
        """Return some of the runs."""
        return jax.tree.map(lambda x: x.at[..., lanes].get(mode="promise_in_bounds"), self)

    def part(self, first: Any, width: int) -> "_Lanes":
        """Return `width` neighbouring runs."""
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, width, axis=-1), self)


def _integrate(
    equation: Equation, y0: Float[Array, "n N"], limits: Limits, until: Until, method: _Method
) -> EndStates:
    size = y0.shape[1]
    solver, width = method
    width = min(width, size)
    narrow = width // NARROW if width >= WIDE else 0
    begun = begin(equation, y0, limits, int(solver.order(None) or 0), until)
    queue, many = _queue(begun, width)

    def step(carry: Any) -> Any:
        block, count = carry
        lanes = advance(block.lanes, limits.rtol, limits.max_steps, solver, until)
        return _Lanes(block.slot, lanes), count + 1

    def work(carry: Any) -> Any:
        block, taken, written, out, steps = carry
        idle = ~block.running
        rank = jnp.cumsum(idle)
        count = rank[-1]
        out = _write(out, _in_front(block, rank), written)
        fresh = queue.at(taken + rank - 1)
        block = jax.tree.map(lambda new, old: jnp.where(idle, new, old), fresh, block)
        taken = taken + count
        least = jnp.where(taken < many, width - width // REFILL, narrow + 1)
        block, steps = jax.lax.while_loop(_busy(least), step, (block, steps))
        return block, taken, written + count, out, steps

    def unfinished(carry: Any) -> Bool[Array, ""]:
        return (carry[1] < many) | (jnp.sum(carry[0].running) > narrow)

    room = size + 3 * width
    out = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), _result(queue))
    zero = jnp.zeros((), int)
    carry = queue.part(size, width), zero, zero, (jnp.full(room, size), *out[1:]), zero
    block, _, written, out, wide = jax.lax.while_loop(unfinished, work, carry)
    rank = jnp.cumsum(~block.running)
    out, last = _write(out, _in_front(block, rank), written), zero
    if narrow:  # The slowest lanes end in a narrow block, where a step costs less.
        block = _in_front(block, jnp.cumsum(block.running)).part(0, narrow)
        block, last = jax.lax.while_loop(_busy(1), step, (block, zero))
        out = _write(out, block, written + rank[-1])
    slot, *late = out

    place = jnp.full(size, -1).at[slot].set(jnp.arange(room), mode="drop")
    _, *early = _result(_Lanes(slot, begun))
    pairs = zip(late, early, strict=True)
    y, t, steps, status = (jnp.where(place >= 0, x[..., place], at_once) for x, at_once in pairs)
    return EndStates(y, t, steps, status, jnp.stack([wide, last]))


def _busy(least: Any) -> Any:
    """Return a test whether at least so many lanes are running."""
    return lambda carry: jnp.sum(carry[0].running) >= least


def _queue(begun: LaneState, width: int) -> tuple[_Lanes, Array]:
    """Return the runs, first those that need steps, idle lanes last; the number of the first."""
    chosen = begun.status == RUNNING
    size, every, so_far = chosen.size, jnp.arange(chosen.size), jnp.cumsum(chosen)
    count = so_far[-1]
    place = jnp.where(chosen, so_far - 1, count + every - so_far)
    # A scatter: XLA:CPU takes thirty times as long to sort.
    front = jnp.zeros(size, int).at[place].set(every, unique_indices=True)
    padded = jnp.concatenate([front, jnp.zeros(width, int)])
    lanes = jax.tree.map(lambda x: x[..., padded], begun)
    idle = jnp.arange(padded.size) >= size
    lanes = eqx.tree_at(lambda x: x.status, lanes, jnp.where(idle, FINISHED, lanes.status))
    return _Lanes(jnp.where(idle, size, padded), lanes), count


def _in_front(block: _Lanes, rank: Int[Array, "B"]) -> _Lanes:
    """Move the chosen lanes to the front; the others lose their slot.

    `rank` counts the chosen lanes up to each lane. It is inverted by bisection, since XLA:CPU
    scatters one number after another.
    """
    wanted = jnp.arange(1, rank.size + 1)
    if rank.size < WIDE:
        place = jnp.sum(rank[None, :] < wanted[:, None], axis=1)
    else:
        place = jnp.searchsorted(rank, wanted, method="scan_unrolled")
    moved = block.at(jnp.minimum(place, rank.size - 1))
    nowhere = jnp.iinfo(moved.slot.dtype).max
    return _Lanes(jnp.where(wanted <= rank[-1], moved.slot, nowhere), moved.lanes)


def _result(block: _Lanes) -> tuple[Array, ...]:
    """Return the slots and end states of runs."""
    lanes = block.lanes
    return block.slot, lanes.y, lanes.t, lanes.steps, lanes.status


def _write(out: Any, block: _Lanes, written: Array) -> Any:
    """Write the results of a block after the results that are written already."""
    return jax.tree.map(
        lambda into, x: jax.lax.dynamic_update_slice_in_dim(into, x, written, axis=-1),
        out,
        _result(block),
    )


def _jitted(function: Any) -> tuple[Any, Any]:
    """Return a function under `jit`: for accelerators, and with `LANE_OPTIONS` for processors.

    JAX compiles the program of one wrapper once, even if several threads call it at once.
    """
    jit: Any = eqx.filter_jit
    return jit(function), jit(function, compiler_options=LANE_OPTIONS)


_INTEGRATE, _CLASSIFY = _jitted(_integrate), _jitted(_classify)
