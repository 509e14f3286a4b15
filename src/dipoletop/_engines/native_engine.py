"""The native engine, with the steps of the JAX engine in machine code, for float64 on processors.

`step.begin` and `step.advance`, traced for one lane, are compiled to vector instructions
(`jaxpr_to_llvm`); a loop around them refills a lane as soon as it is idle (`native_queue`). The
equation's `lift` and the function that finishes the runs are compiled, too, since a call of JAX
costs as much as a thousand runs. It needs llvmlite.
"""

import functools
import math
import threading
from concurrent.futures import wait
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.monitoring import report_compile_time
from .._base.parallel import Device, pool
from .._base.stopping import EXHAUSTED, RUNNING, Until, prepared_verdicts
from .._base.tolerances import Tolerances
from .._base.types import Equation
from . import step
from .interface import EndStates, Finish, Limits, Paused, Queue, T, Unsupported
from .jaxpr_to_llvm import compiled
from .machine_code import MachineCode
from .native_queue import KINDS, WIDTH, Job, loop

SHARE = 256  # number of runs from which another thread pays
LINE = 64  # bytes of a line of memory


@final
@dataclass(frozen=True)
class NativeEngine:
    """An engine in machine code on processors, for float64.

    Attributes:
        solver: any explicit Runge–Kutta solver of diffrax.
    """

    name: ClassVar[str] = "native"
    has_own_threads: ClassVar[bool] = True
    compiles_for_size: ClassVar[bool] = False
    solver: diffrax.AbstractERK = field(default_factory=diffrax.Dopri8)

    def prepare(self, equation: Equation, until: Until, finish: Finish[Any] | None = None) -> None:
        """Compile the program for runs of equations of this structure.

        Raises:
            Unsupported: the equation, or its verdict, has no straight-line code.
        """
        _program(equation, until, self.solver, finish)

    def end_states(
        self,
        equation: Equation,
        y0: Float[Array, "n N"] | Float[np.ndarray, "n N"],
        limits: Limits,
        *,
        until: Until = "value",
    ) -> EndStates:
        """Integrate on one core, in NumPy; equal to `JaxEngine` except for rounding.

        Raises:
            Unsupported: the equation, or its verdict, has no straight-line code.
        """
        program = _program(equation, until, self.solver, n=y0.shape[0])
        queue = Queue(equation, y0, limits, until)  # pyright: ignore[reportArgumentType]
        ends, _, block_steps = program.run(queue, threads=1)
        return ends._replace(block_steps=np.array([block_steps, 0]))

    def classify(
        self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1
    ) -> tuple[T, Paused | None]:
        """Lift, integrate and finish the runs, in NumPy; the device is ignored."""
        program = _program(queue.equation, queue.until, self.solver, finish)
        return program.run(queue, threads)[:2]


class _Table(NamedTuple):
    """The contents of a table of lanes; each number is a row, with one entry for each lane."""

    lanes: step.LaneState
    omegas: Any
    """ω₀, unless runs begin with whole states."""
    result: Any
    """The result of `Finish`, or the end states."""


class _Functions(NamedTuple):
    """The functions of a table of lanes that are compiled; `shared` is (rtol, max_steps)."""

    static: Any
    """The equation without its arrays."""
    solver: diffrax.AbstractERK
    until: Until
    apply: Finish[Any] | None

    def equation(self, lanes: step.LaneState) -> Any:
        return eqx.combine(lanes.equation, self.static)

    def begin(self, table: _Table, shared: tuple[Array, Array]) -> _Table:
        lanes, omegas, _ = table
        y = lanes.y
        if omegas is not None:  # a subnormal number counts as NaN, as in the other engines
            lost = (omegas != 0) & (jnp.abs(omegas) < jnp.finfo(omegas.dtype).tiny)
            y = self.equation(lanes).lift(jnp.where(lost, jnp.nan, omegas))
        limits = Limits(shared[0], lanes.atol, lanes.t1, shared[1])
        order = int(self.solver.order(None) or 0)
        begun = step.begin(self.equation(lanes), y, limits, order, self.until)
        return table._replace(lanes=eqx.filter(begun, eqx.is_array))

    def resume(self, table: _Table, shared: tuple[Array, Array]) -> _Table:
        lanes = table.lanes
        goes_on = (lanes.status == EXHAUSTED) | (lanes.steps == 0)
        goes_on &= lanes.steps < shared[1].astype(lanes.steps.dtype)
        status = jnp.where(goes_on, RUNNING, lanes.status).astype(lanes.status.dtype)
        prepared = prepared_verdicts(self.equation(lanes))
        return table._replace(lanes=replace(lanes, status=status, prepared=prepared))

    def advance(self, lanes: step.LaneState, shared: tuple[Array, Array]) -> step.LaneState:
        whole = replace(lanes, equation=self.equation(lanes))
        advanced = step.advance(whole, *shared, self.solver, self.until)
        return eqx.filter(advanced, eqx.is_array)

    def finish(self, table: _Table, shared: tuple[Array, Array]) -> _Table:
        lanes, omegas, _ = table
        result: Any = EndStates(lanes.y, lanes.t, lanes.steps, lanes.status)
        if self.apply is not None:
            tolerances = Tolerances(shared[0], lanes.atol)
            result = self.apply(self.equation(lanes), omegas, result, tolerances)
        return table._replace(result=result)


@dataclass(frozen=True)
class _Program:
    """Machine code for all equations of one structure."""

    kernels: tuple[MachineCode, MachineCode, MachineCode, MachineCode]
    """Machine code that begins, resumes, advances and finishes the runs of a block of lanes."""
    rows: Any
    """A `_Table` in which a slice of rows replaces every array."""
    sizes: tuple[int, int, int]
    """The number of rows, the number of rows of a run at work, and the row of its status."""
    result: Any
    """The shapes and types of the result for one lane."""

    @classmethod
    def compile(
        cls,
        equation: Equation,
        n: int,
        solver: diffrax.AbstractERK,
        until: Until,
        finish: Finish[Any] | None,
    ) -> "_Program":
        arrays, static = eqx.partition(equation, _is_array)
        functions = _Functions(static, solver, until, finish)

        def one_lane(leaf: Any) -> Array:
            return jnp.zeros((*leaf.shape[:-1], 1), leaf.dtype)

        def blank() -> Any:
            y, number, count = jnp.zeros((n, 1)), jnp.zeros(1), jnp.zeros(1, "int32")
            fields = jax.tree.map(one_lane, arrays)
            prepared = prepared_verdicts(eqx.combine(fields, static))
            lanes = step.LaneState(
                y, y, number, number, number, count, count, fields, number, number, prepared
            )
            shared = jnp.zeros(()), jnp.zeros((), int)
            omegas = None if finish is None else jnp.zeros((3, 1))
            table = functions.finish(_Table(lanes, omegas, None), shared)
            result = jax.tree.map(one_lane, table.result)
            return table._replace(result=result), shared, table.result

        loop()  # is compiled here, where no other thread compiles
        # Shapes and types only: JAX would compile programs that make zeros.
        table, shared, result = jax.eval_shape(blank)
        kernels = (
            compiled(functions.begin, table, shared, WIDTH),
            compiled(functions.resume, table, shared, WIDTH),
            compiled(functions.advance, table.lanes, shared, WIDTH),
            compiled(functions.finish, table, shared, WIDTH),
        )
        leaves, structure = jax.tree.flatten(table)
        ends = np.cumsum([0, *(leaf.size for leaf in leaves)]).tolist()
        rows = jax.tree.unflatten(structure, map(slice, ends[:-1], ends[1:]))
        at_work = jax.tree.leaves((rows.lanes, rows.omegas))[-1].stop
        return cls(kernels, rows, (ends[-1], at_work, rows.lanes.status.start), result)

    def run(self, queue: Queue, threads: int) -> tuple[Any, Paused | None, int]:
        """Integrate N runs.

        Args:
            queue: the runs; its starts are whole states or ω₀, depending on the program.
            threads: the largest number of threads that work off the queue.

        Returns:
            The result of `Finish`, where the runs go on, and the number of steps of the blocks of
            lanes.
        """
        equation, starts, limits, _, before, pauses = queue
        lanes, omegas, result = self.rows
        size = limits.t1.shape[0]
        goes_on: Any = Paused(*(getattr(lanes, name) for name in Paused._fields))
        into = lanes.y if omegas is None else omegas, lanes.atol, lanes.t1, lanes.equation
        given = starts, limits.atol, limits.t1, eqx.filter(equation, _is_array)
        if before is not None:
            into, given = (*into, goes_on), (*given, before)
        given = jax.tree.map(lambda x: np.asarray(x, float).reshape(-1, size), given)
        out, paused = _empty(self.result, size), None
        inputs, outputs = _transfers(into, given), _transfers(result, out)
        if pauses:
            shapes: Any = (jax.ShapeDtypeStruct((x.stop - x.start, 1), float) for x in goes_on)
            paused = _empty(Paused(*shapes), size)
            outputs = np.concatenate([outputs, _transfers(goes_on, paused)])
        rows, *places = self.sizes
        shared = np.array([limits.rtol, limits.max_steps], float)
        taken = np.zeros(1, np.int64)
        tables = inputs.ctypes.data, len(inputs), outputs.ctypes.data, len(outputs)
        begin, resume, *others = (kernel.address for kernel in self.kernels)
        kernels = begin if before is None else resume, *others
        known = *kernels, size, *places, taken.ctypes.data, *tables, shared.ctypes.data

        call, _ = loop()

        # An address does not keep its array: every thread holds the arrays until it ends.
        def work(_arrays: Any = (given, out, paused, inputs, outputs)) -> int:
            blocks = np.zeros((3, rows, WIDTH))
            own = (block.ctypes.data for block in blocks)
            job = np.array(Job._make([*known, *own]), np.int64)
            return call(job.ctypes.data)  # without the lock of the interpreter

        threads = min(threads, -(-size // SHARE))
        steps = _in_threads(work, threads, taken, size) if threads > 1 else work()
        return out, paused, steps


def _empty(result: Any, size: int) -> Any:
    """Return arrays for the results of `size` runs, all in one block of memory.

    A large block consists of large pages; the allocation of many small ones takes as long as a
    step.
    """
    leaves, structure = jax.tree.flatten(result)
    lengths = [size * math.prod(leaf.shape[:-1]) * leaf.dtype.itemsize for leaf in leaves]
    places = np.cumsum([0, *(-(-length // LINE) * LINE for length in lengths)])
    block, arrays = np.empty(places[-1], np.uint8), []
    for first, length, leaf in zip(places[:-1], lengths, leaves, strict=True):
        part = block[first : first + length].view(leaf.dtype)
        arrays.append(part.reshape(*leaf.shape[:-1], size))
    return jax.tree.unflatten(structure, arrays)


def _in_threads(work: Any, threads: int, queue: np.ndarray, size: int) -> int:
    """Run `work` in several threads, and return the sum of its results."""
    parts = [pool(threads).submit(work) for _ in range(threads)]
    try:
        return sum(part.result() for part in parts)
    finally:
        queue[0] = size  # after an interruption no thread takes another run
        wait(parts)


_KIND_NUMBERS = {np.dtype(name): number for number, name in enumerate(KINDS)}


def _transfers(rows: Any, arrays: Any) -> np.ndarray:
    """Return the transfers (`native_queue`) between rows and arrays of N lanes, equal pytrees."""
    transfers = []
    for place, values in zip(*map(jax.tree.leaves, (rows, arrays)), strict=True):
        values = values.reshape(-1, values.shape[-1])
        first, (down, along) = values.ctypes.data, values.strides
        kind = _KIND_NUMBERS[values.dtype]
        transfers += [(place.start + i, first + i * down, along, kind) for i in range(len(values))]
    return np.array(transfers, np.int64)


def _is_array(leaf: Any) -> bool:
    """Return whether a leaf is an array of JAX or NumPy, or the shape and type of one."""
    return eqx.is_array(leaf) or isinstance(leaf, np.ndarray | jax.ShapeDtypeStruct)


KEPT = 256  # programs kept; JAX never frees classes of equations, so the number is limited
_programs: dict[Any, _Program | Unsupported] = {}
_compile_lock = threading.Lock()


def _program(
    equation: Equation,
    until: Until,
    solver: diffrax.AbstractERK,
    finish: Finish[Any] | None = None,
    *,
    n: int | None = None,
) -> _Program:
    """Return the program for all equations of this structure, compiled once.

    Args:
        equation: the equation, with a trailing axis of lanes on its arrays.
        until: when a lane is finished.
        solver: the method.
        finish: the function of the end states; None: none, and runs begin with whole states,
            not with ω₀.
        n: the size of a state; None: the size of `equation.lift`.

    Raises:
        Unsupported: the equation, or its verdict, has no straight-line code.
    """
    leaves, structure = jax.tree.flatten((equation, solver))
    kinds = tuple(((x.shape[:-1], x.dtype) if _is_array(x) else x) for x in leaves)
    n = _lifted_size(structure, kinds) if n is None else n
    key = (structure, kinds, n, finish, until)
    with _compile_lock:
        program = _programs.pop(key, None)
        if program is None:
            try:
                with report_compile_time():
                    program = _Program.compile(equation, n, solver, until, finish)
            except Unsupported as reason:
                program = reason
        _programs[key] = program  # last, since it is the most recently used
        while len(_programs) > KEPT:
            del _programs[next(iter(_programs))]
    if isinstance(program, Unsupported):
        raise program
    return program


@functools.lru_cache(maxsize=KEPT)
def _lifted_size(structure: Any, kinds: tuple[Any, ...]) -> int:
    """Return the size of the states of `equation.lift`."""
    lane = (jax.ShapeDtypeStruct((*x[0], 1), x[1]) if isinstance(x, tuple) else x for x in kinds)
    equation, _ = jax.tree.unflatten(structure, lane)
    return eqx.filter_eval_shape(lambda e, w: e.lift(w), equation, jnp.zeros((3, 1))).shape[0]
