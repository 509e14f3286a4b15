"""The lane engine in machine code: the same steps as `lanes`, for float64 on processors.

`lanes.begin` and `lanes.advance`, traced for one lane, are compiled to vector instructions
(`_llvm`, `_simd`); a loop around them refills a lane as soon as it is finished. It needs numba.
"""

import threading
from typing import Any, no_type_check

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

from . import lanes
from ._llvm import compiled
from ._monitoring import compiling
from ._simd import Unsupported
from ._types import Equation

NAME = "native"  # of the engine
WIDTH = 8  # lanes stepped together

__all__ = ["NAME", "WIDTH", "Unsupported", "integrate", "prepare"]


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


_treat: Any = intrinsic(_call)


_TABLE, _LIST = numba.float64[:, ::1], numba.float64[::1]


@numba.njit([numba.intp(numba.intp, numba.intp, _TABLE, _LIST, _TABLE, numba.intp)], nogil=True)
@no_type_check  # numba reads the function itself, not a checker around it
def _work(begin, advance, queue, shared, block, status):
    """Work off the queue, a column for each start; the end states take the starts' places."""
    rows, size = queue.shape
    width = block.shape[1]
    item = queue.itemsize
    place = shared.ctypes.data
    for first in range(0, size, width):
        _treat(begin, queue.ctypes.data + item * first, size, place)
    slot = np.full(width, -1)
    taken = sweeps = 0
    while True:
        running = 0
        for lane in range(width):
            if block[status, lane] == lanes.RUNNING:
                running += 1
                continue
            if slot[lane] >= 0:
                for row in range(rows):
                    queue[row, slot[lane]] = block[row, lane]
                slot[lane] = -1
            while taken < size and queue[status, taken] != lanes.RUNNING:
                taken += 1
            if taken < size:
                for row in range(rows):
                    block[row, lane] = queue[row, taken]
                slot[lane] = taken
                taken += 1
                running += 1
        if running == 0:
            return sweeps
        _treat(advance, block.ctypes.data, width, place)
        sweeps += 1


class _Program:
    """`lanes.begin` and `lanes.advance` in machine code, and the table they work on.

    A row of the table holds one number of every lane: the leaves of `lanes.Lanes`, in order.
    """

    def __init__(self, equation: Any, n: int, solver: Any, until: lanes.Until):
        arrays, static = eqx.partition(equation, _is_array)

        def begin(at: lanes.Lanes, shared: Any) -> Any:
            limits = lanes.Limits(shared[0], at.atol, at.t1, shared[1])
            whole = eqx.combine(at.equation, static)
            begun = lanes.begin(whole, at.y, limits, int(solver.order(None)), until)
            return eqx.filter(begun, eqx.is_array)

        def advance(at: lanes.Lanes, shared: Any) -> Any:
            whole = eqx.tree_at(lambda at: at.equation, at, eqx.combine(at.equation, static))
            return eqx.filter(
                lanes.advance(whole, shared[0], shared[1], solver, until), eqx.is_array
            )

        def one(leaf: Any) -> Array:
            return jnp.zeros((*leaf.shape[:-1], 1), leaf.dtype)

        y, size, count = jnp.zeros((n, 1)), jnp.zeros(1), jnp.zeros(1, "int32")
        fields = jax.tree.map(one, arrays)
        rows = lanes.Lanes(y, y, size, size, size, count, count, fields, size, size)
        shared = jnp.zeros(()), jnp.zeros((), int)
        self.begin, *alive = compiled(begin, rows, shared, WIDTH)
        self.advance, *more = compiled(advance, rows, shared, WIDTH)
        self._alive = alive + more
        leaves, structure = jax.tree.flatten(rows)
        ends = np.cumsum([0, *(leaf.size for leaf in leaves)]).tolist()
        self.size = ends[-1]
        self.rows = jax.tree.unflatten(structure, map(slice, ends[:-1], ends[1:]))


def _is_array(leaf: Any) -> bool:
    """An array, or the shape and type of one."""
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


_programs: dict[Any, _Program | Unsupported] = {}
_compiling = threading.Lock()


def prepare(equation: Any, n: int, until: lanes.Until, solver: Any = None) -> _Program:
    """The program for all equations of this structure, with states of n numbers; compiled once.

    Raises:
        Unsupported: the equation, or its verdict, has no straight-line code.
    """
    solver = diffrax.Dopri8() if solver is None else solver
    leaves, structure = jax.tree.flatten((equation, solver))
    kinds = (((x.shape[:-1], x.dtype) if _is_array(x) else x) for x in leaves)
    key = (structure, tuple(kinds), n, until)
    with _compiling:
        if key not in _programs:
            try:
                with compiling():
                    _programs[key] = _Program(equation, n, solver, until)
            except Unsupported as reason:
                _programs[key] = reason
    found = _programs[key]
    if isinstance(found, Unsupported):
        raise found
    return found


def integrate(
    equation: Equation,
    y0: Float[Array, "n N"],
    limits: lanes.Limits,
    *,
    solver: diffrax.AbstractERK | None = None,
    until: lanes.Until = "value",
) -> lanes.Ends:
    """Work off a queue of starts on one core: `lanes.integrate` in machine code.

    Args:
        equation: a first-order equation whose array fields carry a trailing axis of N lanes.
        y0: starts, shape (n, N), float64.
        limits: tolerances, end times and budget.
        solver: any explicit Runge–Kutta solver of diffrax; `diffrax.Dopri8()` by default.
        until: when a lane is finished.

    Returns:
        The end states, in the order of the starts. Steps and outcomes are those of
        `lanes.integrate` but for rounding.

    Raises:
        Unsupported: the equation, or its verdict, has no straight-line code.
    """
    program = prepare(equation, y0.shape[0], until, solver)
    at, size = program.rows, y0.shape[1]
    queue = np.zeros((program.size, -(-size // WIDTH) * WIDTH))
    parameters = map(jax.tree.leaves, (at.equation, eqx.filter(equation, eqx.is_array)))
    given = (at.y, y0), (at.atol, limits.atol), (at.t1, limits.t1)
    for rows, values in (*given, *zip(*parameters, strict=True)):
        table = np.asarray(values).reshape(-1, size)
        queue[rows, :size] = table
        queue[rows, size:] = table[:, :1]
    queue[at.t1, size:] = 0.0  # what fills the last block takes no step
    shared = np.array([limits.rtol, limits.max_steps], float)
    block = np.zeros((program.size, WIDTH))
    sweeps = _work(program.begin, program.advance, queue, shared, block, at.status.start)
    y, t, steps, status = (queue[rows, :size] for rows in (at.y, at.t, at.steps, at.status))
    whole = (number[0].astype("int32") for number in (steps, status))
    return lanes.Ends(*jax.device_put((y, t[0], *whole, np.array([sweeps, 0]))))
