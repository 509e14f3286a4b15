"""From a traced function of one lane to machine code for a block of lanes.

The jaxpr of the function is written out scalar by scalar as straight-line LLVM code, in which
every value is a vector over the lanes: loops of fixed length are unrolled, arrays exist while the
code is written and not when it runs. Floats are float64; what has no such form is `Unsupported`.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal
from llvmlite import ir

from .interface import Unsupported
from .vector_code import COMPARE, FLOAT, Writer, is_float, machine_code

Value = np.ndarray  # of numbers, known now, or of LLVM values (dtype object), known at run time

_BITS = {"and": "and_", "or": "or_", "xor": "xor"}
_FUNCTIONS = {"sqrt", "exp", "sin", "cos", "tan", "pow", "floor", "ceil", "atan2", "tanh"}
_FUNCTIONS |= {"exp2", "asin", "acos", "atan", "sinh", "cosh"}
_ROUND = ("round", "roundeven")  # by lax.RoundingMethod
_INNER = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr"}
_INNER |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "remat": "jaxpr"}
_UNCHANGED = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
_MOVES = {"gather": (0,), "dynamic_slice": (0,), "scatter": (0, 2), "dynamic_update_slice": (0, 1)}
_MOVES |= {"rev": (0,), "pad": (0, 1)}
"""Primitives that only move data, and which operands are data; the others are indices."""


def _lanes(value: Value, dtype: Any, w: Writer) -> Value:
    """The array with LLVM values as entries."""
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
    entries = [functools.reduce(combine, rows[at]) for at in np.ndindex(*shape)]
    return _array(entries, shape)


def _moved(name: str, eqn: Any, values: list[Value], data: Sequence[int], w: Writer) -> Value:
    """Run the primitive itself on the numbers of the entries, to see where they go."""
    if any(v.dtype == object for i, v in enumerate(values) if i not in data):
        raise Unsupported(f"{name} with indices that are not known beforehand")
    dtype = eqn.outvars[0].aval.dtype
    parts = [_lanes(values[i], dtype, w) for i in data]
    ends = np.cumsum([0, *(part.size for part in parts)])
    places = [jnp.asarray(v) if i not in data else None for i, v in enumerate(values)]
    for i, part, start in zip(data, parts, ends[:-1], strict=True):
        places[i] = jnp.arange(start, start + part.size, dtype="int32").reshape(part.shape)
    went = np.asarray(eqn.primitive.bind(*places, **eqn.params))
    return np.concatenate([part.ravel() for part in parts])[went]


def _placed(name: str, params: dict[str, Any], values: list[Value]) -> Value | None:
    """The common primitives that only move data, in numpy."""
    x = values[0]
    if name == "slice":
        strides = params["strides"] or [1] * x.ndim
        bounds = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
        return x[tuple(slice(*b) for b in bounds)]
    if name == "squeeze":
        return np.squeeze(x, params["dimensions"])
    if name == "reshape":
        return x.reshape(params["new_sizes"])
    if name == "transpose":
        return x.transpose(params["permutation"])
    if name == "broadcast_in_dim":
        places = params["broadcast_dimensions"]
        shape = [1] * len(params["shape"])
        for axis, place in enumerate(places):
            shape[place] = x.shape[axis]
        return np.broadcast_to(x.reshape(shape), params["shape"])
    if name == "concatenate":
        return np.concatenate(values, params["dimension"])
    if name == "stack":
        return np.stack(values, params.get("axis", params.get("dimension", 0)))
    return None


def _is_zero(entry: Any) -> bool:
    return isinstance(entry, ir.Constant) and all(e.constant == 0 for e in entry.constant)


def _dot(params: dict[str, Any], a: Value, b: Value, w: Writer) -> Value:
    """dot_general, written out."""
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
    for at in np.ndindex(*shape):
        place = dict(zip(batch + free, at, strict=True))
        terms = []
        for s in np.ndindex(*(size[n] for n in summed)):
            place |= dict(zip(summed, s, strict=True))
            x, y = a[tuple(place[n] for n in name_a)], b[tuple(place[n] for n in name_b)]
            if not (_is_zero(x) or _is_zero(y)):  # a weight of a sum
                terms.append(w.arithmetic("mul", x, y))
        none = w.constant(0, params["preferred_element_type"] or "float64")
        entries.append(functools.reduce(functools.partial(w.arithmetic, "add"), terms or [none]))
    return _array(entries, shape)


def _arg_extreme(name: str, eqn: Any, value: Value, w: Writer) -> Value:
    """Where the largest or smallest entry is, the first of equals."""
    (axis,) = eqn.params["axes"]
    dtype = eqn.outvars[0].aval.dtype
    rows = np.moveaxis(value, axis, -1)
    found = []
    for at in np.ndindex(*rows.shape[:-1]):
        best, index = rows[at][0], w.constant(0, dtype)
        for i, entry in enumerate(rows[at][1:], 1):
            better = w.compare("gt" if name == "argmax" else "lt", entry, best)
            best = w.select(better, entry, best)
            index = w.select(better, w.constant(i, dtype), index)
        found.append(index)
    return _array(found, rows.shape[:-1])


def _scan(eqn: Any, values: list[Value], w: Writer) -> list[Value]:
    """A loop of fixed length, unrolled."""
    p = eqn.params
    split = p["num_consts"], p["num_consts"] + p["num_carry"]
    consts, carry, xs = values[: split[0]], values[split[0] : split[1]], values[split[1] :]
    rows = []
    steps = range(p["length"])
    for i in reversed(steps) if p["reverse"] else steps:
        out = _write(p["jaxpr"], [*consts, *carry, *(x[i] for x in xs)], w)
        carry, row = out[: p["num_carry"]], out[p["num_carry"] :]
        rows.append(row)
    if p["reverse"]:
        rows.reverse()
    return [*carry, *(_stack(column) for column in zip(*rows, strict=True))]


def _stack(column: Sequence[Value]) -> Value:
    if any(v.dtype == object for v in column) and not all(v.dtype == object for v in column):
        raise Unsupported("a loop whose results are partly constants")
    return np.stack(column)


def _select(which: Any, cases: Sequence[Any], dtype: Any, w: Writer) -> Any:
    """The case of that number, or of that truth."""
    if np.dtype(dtype).kind == "b":
        return w.select(which, cases[1], cases[0])
    found = cases[0]
    for i, case in enumerate(cases[1:], 1):
        found = w.select(w.compare("eq", which, w.constant(i, dtype)), case, found)
    return found


def _elementwise(name: str, eqn: Any, w: Writer) -> Callable[..., Any] | None:
    """What one entry of the result is made of, entry by entry."""
    dtype = eqn.invars[0].aval.dtype
    params, new = eqn.params, eqn.outvars[0].aval.dtype
    one = functools.partial(w.constant, 1, dtype)
    table: dict[str, Callable[..., Any]] = {
        "max": functools.partial(w.extreme, "max"),
        "min": functools.partial(w.extreme, "min"),
        "neg": lambda a: (
            w.note(w.builder.fneg(a))
            if is_float(a)
            else w.arithmetic("sub", w.constant(0, dtype), a)
        ),
        "abs": lambda a: w.absolute(a, dtype),
        "sign": lambda a: w.sign(a, dtype),
        "log": w.logarithm,
        "square": lambda a: w.arithmetic("mul", a, a),
        "rsqrt": lambda a: w.arithmetic("div", one(), w.function("sqrt", a)),
        "integer_pow": lambda a: w.power(a, params["y"]),
        "round": lambda a: w.function(_ROUND[int(params["rounding_method"])], a),
        "is_finite": lambda a: w.compare("lt", w.absolute(a, dtype), w.constant(np.inf, dtype)),
        "not": lambda a: w.note(w.builder.not_(a)),
        "select_n": lambda which, *cases: _select(which, cases, dtype, w),
        "clamp": lambda low, a, high: w.extreme("min", w.extreme("max", low, a), high),
        "convert_element_type": lambda a: w.convert(a, dtype, new),
    }
    table |= {n: functools.partial(w.arithmetic, n) for n in FLOAT}
    table |= {n: functools.partial(w.compare, n) for n in COMPARE}
    table |= {n: functools.partial(w.function, n) for n in _FUNCTIONS}
    for n, method in _BITS.items():
        table[n] = lambda a, b, method=method: w.note(getattr(w.builder, method)(a, b))
    return table.get(name)


_REDUCE = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
_REDUCE |= {"reduce_and": "and", "reduce_or": "or"}


def _apply(eqn: Any, values: list[Value], w: Writer) -> list[Value]:
    """The results of one equation of a jaxpr."""
    name = eqn.primitive.name
    if name in _INNER:
        return _write(eqn.params[_INNER[name]], values, w)
    if name == "scan":
        return _scan(eqn, values, w)
    if name in _UNCHANGED:
        return values
    if all(v.dtype != object for v in values):  # known beforehand
        found = eqn.primitive.bind(*map(jnp.asarray, values), **eqn.params)
        return [np.asarray(v) for v in (found if eqn.primitive.multiple_results else [found])]
    if name in _MOVES:
        return [_moved(name, eqn, values, _MOVES[name], w)]
    kinds = [v.aval.dtype for v in eqn.invars]
    values = [_lanes(v, kind, w) for v, kind in zip(values, kinds, strict=True)]
    moved = _placed(name, eqn.params, values)
    if moved is not None:
        return [moved]
    if name == "dot_general":
        return [_dot(eqn.params, values[0], values[1], w)]
    if name in ("argmax", "argmin"):
        return [_arg_extreme(name, eqn, values[0], w)]
    if name in _REDUCE:
        combine = _elementwise(_REDUCE[name], eqn, w)
        assert combine is not None
        return [_fold(combine, values[0], eqn.params["axes"])]
    make = _elementwise(name, eqn, w)
    if make is None:
        raise Unsupported(f"the operation {name}")
    arrays = np.broadcast_arrays(*values)
    entries = [make(*entry) for entry in zip(*(a.ravel() for a in arrays), strict=True)]
    return [_array(entries, arrays[0].shape)]


def _write(closed: Any, values: list[Value], w: Writer) -> list[Value]:
    """Write a jaxpr's instructions; the results."""
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


def compiled(function: Any, rows: Any, shared: Any, width: int) -> tuple[int, Any]:
    """Machine code that does rows = function(rows, shared) to `width` lanes of a table.

    Args:
        function: from a pytree of rows and one of shared numbers to a pytree like `rows`.
        rows: what stands in the table's rows, in order; leaves with a trailing axis of one lane.
        shared: scalars that all lanes share.
        width: lanes treated together.

    Returns:
        The address of `void (double *first, int64 stride, double *shared)`, where row i begins at
        first + i·stride, and what keeps it alive. Every number is stored as a float64.

    Raises:
        Unsupported: the function cannot be written as straight-line code.
    """
    shape = (jax.eval_shape(lambda *x: x, rows, shared),)
    jaxpr = jax.make_jaxpr(lambda pair: jax.tree.leaves(function(*pair)))(*shape)
    double, long = ir.DoubleType(), ir.IntType(64)
    module = ir.Module("lanes")
    kind = ir.FunctionType(ir.VoidType(), [double.as_pointer(), long, double.as_pointer()])
    entry = ir.Function(module, kind, "treat")
    w = Writer(ir.IRBuilder(entry.append_basic_block()), width)
    first, stride, given = entry.args
    wide = w.vector("float64")

    def place(row: int) -> Any:
        start = w.builder.gep(first, [w.builder.mul(stride, ir.Constant(long, row))])
        return w.builder.bitcast(start, wide.as_pointer())

    count = itertools.count()

    def load(leaf: Any) -> Value:
        entries = []
        for _ in range(leaf.size):
            raw = w.builder.load(place(next(count)), align=8)
            entries.append(w.convert(raw, "float64", leaf.dtype))
        return _array(entries, leaf.shape)

    def spread(i: int, leaf: Any) -> Value:
        number = w.builder.load(w.builder.gep(given, [ir.Constant(long, i)]))
        one = w.builder.insert_element(ir.Constant(wide, None), number, ir.Constant(long, 0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
        vector = w.builder.shuffle_vector(one, ir.Constant(wide, None), mask)
        return _array([w.convert(vector, "float64", leaf.dtype)], leaf.shape)

    leaves = [load(leaf) for leaf in jax.tree.leaves(shape[0][0])]
    numbers = [spread(i, leaf) for i, leaf in enumerate(jax.tree.leaves(shape[0][1]))]
    kinds = [v.aval.dtype for v in jaxpr.jaxpr.outvars]
    row = itertools.count()
    before = [entry for leaf in leaves for entry in leaf.ravel()]
    for value, dtype in zip(_write(jaxpr, leaves + numbers, w), kinds, strict=True):
        for number in _lanes(value, dtype, w).ravel():
            at = next(row)
            if number is not before[at]:
                w.builder.store(w.convert(number, dtype, "float64"), place(at), align=8)
    w.builder.ret_void()
    return machine_code(str(module))
