"""The compiler of a traced function of one lane to machine code for a block of lanes.

The jaxpr of the function is written out scalar by scalar as straight-line LLVM code, in which
every value is a vector over the lanes. Loops of fixed length are unrolled. Arrays exist only while
the code is written, as arrays of LLVM values. A function without such a form is `Unsupported`.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal
from llvmlite import ir

from . import constant_folding
from .interface import Unsupported
from .machine_code import MachineCode, machine_code
from .vector_code import BITWISE, COMPARE, FLOAT, VectorBuilder

Value = np.ndarray
"""An array of numbers known while the code is written, or (dtype object) of LLVM values."""

_LONG = ir.IntType(64)
_FUNCTIONS = {"sqrt", "exp", "sin", "cos", "tan", "pow", "floor", "ceil", "atan2", "tanh"}
_FUNCTIONS |= {"exp2", "asin", "acos", "atan", "sinh", "cosh"}
_ROUND = ("round", "roundeven")  # by lax.RoundingMethod
_UNCHANGED = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
_MOVES = {"gather": (0,), "dynamic_slice": (0,), "scatter": (0, 2), "dynamic_update_slice": (0, 1)}
_MOVES |= {"rev": (0,), "pad": (0, 1)}
"""Primitives that only move data, and which operands are data; the others are indices."""


def _as_vectors(value: Value, dtype: Any, w: VectorBuilder) -> Value:
    """Return the array with LLVM values as entries, constants among them."""
    if value.dtype == object:
        return value
    return _array([w.constant(x, dtype) for x in value.ravel()], value.shape)


def _array(entries: Sequence[Any], shape: tuple[int, ...]) -> Value:
    array = np.empty(len(entries), object)
    array[:] = entries
    return array.reshape(shape)


def _fold(combine: Callable[[Any, Any], Any], value: Value, axes: Sequence[int]) -> Value:
    """Combine along some axes, pairwise from the front."""
    kept = [axis for axis in range(value.ndim) if axis not in axes]
    shape = tuple(value.shape[axis] for axis in kept)
    rows = value.transpose(*kept, *axes).reshape(*shape, -1)
    entries = [functools.reduce(combine, rows[index]) for index in np.ndindex(*shape)]
    return _array(entries, shape)


def _move_by_numbers(
    name: str, eqn: Any, values: list[Value], data: Sequence[int], w: VectorBuilder
) -> Value:
    """Move entries: apply the primitive to their indices, and see where these go."""
    if any(v.dtype == object for i, v in enumerate(values) if i not in data):
        raise Unsupported(f"{name} with indices that are not known beforehand")
    dtype = eqn.outvars[0].aval.dtype
    parts = [_as_vectors(values[i], dtype, w) for i in data]
    ends = np.cumsum([0, *(part.size for part in parts)])
    numbers = [jnp.asarray(v) if i not in data else None for i, v in enumerate(values)]
    for i, part, first in zip(data, parts, ends[:-1], strict=True):
        numbers[i] = jnp.arange(first, first + part.size, dtype="int32").reshape(part.shape)
    order = np.asarray(eqn.primitive.bind(*numbers, **eqn.params))
    return np.concatenate([part.ravel() for part in parts])[order]


def _is_zero(entry: Any) -> bool:
    return isinstance(entry, ir.Constant) and all(e.constant == 0 for e in entry.constant)


def _dot(params: dict[str, Any], a: Value, b: Value, w: VectorBuilder) -> Value:
    """Write out dot_general."""
    (sum_a, sum_b), (batch_a, batch_b) = params["dimension_numbers"]
    letters = itertools.count()
    name_a = [next(letters) for _ in range(a.ndim)]
    name_b = [next(letters) for _ in range(b.ndim)]
    for i, j in [*zip(sum_a, sum_b, strict=True), *zip(batch_a, batch_b, strict=True)]:
        name_b[j] = name_a[i]
    batch = [name_a[i] for i in batch_a]
    summed = [name_a[i] for i in sum_a]
    free = [n for n in name_a + name_b if n not in batch + summed]
    size = dict(zip(name_a + name_b, a.shape + b.shape, strict=True))
    shape = tuple(size[n] for n in batch + free)
    entries = []
    for index in np.ndindex(*shape):
        place = dict(zip(batch + free, index, strict=True))
        terms = []
        for s in np.ndindex(*(size[n] for n in summed)):
            place |= dict(zip(summed, s, strict=True))
            x, y = a[tuple(place[n] for n in name_a)], b[tuple(place[n] for n in name_b)]
            if not (_is_zero(x) or _is_zero(y)):  # many weights of a tableau are zero
                terms.append(w.arithmetic("mul", x, y))
        none = w.constant(0, params["preferred_element_type"] or "float64")
        entries.append(functools.reduce(functools.partial(w.arithmetic, "add"), terms or [none]))
    return _array(entries, shape)


def _arg_extreme(name: str, eqn: Any, value: Value, w: VectorBuilder) -> Value:
    """Return the index of the largest or smallest entry, the first of equal ones."""
    (axis,) = eqn.params["axes"]
    dtype = eqn.outvars[0].aval.dtype
    rows = np.moveaxis(value, axis, -1)
    indices = []
    for lane in np.ndindex(*rows.shape[:-1]):
        best, index = rows[lane][0], w.constant(0, dtype)
        for i, entry in enumerate(rows[lane][1:], 1):
            better = w.compare("gt" if name == "argmax" else "lt", entry, best)
            best = w.select(better, entry, best)
            index = w.select(better, w.constant(i, dtype), index)
        indices.append(index)
    return _array(indices, rows.shape[:-1])


def _scan(eqn: Any, values: list[Value], w: VectorBuilder) -> list[Value]:
    """Unroll a loop of fixed length."""
    p = eqn.params
    body = getattr(p["jaxpr"], "jaxpr", p["jaxpr"])
    # Versions of JAX name these numbers differently. Only rows have an additional axis outside.
    carried = _count_equal_ranks(eqn.outvars, body.outvars)
    kept = _count_equal_ranks(eqn.invars, body.invars)
    consts, carry, xs = values[: kept - carried], values[kept - carried : kept], values[kept:]
    rows = []
    steps = range(p["length"])
    for i in reversed(steps) if p["reverse"] else steps:
        out = _write(p["jaxpr"], [*consts, *carry, *(x[i] for x in xs)], w)
        carry, row = out[:carried], out[carried:]
        rows.append(row)
    if p["reverse"]:
        rows.reverse()
    return [*carry, *(_stack(column) for column in zip(*rows, strict=True))]


def _count_equal_ranks(outside: Sequence[Any], inside: Sequence[Any]) -> int:
    return sum(a.aval.ndim == b.aval.ndim for a, b in zip(outside, inside, strict=True))


def _stack(column: Sequence[Value]) -> Value:
    if len({v.dtype == object for v in column}) == 2:
        raise Unsupported("a loop whose results are partly constants")
    return np.stack(column)


def _select(which: Any, cases: Sequence[Any], dtype: Any, w: VectorBuilder) -> Any:
    """Return the case with index `which`; False is the first, True the second."""
    if np.dtype(dtype).kind == "b":
        return w.select(which, cases[1], cases[0])
    result = cases[0]
    for i, case in enumerate(cases[1:], 1):
        result = w.select(w.compare("eq", which, w.constant(i, dtype)), case, result)
    return result


class _Operation(NamedTuple):
    """An elementwise operation of a jaxpr, applied to one entry of each operand."""

    w: VectorBuilder
    params: dict[str, Any]
    dtype: Any
    """The type of the first operand."""
    result_dtype: Any

    def constant(self, number: int | float) -> Any:
        return self.w.constant(number, self.dtype)


_ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "max": lambda op, a, b: op.w.extreme("max", a, b),
    "min": lambda op, a, b: op.w.extreme("min", a, b),
    "neg": lambda op, a: op.w.negative(a, op.dtype),
    "abs": lambda op, a: op.w.absolute(a, op.dtype),
    "sign": lambda op, a: op.w.sign(a, op.dtype),
    "log": lambda op, a: op.w.logarithm(a),
    "square": lambda op, a: op.w.arithmetic("mul", a, a),
    "rsqrt": lambda op, a: op.w.arithmetic("div", op.constant(1), op.w.function("sqrt", a)),
    "integer_pow": lambda op, a: op.w.power(a, op.params["y"]),
    "round": lambda op, a: op.w.function(_ROUND[int(op.params["rounding_method"])], a),
    "is_finite": lambda op, a: op.w.compare("lt", op.w.absolute(a, op.dtype), op.constant(np.inf)),
    "select_n": lambda op, which, *cases: _select(which, cases, op.dtype, op.w),
    "clamp": lambda op, low, a, high: op.w.extreme("min", op.w.extreme("max", low, a), high),
    "convert_element_type": lambda op, a: op.w.convert(a, op.dtype, op.result_dtype),
}
"""Elementwise primitives that have no instruction of their own."""


def _elementwise(name: str, eqn: Any, w: VectorBuilder) -> Callable[..., Any]:
    """Return the function of single entries that an elementwise primitive applies."""
    kinds = (FLOAT, w.arithmetic), (COMPARE, w.compare), (_FUNCTIONS, w.function)
    for names, write in (*kinds, (BITWISE, w.bitwise)):
        if name in names:
            return functools.partial(write, name)
    if name not in _ELEMENTWISE:
        raise Unsupported(f"the operation {name}")
    dtype, result_dtype = eqn.invars[0].aval.dtype, eqn.outvars[0].aval.dtype
    return functools.partial(_ELEMENTWISE[name], _Operation(w, eqn.params, dtype, result_dtype))


_REDUCE = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
_REDUCE |= {"reduce_and": "and", "reduce_or": "or"}


def _apply(eqn: Any, values: list[Value], w: VectorBuilder) -> list[Value]:
    """Return the results of one equation of a jaxpr."""
    name = eqn.primitive.name
    if name in constant_folding.CALLS:
        return _write(eqn.params[constant_folding.CALLS[name]], values, w)
    if name == "scan":
        return _scan(eqn, values, w)
    if name in _UNCHANGED:
        return values
    if all(v.dtype != object for v in values):  # known while the code is written
        return constant_folding.apply(eqn, values)
    if name in _MOVES:
        return [_move_by_numbers(name, eqn, values, _MOVES[name], w)]
    kinds = [v.aval.dtype for v in eqn.invars]
    values = [_as_vectors(v, kind, w) for v, kind in zip(values, kinds, strict=True)]
    if name in constant_folding.MOVES:
        return [constant_folding.MOVES[name](eqn.params, *values)]
    if name == "unstack":
        return list(np.moveaxis(values[0], eqn.params["axis"], 0))
    if name == "split":  # of which JAX 0.10.0 makes `unstack`
        ends = np.cumsum(eqn.params["sizes"])[:-1]
        return np.split(values[0], ends, eqn.params["axis"])
    if name == "dot_general":
        return [_dot(eqn.params, values[0], values[1], w)]
    if name in ("argmax", "argmin"):
        return [_arg_extreme(name, eqn, values[0], w)]
    if name in _REDUCE:
        return [_fold(_elementwise(_REDUCE[name], eqn, w), values[0], eqn.params["axes"])]
    make = _elementwise(name, eqn, w)
    arrays = np.broadcast_arrays(*values)
    entries = [make(*entry) for entry in zip(*(a.ravel() for a in arrays), strict=True)]
    return [_array(entries, arrays[0].shape)]


def _write(closed: Any, values: list[Value], w: VectorBuilder) -> list[Value]:
    """Write the instructions of a jaxpr, and return its results."""
    jaxpr, consts = (
        (closed.jaxpr, closed.consts) if isinstance(closed, ClosedJaxpr) else (closed, [])
    )
    known: dict[Any, Value] = {}
    known |= zip(jaxpr.constvars, map(np.asarray, consts), strict=True)
    known |= zip(jaxpr.invars, values, strict=True)

    def read(atom: Any) -> Value:
        return np.asarray(atom.val) if isinstance(atom, Literal) else known[atom]

    for eqn in jaxpr.eqns:
        known |= zip(eqn.outvars, _apply(eqn, [read(v) for v in eqn.invars], w), strict=True)
    return [read(v) for v in jaxpr.outvars]


class _TableAccess:
    """Loads and stores of the numbers of a table, in the function that is being written."""

    def __init__(self, w: VectorBuilder, first: Any, stride: Any, shared: Any) -> None:
        self.w, self.vector = w, w.vector("float64")
        self.first, self.stride, self.shared = first, stride, shared

    def load_rows(self, rows: Iterator[int], leaf: Any) -> Value:
        """Return the next rows, as an array like `leaf`."""
        entries = []
        for _ in range(leaf.size):
            raw = self.w.builder.load(self._place(next(rows)), align=8)
            entries.append(self.w.convert(raw, "float64", leaf.dtype))
        return _array(entries, leaf.shape)

    def load_shared(self, i: int, leaf: Any) -> Value:
        """Return the i-th of the shared numbers, the same in all lanes."""
        w = self.w
        number = w.builder.load(w.builder.gep(self.shared, [ir.Constant(_LONG, i)]))
        undefined = ir.Constant(self.vector, None)
        one = w.builder.insert_element(undefined, number, ir.Constant(_LONG, 0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), w.width), [0] * w.width)
        vector = w.builder.shuffle_vector(one, undefined, mask)
        return _array([w.convert(vector, "float64", leaf.dtype)], leaf.shape)

    def store(self, row: int, number: Any, dtype: Any) -> None:
        raw = self.w.convert(number, dtype, "float64")
        self.w.builder.store(raw, self._place(row), align=8)

    def _place(self, row: int) -> Any:
        """Return the address of a row."""
        b = self.w.builder
        start = b.gep(self.first, [b.mul(self.stride, ir.Constant(_LONG, row))])
        return b.bitcast(start, self.vector.as_pointer())


def compiled(function: Callable[..., Any], rows: Any, shared: Any, width: int) -> MachineCode:
    """Compile rows = function(rows, shared) to machine code for `width` lanes of a table.

    Args:
        function: from a pytree of rows and one of shared numbers to a pytree like `rows`.
        rows: the rows of the table, in order; leaves with a trailing axis of one lane.
        shared: scalars that all lanes share.
        width: the number of lanes that are computed together.

    Returns:
        A function `void (double *first, int64 stride, double *shared)`; row i begins at
        first + i·stride. Every number of the table is a float64.

    Raises:
        Unsupported: the function cannot be written as straight-line code.
    """
    shapes = jax.eval_shape(lambda *x: x, rows, shared)
    jaxpr = jax.make_jaxpr(lambda pair: jax.tree.leaves(function(*pair)))(shapes)
    rows, shared = (jax.tree.leaves(part) for part in shapes)
    return machine_code(_in_llvm(jaxpr, rows, shared, width))


def _in_llvm(jaxpr: ClosedJaxpr, rows: list[Any], shared: list[Any], width: int) -> str:
    """Return a traced function of rows and shared numbers as LLVM code."""
    double = ir.DoubleType().as_pointer()
    module = ir.Module("lanes")
    kind = ir.FunctionType(ir.VoidType(), [double, _LONG, double])
    kernel = ir.Function(module, kind, "treat")
    w = VectorBuilder(ir.IRBuilder(kernel.append_basic_block()), width)
    table = _TableAccess(w, *kernel.args)
    numbers = itertools.count()
    leaves = [table.load_rows(numbers, leaf) for leaf in rows]
    given = [table.load_shared(i, leaf) for i, leaf in enumerate(shared)]
    before = [entry for leaf in leaves for entry in leaf.ravel()]
    try:
        results = _write(jaxpr, leaves + given, w)
    except KeyError as name:  # of a parameter of a primitive
        raise Unsupported(f"this version of JAX, without the parameter {name}") from None
    dtypes = [variable.aval.dtype for variable in jaxpr.jaxpr.outvars]
    row = itertools.count()
    for value, dtype in zip(results, dtypes, strict=True):
        for number in _as_vectors(value, dtype, w).ravel():
            here = next(row)
            if number is not before[here]:
                table.store(here, number, dtype)
    w.builder.ret_void()
    return str(module)
