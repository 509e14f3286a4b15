"""The loop of the native engine, in which threads share one queue and idle lanes are refilled.

The steps themselves are machine code at addresses (`jaxpr_to_llvm`). The loop is also machine code,
written here once for all equations. Transfers describe where the numbers of a run lie in memory:
rows of (row of the table, address of its first number, stride in bytes, kind).

Meanwhile subnormal numbers count as 0, as in XLA: a component that decays becomes one, and then a
step would take ten times as long.
"""

import ctypes
import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from llvmlite import binding, ir

from .._base.stopping import RUNNING
from .machine_code import MachineCode, machine_code

WIDTH = 8  # lanes stepped together
CLAIM = 64  # runs that a thread takes at once, so that threads do not write to the same cache line
LONG, DOUBLE = ir.IntType(64), ir.DoubleType()
KINDS = {"float64": DOUBLE, "int64": LONG, "int32": ir.IntType(32), "bool": ir.IntType(8)}
"""The types of numbers in arrays; a kind is a position in this table."""
KERNEL = ir.FunctionType(ir.VoidType(), [DOUBLE.as_pointer(), LONG, DOUBLE.as_pointer()])


class Job(NamedTuple):
    """The arguments of the loop: integers, and addresses of arrays that the caller keeps alive."""

    begin: int
    """The machine code that begins the runs of a block of lanes."""
    advance: int
    finish: int
    size: int
    """The number of runs."""
    lane_rows: int
    """The number of rows of a run at work."""
    status: int
    """The row of its status."""
    queue: int
    """A counter of the runs that are taken, which threads share."""
    inputs: int
    """The transfers of the inputs of runs."""
    input_count: int
    outputs: int
    """The transfers of the results of ended runs."""
    output_count: int
    shared: int
    """The numbers that all lanes share."""
    fresh: int
    """A block of lanes, rows × WIDTH: the next runs from the queue."""
    block: int
    """The runs at work."""
    ended: int
    """The last runs that have ended."""


@functools.cache
def loop() -> tuple[Callable[[int], int], MachineCode]:
    """Return the loop, compiled once; two threads must not call this at the same time.

    Returns:
        A function of the address of a `Job`, an array of integers, that works off a queue of runs,
        as other threads may do at the same time; it gives the number of steps of this thread's
        block of lanes. And the owner of the code.
    """
    code = machine_code(_loop_in_llvm())
    return ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(code.address), code


def _loop_in_llvm() -> str:
    """Return the loop as LLVM code."""
    module = ir.Module("queue")
    function = ir.Function(module, ir.FunctionType(LONG, [LONG.as_pointer()]), "treat")
    code = _Code(ir.IRBuilder(function.append_basic_block()))
    with _without_subnormals(module, code.builder):
        steps = _write_loop(code, function.args[0])
    code.builder.ret(steps)
    return str(module)


@contextmanager
def _without_subnormals(module: ir.Module, builder: ir.IRBuilder) -> Iterator[None]:
    """Let the processor take subnormal numbers for 0 in the block under `with`."""
    byte, word, void = ir.IntType(8).as_pointer(), ir.IntType(32), ir.VoidType()
    machine = binding.get_process_triple().split("-")[0]
    if machine == "x86_64":  # bits FTZ and DAZ of MXCSR
        to_memory, from_memory = (
            ir.Function(module, ir.FunctionType(void, [byte]), f"llvm.x86.sse.{name}")
            for name in ("stmxcsr", "ldmxcsr")
        )
        places = [builder.alloca(word) for _ in range(2)]
        old, new = (builder.bitcast(place, byte) for place in places)
        builder.call(to_memory, [old])
        builder.store(builder.or_(builder.load(places[0]), word(0x8040)), places[1])
        builder.call(from_memory, [new])
        yield
        builder.call(from_memory, [old])
    elif machine in ("aarch64", "arm64"):  # bit FZ of FPCR
        get = ir.Function(module, ir.FunctionType(LONG, []), "llvm.aarch64.get.fpcr")
        put = ir.Function(module, ir.FunctionType(void, [LONG]), "llvm.aarch64.set.fpcr")
        before = builder.call(get, [])
        builder.call(put, [builder.or_(before, LONG(1 << 24))])
        yield
        builder.call(put, [before])
    else:
        yield


def _write_loop(code: "_Code", arguments: Any) -> Any:
    """Write the loop, and return the number of its steps.

    A lane without a run has the slot −1, as all have at first.
    """
    job = Job(*(code.load(arguments, i) for i in range(len(Job._fields))))
    fresh, block, ended = (code.pointer(x) for x in (job.fresh, job.block, job.ended))
    slot, slots = code.array(WIDTH), code.array(WIDTH)  # the runs in `block` and in `ended`
    # The runs from `following` to `last` are in `fresh`, and no lane has taken them yet. The runs
    # up to `claimed` belong to this thread, too.
    first, following, last, claimed = (code.variable() for _ in range(4))
    count, steps = code.variable(), code.variable()
    running, waits = code.variable(1), code.variable()
    with code.each(WIDTH) as lane:
        code.store(slot, lane, -1)

    def is_running(lane: Any) -> Any:
        status = code.load(block, code.place(job.status, lane))
        return code.builder.fcmp_ordered("==", status, ir.Constant(DOUBLE, RUNNING))

    def put_away(lane: Any) -> None:
        _copy_lane(code, job.lane_rows, (block, lane), (ended, count.value))
        code.store(slots, count.value, code.load(slot, lane))
        code.store(slot, lane, -1)
        count.add(1)
        with code.when(count.value, "==", WIDTH):
            write_results()

    def write_results() -> None:
        code.call(job.finish, ended, job.shared)
        with (
            code.each_transfer(job.outputs, job.output_count) as (row, address, stride, kind),
            code.each(count.value) as lane,
        ):
            run = code.load(slots, lane)
            number = code.load(ended, code.place(row, lane))
            code.store_as(kind, code.add(address, code.multiply(run, stride)), number)
        count.value = 0

    def take_runs() -> None:
        with code.when(following.value, "==", claimed.value):
            following.value = code.minimum(code.claim(job.queue, CLAIM), job.size)
            claimed.value = code.minimum(code.add(following.value, CLAIM), job.size)
        first.value = following.value
        last.value = code.minimum(code.add(following.value, WIDTH), claimed.value)
        with code.when(following.value, "<", last.value):
            with (
                code.each_transfer(job.inputs, job.input_count) as (row, address, stride, _),
                code.each(WIDTH) as k,
            ):
                run = code.minimum(code.add(following.value, k), code.subtract(job.size, 1))
                number = code.pointer(code.add(address, code.multiply(run, stride)))
                code.store(fresh, code.place(row, k), code.load(number, 0))
            code.call(job.begin, fresh, job.shared)

    def refill(lane: Any) -> None:
        with code.when(code.load(slot, lane), ">=", 0):
            put_away(lane)
        with code.when(following.value, "==", last.value):
            take_runs()
        with code.when(following.value, "==", last.value):
            waits.value = 0
        with code.when(following.value, "<", last.value):
            place = code.subtract(following.value, first.value)
            _copy_lane(code, job.lane_rows, (fresh, place), (block, lane))
            code.store(slot, lane, following.value)
            following.add(1)

    def advance() -> None:
        code.call(job.advance, block, job.shared)
        steps.add(1)

    with code.during(running, ">", 0):
        running.value = 0
        with code.each(WIDTH) as lane:
            waits.value = 1
            with code.during(waits, ">", 0), code.builder.if_else(is_running(lane)) as (yes, no):
                with yes:
                    running.add(1)
                    waits.value = 0
                with no:
                    refill(lane)
        with code.when(running.value, ">", 0):
            advance()
    write_results()
    return steps.value


def _copy_lane(code: "_Code", rows: Any, source: Any, target: Any) -> None:
    """Copy a lane from a place in a block to a place in another."""
    with code.each(rows) as row:
        number = code.load(source[0], code.place(row, source[1]))
        code.store(target[0], code.place(row, target[1]), number)


class _Variable:
    """An integer variable of the LLVM code."""

    def __init__(self, builder: ir.IRBuilder, initial: int) -> None:
        self._builder = builder
        with builder.goto_entry_block():
            self._place = builder.alloca(LONG)
        self.value = initial

    @property
    def value(self) -> Any:
        """The present value; a Python number may be assigned, too."""
        return self._builder.load(self._place)

    @value.setter
    def value(self, new: Any) -> None:
        self._builder.store(_integer(new), self._place)

    def add(self, number: int) -> None:
        self.value = self._builder.add(self.value, _integer(number))


class _Code:
    """A writer of instructions on integers, with loops and branches."""

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.builder = builder

    def variable(self, initial: int = 0) -> _Variable:
        return _Variable(self.builder, initial)

    def array(self, size: int) -> Any:
        """Return the address of some integers."""
        with self.builder.goto_entry_block():
            return self.builder.alloca(LONG, size)

    def pointer(self, address: Any) -> Any:
        """Return a pointer to numbers at an address."""
        return self.builder.inttoptr(address, DOUBLE.as_pointer())

    def add(self, a: Any, b: Any) -> Any:
        return self.builder.add(_integer(a), _integer(b))

    def subtract(self, a: Any, b: Any) -> Any:
        return self.builder.sub(_integer(a), _integer(b))

    def multiply(self, a: Any, b: Any) -> Any:
        return self.builder.mul(_integer(a), _integer(b))

    def minimum(self, a: Any, b: Any) -> Any:
        a, b = _integer(a), _integer(b)
        return self.builder.select(self.builder.icmp_signed("<", a, b), a, b)

    def place(self, row: Any, lane: Any) -> Any:
        """Return the index of a lane of a row in a block."""
        return self.add(self.multiply(row, WIDTH), lane)

    def load(self, pointer: Any, index: Any) -> Any:
        return self.builder.load(self.builder.gep(pointer, [_integer(index)]))

    def store(self, pointer: Any, index: Any, value: Any) -> None:
        self.builder.store(_integer(value), self.builder.gep(pointer, [_integer(index)]))

    def store_as(self, kind: Any, address: Any, number: Any) -> None:
        """Store a number at an address, converted to a kind."""
        for i, element in enumerate(KINDS.values()):
            with self.when(kind, "==", i):
                same = element == number.type
                value = number if same else self.builder.fptosi(number, element)
                self.builder.store(value, self.builder.inttoptr(address, element.as_pointer()))

    def call(self, address: Any, block: Any, shared: Any) -> None:
        """Call machine code of `jaxpr_to_llvm` for a block of lanes."""
        kernel = self.builder.inttoptr(address, KERNEL.as_pointer())
        self.builder.call(kernel, [block, _integer(WIDTH), self.pointer(shared)])

    def claim(self, address: Any, many: int) -> Any:
        """Raise a counter that threads share; returns its old value."""
        counter = self.builder.inttoptr(address, LONG.as_pointer())
        return self.builder.atomic_rmw("add", counter, _integer(many), "monotonic")

    @contextmanager
    def when(self, a: Any, sign: str, b: Any) -> Iterator[None]:
        """Write the block under `with` as a branch that is taken if a comparison holds."""
        with self.builder.if_then(self.builder.icmp_signed(sign, _integer(a), _integer(b))):
            yield

    @contextmanager
    def during(self, variable: _Variable, sign: str, bound: Any) -> Iterator[None]:
        """Write the block under `with` as a loop that runs while a comparison holds."""
        test, body, after = (self.builder.append_basic_block() for _ in range(3))
        self.builder.branch(test)
        self.builder.position_at_end(test)
        holds = self.builder.icmp_signed(sign, variable.value, _integer(bound))
        self.builder.cbranch(holds, body, after)
        self.builder.position_at_end(body)
        yield
        self.builder.branch(test)
        self.builder.position_at_end(after)

    @contextmanager
    def each(self, count: Any) -> Iterator[Any]:
        """Write the block under `with` as a loop over every index below a number."""
        index = self.variable()
        index.value = 0  # reset in every pass of an outer loop
        with self.during(index, "<", count):
            yield index.value
            index.add(1)

    @contextmanager
    def each_transfer(self, transfers: Any, count: Any) -> Iterator[list[Any]]:
        """Write the block under `with` as a loop over the rows of a table of transfers."""
        table = self.builder.inttoptr(transfers, LONG.as_pointer())
        with self.each(count) as row:
            yield [self.load(table, self.add(self.multiply(row, 4), i)) for i in range(4)]


def _integer(value: Any) -> Any:
    return LONG(value) if isinstance(value, int) else value
