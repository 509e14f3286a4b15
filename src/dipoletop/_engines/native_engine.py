"""The native engine: the steps of the JAX engine in machine code, for float64 on processors.

`step.begin` and `step.advance`, traced for one lane, are compiled to vector instructions
(`jaxpr_to_llvm`, `vector_code`); a loop around them refills a lane as soon as it is finished. The
equation's `lift` and the function that finishes the runs are compiled, too, since a call of JAX
costs as much as a thousand runs. It needs numba.
"""

import functools
import threading
from concurrent.futures import wait
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, final, no_type_check

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numba
import numpy as np
from jaxtyping import Array, Float
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .._base.monitoring import report_compile_time
from .._base.parallel import Device, pool
from .._base.stopping import RUNNING, Until
from .._base.tolerances import Tolerances
from . import step
from .interface import EndStates, Finish, Limits, T, Unsupported
from .jaxpr_to_llvm import compiled

WIDTH = 8  # lanes stepped together
SHARE = 256  # starts from which a thread of its own pays
KINDS = {"float64": ir.DoubleType(), "int64": ir.IntType(64), "int32": ir.IntType(32)}
KINDS |= {"bool": ir.IntType(8)}  # numbers in arrays


@final
@dataclass(frozen=True)
class NativeEngine:
    """Lanes of machine code on processors, for float64.

    Attributes:
        solver: any explicit Runge–Kutta solver of diffrax.
    """

    name: ClassVar[str] = "native"
    has_own_threads: ClassVar[bool] = True
    solver: diffrax.AbstractERK = field(default_factory=diffrax.Dopri8)

    def prepare(self, equation: Any, until: Until, finish: Finish[Any] | None = None) -> None:
        """Compile what runs of such equations need.

        Raises:
            Unsupported: the equation, or its verdict, has no straight-line code.
        """
        prepare(equation, until, finish=finish, solver=self.solver)

    def end_states(
        self,
        equation: Any,
        y0: Float[Array, "n N"] | Float[np.ndarray, "n N"],
        limits: Limits,
        *,
        until: Until = "value",
    ) -> EndStates:
        """See `Engine`; in NumPy, on one core, equal to those of `JaxEngine` but for rounding.

        Raises:
            Unsupported: the equation, or its verdict, has no straight-line code.
        """
        program = prepare(equation, until, n=y0.shape[0], solver=self.solver)
        at, size = program.rows.at, y0.shape[1]
        y, t = np.empty(y0.shape), np.empty(size)
        steps, status = np.empty(size, "int32"), np.empty(size, "int32")
        ends = [(at.y, y), (at.t, t), (at.steps, steps), (at.status, status)]
        block_steps = program.run(equation, limits, (at.y, y0), ends, 1)
        return EndStates(y, t, steps, status, np.array([block_steps, 0]))

    def classify(
        self,
        finish: Finish[T],
        equation: Any,
        omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
        limits: Limits,
        *,
        until: Until,
        device: Device | None = None,
        threads: int = 1,
    ) -> T:
        """See `Engine`; in NumPy. The device is any processor."""
        program = prepare(equation, until, finish=finish, solver=self.solver)
        rows, size = program.rows, limits.t1.shape[0]
        found = jax.tree.map(lambda x: np.empty((*x.shape[:-1], size), x.dtype), program.found)
        ends = list(zip(*map(jax.tree.leaves, (rows.found, found)), strict=True))
        program.run(equation, limits, (rows.omegas, omegas), ends, threads)
        return found


def _call(typing: Any, address: Any, first: Any, stride: Any, shared: Any) -> Any:
    """Call the machine code at an address."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double, long = ir.DoubleType().as_pointer(), ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [double, long, double]).as_pointer()
        code, first, stride, shared = args
        start, numbers = (builder.inttoptr(x, double) for x in (first, shared))
        builder.call(builder.inttoptr(code, kind), [start, stride, numbers])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp, types.intp), generate


def _claim(typing: Any, counter: Any, many: Any) -> Any:
    """Raise a counter that threads share: what it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address, many = args
        place = builder.inttoptr(address, ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", place, many, "monotonic")

    return types.intp(types.intp, types.intp), generate


def _load(typing: Any, address: Any) -> Any:
    """The float64 at an address."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(builder.inttoptr(args[0], ir.DoubleType().as_pointer()))

    return types.float64(types.intp), generate


def _store(typing: Any, address: Any, number: Any, kind: Any) -> Any:
    """Put a number at an address, as the type of that kind."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address, number, kind = args
        after = builder.append_basic_block()
        choice = builder.switch(kind, after)
        for i, element in enumerate(KINDS.values()):
            block = builder.append_basic_block()
            choice.add_case(ir.Constant(kind.type, i), block)
            builder.position_at_end(block)
            value = number if element == number.type else builder.fptosi(number, element)
            builder.store(value, builder.inttoptr(address, element.as_pointer()))
            builder.branch(after)
        builder.position_at_end(after)
        return context.get_dummy_value()

    return types.void(types.intp, types.float64, types.intp), generate


_treat: Any = intrinsic(_call)
_take: Any = intrinsic(_claim)
_get: Any = intrinsic(_load)
_put: Any = intrinsic(_store)

_LIST, _ROWS = numba.float64[::1], numba.intp[:, ::1]
_SIZES, _CODES = numba.types.UniTuple(numba.intp, 4), numba.types.UniTuple(numba.intp, 3)


@numba.njit(nogil=True)
@no_type_check  # numba reads the functions themselves, not a checker around them
def _write_out(end, ended, places, count, shared, kept):
    """What is wanted of some ends, to where it belongs."""
    if end != 0:
        _treat(end, ended.ctypes.data, WIDTH, shared.ctypes.data)
    for row, address, stride, kind in kept:
        for lane in range(count):
            _put(address + places[lane] * stride, ended[row, lane], kind)


@numba.njit([numba.intp(_CODES, _SIZES, numba.intp[::1], _ROWS, _ROWS, _LIST)], nogil=True)
@no_type_check
def _work(codes, sizes, queue, given, kept, shared):
    """Work off a queue, which others may do at the same time; how many steps the block made.

    There are three blocks of lanes: the next starts, those at work, and the last ends. Where there
    is no code, 0, nothing is to be done.

    Args:
        codes: of what is to be done to each block.
        sizes: starts, rows, those of them that run, and the row of the status.
        queue: counts the starts that are taken.
        given: what the starts begin with, `_places`.
        kept: where what is kept of the ends goes, likewise.
        shared: the numbers that all lanes share.
    """
    begin, advance, end = codes
    size, rows, alive, status = sizes
    number = shared.ctypes.data
    fresh, block, ended = np.zeros((rows, WIDTH)), np.zeros((alive, WIDTH)), np.zeros((rows, WIDTH))
    slot, places = np.full(WIDTH, -1), np.zeros(WIDTH, np.intp)
    first = at = last = count = sweeps = 0
    while True:
        running = 0
        for lane in range(WIDTH):
            while block[status, lane] != RUNNING:
                if slot[lane] >= 0:
                    for row in range(alive):
                        ended[row, count] = block[row, lane]
                    places[count] = slot[lane]
                    count += 1
                    if count == WIDTH:
                        _write_out(end, ended, places, count, shared, kept)
                        count = 0
                    slot[lane] = -1
                if at == last:
                    if at < size:
                        at = min(_take(queue.ctypes.data, WIDTH), size)
                    first, last = at, min(at + WIDTH, size)
                    if at == last:
                        break
                    for row, address, step, _ in given:
                        for k in range(WIDTH):
                            fresh[row, k] = _get(address + min(at + k, size - 1) * step)
                    _treat(begin, fresh.ctypes.data, WIDTH, number)
                for row in range(alive):
                    block[row, lane] = fresh[row, at - first]
                slot[lane] = at
                at += 1
            running += block[status, lane] == RUNNING
        if running == 0:
            _write_out(end, ended, places, count, shared, kept)
            return sweeps
        _treat(advance, block.ctypes.data, WIDTH, number)
        sweeps += 1


class _Table(NamedTuple):
    """What the rows of a table of lanes hold, each a number of every lane."""

    at: step.LaneState
    omegas: Any
    found: Any
    """What `finish` gives."""


class _Program:
    """Machine code: `step.begin` and `step.advance`; with a `finish` also that and the lift."""

    def __init__(
        self, equation: Any, n: int, solver: Any, until: Until, finish: Finish[Any] | None
    ):
        arrays, static = eqx.partition(equation, _is_array)

        def whole(at: step.LaneState) -> Any:
            return eqx.combine(at.equation, static)

        def begin(table: _Table, shared: Any) -> _Table:
            at, omegas, _ = table
            y = at.y if omegas is None else whole(at).lift(omegas)
            limits = Limits(shared[0], at.atol, at.t1, shared[1])
            begun = step.begin(whole(at), y, limits, int(solver.order(None)), until)
            return table._replace(at=eqx.filter(begun, eqx.is_array))

        def advance(at: step.LaneState, shared: Any) -> Any:
            rtol, max_steps = shared
            complete = eqx.tree_at(lambda at: at.equation, at, whole(at))
            return eqx.filter(step.advance(complete, rtol, max_steps, solver, until), eqx.is_array)

        def found(at: step.LaneState, shared: Any) -> Any:
            ends = EndStates(at.y, at.t, at.steps, at.status)
            return finish and finish(whole(at), ends, Tolerances(shared[0], at.atol))

        def end(table: _Table, shared: Any) -> _Table:
            return table._replace(found=found(table.at, shared))

        def one(leaf: Any) -> Array:
            return jnp.zeros((*leaf.shape[:-1], 1), leaf.dtype)

        y, size, count = jnp.zeros((n, 1)), jnp.zeros(1), jnp.zeros(1, "int32")
        fields = jax.tree.map(one, arrays)
        at = step.LaneState(y, y, size, size, size, count, count, fields, size, size)
        shared = jnp.zeros(()), jnp.zeros((), int)
        self.found = jax.eval_shape(found, at, shared)
        table = _Table(at, finish and jnp.zeros((3, 1)), jax.tree.map(one, self.found))
        parts = (begin, table), (advance, at), *([(end, table)] if finish else [])
        codes = [compiled(function, given, shared, WIDTH) for function, given in parts]
        self._alive = [engine for _, engine in codes]
        self._codes = tuple(address for address, _ in [*codes, (0, None)][:3])
        leaves, structure = jax.tree.flatten(table)
        ends = np.cumsum([0, *(leaf.size for leaf in leaves)]).tolist()
        self.rows = jax.tree.unflatten(structure, map(slice, ends[:-1], ends[1:]))
        self._sizes = ends[-1], self.rows.at.t1.stop, self.rows.at.status.start

    def run(self, equation: Any, limits: Limits, begun: Any, ends: Any, threads: int) -> int:
        """How many steps all lanes together made.

        Args:
            equation: with a trailing axis of N lanes on its arrays.
            limits: tolerances, end times and budget.
            begun: the rows that the lanes begin with, and their values, shape (..., N).
            ends: pairs of rows that are wanted in the end, and contiguous arrays for them.
            threads: how many work off the queue, at most.
        """
        at, size = self.rows.at, limits.t1.shape[0]
        parameters = map(jax.tree.leaves, (at.equation, eqx.filter(equation, _is_array)))
        pairs = begun, (at.atol, limits.atol), (at.t1, limits.t1), *zip(*parameters, strict=True)
        held = [(rows, np.asarray(values, float).reshape(-1, size)) for rows, values in pairs]
        given = np.array([place for pair in held for place in _places(*pair)])
        kept = np.array([p for rows, out in ends for p in _places(rows, out.reshape(-1, size))])
        shared = np.array([limits.rtol, limits.max_steps], float)
        queue = np.zeros(1, np.intp)
        sizes = size, *self._sizes

        def work(*_arrays: Any) -> int:
            return _work(self._codes, sizes, queue, given, kept, shared)

        # Addresses do not keep their arrays: every thread holds them until it ends.
        work = functools.partial(work, held, ends)
        threads = min(threads, -(-size // SHARE))
        return _in_threads(work, threads, queue, size) if threads > 1 else work()


def _in_threads(work: Any, threads: int, queue: np.ndarray, size: int) -> int:
    parts = [pool(threads).submit(work) for _ in range(threads)]
    try:
        return sum(part.result() for part in parts)
    finally:
        queue[0] = size  # after an interruption nobody takes any more
        wait(parts)


def _places(rows: slice, values: np.ndarray) -> list[tuple[int, ...]]:
    """For each of some rows: its number, where it begins, how far its numbers are apart, kind."""
    first, (down, along) = values.ctypes.data, values.strides
    kind = list(KINDS).index(values.dtype.name)
    return [(rows.start + i, first + i * down, along, kind) for i in range(len(values))]


def _is_array(leaf: Any) -> bool:
    """An array of JAX or NumPy, or the shape and type of one."""
    return eqx.is_array(leaf) or isinstance(leaf, np.ndarray | jax.ShapeDtypeStruct)


_programs: dict[Any, _Program | Unsupported] = {}
_compiling = threading.Lock()


def prepare(
    equation: Any,
    until: Until,
    *,
    n: int | None = None,
    finish: Finish[Any] | None = None,
    solver: Any = None,
) -> _Program:
    """The program for all equations of this structure, compiled once.

    Args:
        equation: with a trailing axis of lanes on its arrays.
        until: when a lane is finished.
        n: numbers of a state; None: those that the equation lifts to.
        finish: what will be applied to the end states, if anything.
        solver: `diffrax.Dopri8()` by default.

    Raises:
        Unsupported: the equation, or its verdict, has no straight-line code.
    """
    solver = diffrax.Dopri8() if solver is None else solver
    leaves, structure = jax.tree.flatten((equation, solver))
    kinds = tuple(((x.shape[:-1], x.dtype) if _is_array(x) else x) for x in leaves)
    n = _lifted_size(structure, kinds) if n is None else n
    key = (structure, kinds, n, finish, until)
    with _compiling:
        if key not in _programs:
            try:
                with report_compile_time():
                    _programs[key] = _Program(equation, n, solver, until, finish)
            except Unsupported as reason:
                _programs[key] = reason
    found = _programs[key]
    if isinstance(found, Unsupported):
        raise found
    return found


@functools.cache
def _lifted_size(structure: Any, kinds: tuple[Any, ...]) -> int:
    """How many numbers a state has that an equation lifts to."""
    lane = (jax.ShapeDtypeStruct((*x[0], 1), x[1]) if isinstance(x, tuple) else x for x in kinds)
    equation, _ = jax.tree.unflatten(structure, lane)
    return eqx.filter_eval_shape(lambda e, w: e.lift(w), equation, jnp.zeros((3, 1))).shape[0]
