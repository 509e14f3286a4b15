"""The JAX engine: blocks of lanes with refilling, on any device.

A queue of runs is worked off by a block of `width` lanes. Each lane has its own step size. A lane
that is finished waits until a part of the block is; then all finished lanes write their end states
and take the next runs from the queue. So no lane pays for a slower one, and nothing is stored but
the end states.
"""

import functools
import threading
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.parallel import Device
from .._base.stopping import FINISHED, RUNNING, Until
from .._base.types import Equation
from .interface import EndStates, Finish, Limits, Queue, T, classify_on_device
from .step import LaneState, advance, begin

REFILL = 6  # refill when one lane in so many is finished
NARROW = 8  # the last lanes end in a block narrower by this factor
CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}  # pays on CPUs that have such vectors


@final
@dataclass(frozen=True)
class JaxEngine:
    """Blocks of lanes with refilling, compiled by XLA.

    Attributes:
        solver: any explicit Runge–Kutta solver of diffrax.
        width: lanes stepped together.
    """

    name: ClassVar[str] = "jax"
    has_own_threads: ClassVar[bool] = False
    compiles_for_size: ClassVar[bool] = True
    solver: diffrax.AbstractERK = field(default_factory=diffrax.Dopri8)
    width: int = 128

    def end_states(
        self, equation: Equation, y0: Float[Array, "n N"], limits: Limits, *, until: Until = "value"
    ) -> EndStates:
        """See `Engine`; the runs are on the device of `y0`."""
        platform = next(iter(y0.devices())).platform
        width = min(self.width, y0.shape[1])
        return _jitted(platform)(equation, y0, limits, self.solver, until, width)

    def classify(self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1) -> T:
        """See `Engine`."""
        return classify_on_device(self, finish, queue, device)


_wrapper_lock = threading.Lock()


def _jitted(platform: str) -> Any:
    """`_integrate` under `jit`, the same wrapper for all threads.

    Of one wrapper JAX compiles a program once, even if several threads call it at once. Without the
    lock `functools.cache` lets two threads make a wrapper each, which compile the program twice.
    """
    with _wrapper_lock:
        return _make_wrapper(platform)


@functools.cache
def _make_wrapper(platform: str) -> Any:
    jit: Any = eqx.filter_jit
    return jit(_integrate, compiler_options=CPU_OPTIONS) if platform == "cpu" else jit(_integrate)


class _Block(eqx.Module):
    """Runs with their places in the queue: those at work, those that wait, or the finished."""

    slot: Int[Array, "B"]  # which run; past the last one when idle
    lanes: LaneState

    @property
    def running(self) -> Bool[Array, "B"]:
        return self.lanes.status == RUNNING

    def part(self, first: Any, width: int) -> "_Block":
        """So many neighbours."""
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, width, axis=-1), self)


def _integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: Limits,
    solver: diffrax.AbstractERK,
    until: Until,
    width: int,
) -> EndStates:
    size = y0.shape[1]
    narrow = max(width // NARROW, 1)
    begun = begin(equation, y0, limits, int(solver.order(None) or 0), until)
    queue, many = _queue(begun, width)

    def work(carry: Any) -> Any:
        block, taken, written, out, steps = carry
        block, count = _idle_first(block)
        out = _write(out, block, written)  # of running lanes, too: the next results cover these
        fresh, here = queue.part(taken, width), jnp.arange(width) < count
        block = jax.tree.map(lambda new, old: jnp.where(here, new, old), fresh, block)
        taken = taken + count
        least = jnp.where(taken < many, width - width // REFILL, narrow + 1)
        block, more = _advance_while(block, least, limits, solver, until)
        return block, taken, written + count, out, steps + more

    def unfinished(carry: Any) -> Bool[Array, ""]:
        return (carry[1] < many) | (jnp.sum(carry[0].running) > narrow)

    room = size + 4 * width  # idle lanes are written too, at both ends
    out = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), _result(queue))
    zero = jnp.zeros((), int)
    carry = queue.part(size, width), zero, zero, (jnp.full(room, size), *out[1:]), zero
    block, _, written, out, wide = jax.lax.while_loop(unfinished, work, carry)

    # The slowest lanes end in a narrow block, where a step costs less.
    block, count = _idle_first(block)
    out = _write(out, block, written)
    block = block.part(width - narrow, narrow)
    block = eqx.tree_at(lambda b: b.slot, block, jnp.where(block.running, block.slot, size))
    block, last = _advance_while(block, 1, limits, solver, until)
    slot, *late = _write(out, block, written + count)

    place = jnp.full(size, -1).at[slot].set(jnp.arange(room), mode="drop")
    _, *early = _result(_Block(slot, begun))
    pairs = zip(late, early, strict=True)
    y, t, steps, status = (jnp.where(place >= 0, x[..., place], at_once) for x, at_once in pairs)
    return EndStates(y, t, steps, status, jnp.stack([wide, last]))


def _queue(begun: LaneState, width: int) -> tuple[_Block, Array]:
    """The runs, those that need a step in front, and how many these are; idle lanes behind."""
    front, count = _partition_order(begun.status == RUNNING)
    size = front.size
    padded = jnp.concatenate([front, jnp.zeros(width, int)])
    lanes = jax.tree.map(lambda x: x[..., padded], begun)
    idle = jnp.arange(padded.size) >= size
    lanes = eqx.tree_at(lambda x: x.status, lanes, jnp.where(idle, FINISHED, lanes.status))
    return _Block(jnp.where(idle, size, padded), lanes), count


def _idle_first(block: _Block) -> tuple[_Block, Array]:
    """The block with its idle lanes in front, and how many they are."""
    order, count = _partition_order(~block.running)
    return jax.tree.map(lambda x: x[..., order], block), count


def _partition_order(chosen: Bool[Array, "B"]) -> tuple[Int[Array, "B"], Array]:
    """The order that puts the chosen in front and keeps all else; and how many they are."""
    every, so_far = jnp.arange(chosen.size), jnp.cumsum(chosen)
    count = so_far[-1]
    place = jnp.where(chosen, so_far - 1, count + every - so_far)
    # A scatter: XLA:CPU takes thirty times as long to sort.
    order = jnp.zeros(chosen.size, int).at[place].set(every, unique_indices=True)
    return order, count


def _advance_while(
    block: _Block, least: Any, limits: Limits, solver: diffrax.AbstractERK, until: Until
) -> tuple[_Block, Array]:
    """Step while at least so many lanes are running; how many steps."""

    def step(carry: Any) -> Any:
        block, count = carry
        lanes = advance(block.lanes, limits.rtol, limits.max_steps, solver, until)
        return _Block(block.slot, lanes), count + 1

    def busy(carry: Any) -> Bool[Array, ""]:
        return jnp.sum(carry[0].running) >= least

    return jax.lax.while_loop(busy, step, (block, jnp.zeros((), int)))


def _result(block: _Block) -> tuple[Array, ...]:
    """What is kept of runs that have ended: their slots and end states."""
    lanes = block.lanes
    return block.slot, lanes.y, lanes.t, lanes.steps, lanes.status


def _write(out: Any, block: _Block, written: Array) -> Any:
    """Write the results of a block behind those that are written already."""
    return jax.tree.map(
        lambda into, x: jax.lax.dynamic_update_slice_in_dim(into, x, written, axis=-1),
        out,
        _result(block),
    )
