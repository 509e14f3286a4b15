"""Traced programs of JAX, run in NumPy where that gives the same bits.

JAX compiles a program for every operation that is done outside of `jax.jit`, which takes longer
than thousands of starts need. Operations that IEEE 754 defines to the last bit, and those that only
move numbers, need none; the others are left to JAX one by one, as if this module were not there.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

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
"""The common primitives that only move data, of whatever type."""


def _select(params: dict[str, Any], which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    result = cases[0]
    for i, case in enumerate(cases[1:], 1):
        result = np.where(which == i, case, result)
    return result


EXACT: dict[str, Callable[..., Any]] = MOVES | {
    "select_n": _select,
    "neg": lambda params, x: -x,
    "abs": lambda params, x: np.abs(x),
    "not": lambda params, x: ~x,
    "and": lambda params, a, b: a & b,
    "or": lambda params, a, b: a | b,
    "xor": lambda params, a, b: a ^ b,
    "is_finite": lambda params, x: np.isfinite(x),
    "rem": lambda params, a, b: np.fmod(a, b),
}
"""Primitives that take numbers as they are."""

ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    **{"eq": np.equal, "ne": np.not_equal},
    **{"lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal},
}
"""Primitives of numbers, for which XLA takes subnormal ones for 0."""

SIMPLE = {*EXACT, *ARITHMETIC, "round", "argmax", "convert_element_type"}


def apply(eqn: Any, values: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The results of one equation of a jaxpr for known operands: in NumPy, or by JAX."""
    name, params = eqn.primitive.name, eqn.params
    kinds = {value.dtype.kind for value in values}
    # XLA divides by one number for all by a product with its reciprocal.
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
        # JAX saturates where a number is out of the range of integers.
        if name == "convert_element_type" and not ("f" in kinds and _to_integer(params)):
            return [values[0].astype(params["new_dtype"])]
    results = eqn.primitive.bind(*values, **params)
    return [np.asarray(x) for x in (results if eqn.primitive.multiple_results else [results])]


def _to_integer(params: dict[str, Any]) -> bool:
    return np.dtype(params["new_dtype"]).kind not in "fb"


def _flushed(values: Any) -> Any:
    """The numbers, subnormal ones replaced by 0 of the same sign."""
    numbers = np.asarray(values)
    if numbers.dtype.kind != "f":
        return numbers
    small = np.abs(numbers) < np.finfo(numbers.dtype).tiny
    return np.where(small, np.copysign(0, numbers), numbers) if small.any() else numbers


class NumpyProgram:
    """A traced program, prepared to be run in NumPy many times.

    What does not depend on the arguments is computed once. Results are bit for bit those of the
    operations done one by one in JAX.
    """

    def __init__(self, program: ClosedJaxpr) -> None:
        self._values: list[np.ndarray | None] = []
        """The number of every variable; None where it depends on the arguments."""
        self._steps: list[tuple[Any, list[int], list[int]]] = []
        """Equations left to be computed, with the places of their operands and results."""
        self._arguments = [self._placed(None) for _ in program.jaxpr.invars]
        self._results = self._prepared(program.jaxpr, program.consts, self._arguments)

    def __call__(self, *arguments: Any) -> list[np.ndarray]:
        """The results for these arguments."""
        values: list[Any] = self._values.copy()
        for place, argument in zip(self._arguments, arguments, strict=True):
            values[place] = np.asarray(argument)
        for eqn, operands, places in self._steps:
            results = apply(eqn, [values[i] for i in operands])
            for place, result in zip(places, results, strict=True):
                values[place] = result
        return [values[place] for place in self._results]

    def _placed(self, value: np.ndarray | None) -> int:
        self._values.append(value)
        return len(self._values) - 1

    def _prepared(
        self, program: Jaxpr, consts: Sequence[Any], arguments: Sequence[int]
    ) -> list[int]:
        """The places of the results of a program, whose steps are appended."""
        known = [self._placed(np.asarray(const)) for const in consts]
        places = dict(zip(program.constvars, known, strict=True))
        places |= zip(program.invars, arguments, strict=True)

        def place(atom: Any) -> int:
            if isinstance(atom, Literal):
                kind: Any = atom.aval  # that of an array
                return self._placed(np.asarray(atom.val, kind.dtype))
            return places[atom]

        for eqn in program.eqns:
            operands = [place(atom) for atom in eqn.invars]
            inner = eqn.params.get(CALLS.get(eqn.primitive.name, ""))
            if isinstance(inner, ClosedJaxpr) and not _may_fuse(inner.jaxpr):
                results = self._prepared(inner.jaxpr, inner.consts, operands)
            else:
                results = self._computed(eqn, operands)
            places |= zip(eqn.outvars, results, strict=True)
        return [place(atom) for atom in program.outvars]

    def _computed(self, eqn: Any, operands: list[int]) -> list[int]:
        """The places of the results of one equation, computed now if its operands are known."""
        values = [self._values[i] for i in operands]
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            return [self._placed(result) for result in apply(eqn, known)]
        places = [self._placed(None) for _ in eqn.outvars]
        self._steps.append((eqn, operands, places))
        return places


def _may_fuse(program: Jaxpr) -> bool:
    """Whether JAX, which compiles a called program as a whole, may round it otherwise.

    A processor rounds a product only once with the sum that it is part of.
    """
    names = {eqn.primitive.name for eqn in program.eqns}
    if names & set(CALLS) or not names <= SIMPLE:
        return True
    return "mul" in names and not names.isdisjoint(("add", "sub"))


def asks_known_numbers(program: ClosedJaxpr) -> bool:
    """Whether the traced function compares numbers that do not depend on its arguments.

    Outside of a trace it would know the answer, and might refuse them.
    """
    unknown = set(program.jaxpr.invars)
    for eqn in program.jaxpr.eqns:
        if any(not isinstance(atom, Literal) and atom in unknown for atom in eqn.invars):
            unknown.update(eqn.outvars)
        elif eqn.primitive.name not in MOVES and any(x.aval.dtype == bool for x in eqn.outvars):
            return True
    return False
