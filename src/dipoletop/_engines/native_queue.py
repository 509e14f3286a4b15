"""The loop of the native engine: threads share one queue, and a lane is refilled when it is idle.

The steps themselves are machine code at addresses, see `jaxpr_to_llvm`. The loop is compiled by
numba, without the lock of the interpreter. Where the numbers of a run lie in memory is told by
transfers, rows of (row of the table, address of its first number, stride in bytes, kind).
"""

from typing import Any, no_type_check

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .._base.stopping import RUNNING

WIDTH = 8  # lanes stepped together
KINDS = {"float64": ir.DoubleType(), "int64": ir.IntType(64), "int32": ir.IntType(32)}
KINDS |= {"bool": ir.IntType(8)}  # types of numbers in arrays; a kind is a position in this list


@intrinsic
def _call_kernel(typing: Any, address: Any, first: Any, stride: Any, shared: Any) -> Any:
    """Call the machine code at an address, see `jaxpr_to_llvm.compiled`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double, long = ir.DoubleType().as_pointer(), ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [double, long, double]).as_pointer()
        code, first, stride, shared = args
        table, numbers = (builder.inttoptr(x, double) for x in (first, shared))
        builder.call(builder.inttoptr(code, kind), [table, stride, numbers])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp, types.intp), generate


@intrinsic
def _claim(typing: Any, counter: Any, many: Any) -> Any:
    """Raise a counter that threads share; returns its old value."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address, many = args
        place = builder.inttoptr(address, ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", place, many, "monotonic")

    return types.intp(types.intp, types.intp), generate


@intrinsic
def _load(typing: Any, address: Any) -> Any:
    """The float64 at an address."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(builder.inttoptr(args[0], ir.DoubleType().as_pointer()))

    return types.float64(types.intp), generate


@intrinsic
def _store(typing: Any, address: Any, number: Any, kind: Any) -> Any:
    """Store a number at an address, converted to a kind."""

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


_LIST, _ROWS = numba.float64[::1], numba.intp[:, ::1]
_SIZES, _ADDRESSES = numba.types.UniTuple(numba.intp, 4), numba.types.UniTuple(numba.intp, 3)


@numba.njit(nogil=True)
@no_type_check  # numba reads the functions themselves, not a checker around them
def _write_results(finish, ended, slots, count, shared, outputs):
    """Finish the runs in a block of ended lanes, and store what is wanted of them."""
    _call_kernel(finish, ended.ctypes.data, WIDTH, shared.ctypes.data)
    for row, address, stride, kind in outputs:
        for lane in range(count):
            _store(address + slots[lane] * stride, ended[row, lane], kind)


@numba.njit([numba.intp(_ADDRESSES, _SIZES, numba.intp[::1], _ROWS, _ROWS, _LIST)], nogil=True)
@no_type_check
def work_off(kernels, sizes, queue, inputs, outputs, shared):
    """Work off a queue of runs, which other threads may do at the same time.

    There are three blocks of lanes: the next runs from the queue, those at work, and the last that
    have ended.

    Args:
        kernels: addresses of the machine code that begins, advances and finishes the runs of a
            block.
        sizes: the number of runs, of rows, of rows of a lane at work, and the row of its status.
        queue: counts the runs that are taken.
        inputs: transfers of what the runs begin with.
        outputs: transfers of what is wanted of the ended runs.
        shared: the numbers that all lanes share.

    Returns:
        How many steps the block of lanes at work made.
    """
    begin, advance, finish = kernels
    size, rows, lane_rows, status = sizes
    numbers = shared.ctypes.data
    fresh, ended = np.zeros((rows, WIDTH)), np.zeros((rows, WIDTH))
    block = np.zeros((lane_rows, WIDTH))
    slot, slots = np.full(WIDTH, -1), np.zeros(WIDTH, np.intp)
    first = following = last = count = steps = 0
    while True:
        running = 0
        for lane in range(WIDTH):
            while block[status, lane] != RUNNING:
                if slot[lane] >= 0:
                    for row in range(lane_rows):
                        ended[row, count] = block[row, lane]
                    slots[count] = slot[lane]
                    count += 1
                    if count == WIDTH:
                        _write_results(finish, ended, slots, count, shared, outputs)
                        count = 0
                    slot[lane] = -1
                if following == last:
                    if following < size:
                        following = min(_claim(queue.ctypes.data, WIDTH), size)
                    first, last = following, min(following + WIDTH, size)
                    if following == last:
                        break
                    for row, address, stride, _ in inputs:
                        for k in range(WIDTH):
                            run = min(following + k, size - 1)
                            fresh[row, k] = _load(address + run * stride)
                    _call_kernel(begin, fresh.ctypes.data, WIDTH, numbers)
                for row in range(lane_rows):
                    block[row, lane] = fresh[row, following - first]
                slot[lane] = following
                following += 1
            running += block[status, lane] == RUNNING
        if running == 0:
            _write_results(finish, ended, slots, count, shared, outputs)
            return steps
        _call_kernel(advance, block.ctypes.data, WIDTH, numbers)
        steps += 1
