"""Operations of a traced program on numbers that are known while machine code is written.

NumPy does them where it gives the same bits, since JAX would compile a program for each: operations
that only move numbers, or that IEEE 754 defines to the last bit. JAX does the others.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

CALLS = {"jit": "jaxpr", "closed_call": "call_jaxpr"}
CALLS |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}
"""Primitives that call a program, and the parameter that holds it."""


def _slice(params: dict[str, Any], x: np.ndarray) -> np.ndarray:
    strides = params["strides"] or [1] * x.ndim
    return x[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]


def _broadcast(params: dict[str, Any], x: np.ndarray) -> np.ndarray:
    shape, kept = params["shape"], params["broadcast_dimensions"]
    new = [axis for axis in range(len(shape)) if axis not in kept]
    return np.broadcast_to(np.expand_dims(x, new), shape)


MOVES: dict[str, Callable[..., np.ndarray]] = {
    "slice": _slice,
    "squeeze": lambda params, x: np.squeeze(x, params["dimensions"]),
    "reshape": lambda params, x: x.reshape(params["new_sizes"]),
    "transpose": lambda params, x: x.transpose(params["permutation"]),
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda params, *parts: np.concatenate(parts, params["dimension"]),
    "stack": lambda params, *rows: np.stack(rows, params["axis"]),
}
"""The common primitives that only move data of any type."""


EXACT: dict[str, Callable[..., Any]] = MOVES | {
    "select_n": lambda params, which, *cases: np.choose(which.astype(int), cases),
    "neg": lambda params, x: -x,
    "abs": lambda params, x: np.abs(x),
    "not": lambda params, x: ~x,
    "and": lambda params, a, b: a & b,
    "or": lambda params, a, b: a | b,
    "xor": lambda params, a, b: a ^ b,
    "is_finite": lambda params, x: np.isfinite(x),
    "rem": lambda params, a, b: np.fmod(a, b),
}
"""Primitives that give the same bits in NumPy and XLA, subnormal numbers included."""

ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    **{"eq": np.equal, "ne": np.not_equal},
    **{"lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal},
}
"""Arithmetic primitives, for which XLA replaces subnormal numbers by 0."""


def apply(eqn: Any, values: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the results of one equation of a jaxpr for known operands: in NumPy, or by JAX."""
    name, params = eqn.primitive.name, eqn.params
    kinds = {value.dtype.kind for value in values}
    # XLA divides an array by a scalar as a product with the reciprocal.
    by_one = name == "div" and values[0].shape != values[1].shape
    with np.errstate(all="ignore"):
        if name in EXACT and (name != "rem" or kinds == {"f"}):
            return [np.asarray(EXACT[name](params, *values))]
        if name in ARITHMETIC and kinds == {"f"} and not by_one:
            return [np.asarray(_flushed(ARITHMETIC[name](*map(_flushed, values))))]
        if name in ARITHMETIC and "f" not in kinds and name != "div":
            return [np.asarray(ARITHMETIC[name](*values))]
        if name == "round" and int(params["rounding_method"]) == 1:  # to even
            return [np.asarray(np.rint(_flushed(values[0])))]
        if name == "argmax" and kinds == {"b"}:
            (axis,) = params["axes"]
            return [np.asarray(np.argmax(values[0], axis), params["index_dtype"])]
        if name == "convert_element_type":
            new = np.dtype(params["new_dtype"])
            # JAX saturates numbers that are out of the range of integers.
            if "f" not in kinds or new.kind in "fb":
                return [values[0].astype(new)]
    results = eqn.primitive.bind(*values, **params)
    return [np.asarray(x) for x in (results if eqn.primitive.multiple_results else [results])]


def _flushed(values: Any) -> Any:
    """Replace subnormal numbers by 0 of the same sign."""
    numbers = np.asarray(values)
    if numbers.dtype.kind != "f":
        return numbers
    small = np.abs(numbers) < np.finfo(numbers.dtype).tiny
    return np.where(small, np.copysign(0, numbers), numbers) if small.any() else numbers
