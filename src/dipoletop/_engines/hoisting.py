"""What a function computes from some of its arguments alone, so that this is done only once.

Most operations of a step are on the state. But the verdict on a body also needs its principal
moments, the average torque on it and more, which change from run to run only. `Hoisted` finds them
in the traced function, whoever wrote it.

The jaxpr is gone through twice. The first time only operations on fixed arguments are done, and
those results are kept that other operations need. The second time these other operations are done.
An operation that only moves fixed numbers is not worth a place in memory, and is done both times.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun
from jaxtyping import Array

from .._base.numpy_programs import CALLS

_MOVES = {"slice", "squeeze", "reshape", "transpose", "broadcast_in_dim", "concatenate", "stack"}
_MOVES |= {"unstack", "stop_gradient", "copy"}

_CONSTANT, _GIVEN, _FIXED, _VARYING = range(4)
"""Kinds of values: constants; fixed arguments, moved at most; other functions of these; the rest.
An operation on values of several kinds gives one of the last kind among them."""


class _Value:
    """A value of a jaxpr; None where it is not computed."""

    def __init__(self, kind: int, value: Any) -> None:
        self.kind, self.value, self.kept = kind, value, False


class Hoisted:
    """A function of two pytrees of arrays, the first of them fixed.

    Args:
        function: its arguments are `fixed` and `varying`.
        fixed: arguments with the shapes of the later ones; all have the lanes on the last axis.
        varying: such arguments.
    """

    def __init__(self, function: Callable[[Any, Any], Any], fixed: Any, varying: Any) -> None:
        shapes = jax.eval_shape(lambda *x: x, fixed, varying)
        self._closed, result = jax.make_jaxpr(function, return_shape=True)(*shapes)
        self._structure = jax.tree.structure(result)
        self._lanes = jax.tree.leaves(shapes[0])[0].shape[-1]
        self.saved = 0
        """The number of operations on each lane that `once` has done; 0 until it is called."""

    def once(self, fixed: Any) -> list[Array]:
        """Those functions of the fixed arguments that are needed besides."""
        kept: list[Array] = []
        self.saved = 0

        def use(value: _Value) -> None:
            if value.kind == _FIXED and not value.kept:
                value.kept = True
                kept.append(value.value)

        given = [_Value(_GIVEN, x) for x in jax.tree.leaves(fixed)]
        missing = len(self._closed.jaxpr.invars) - len(given)
        self._run([*given, *(_Value(_VARYING, None) for _ in range(missing))], use, _VARYING)
        return kept

    def rest(self, fixed: Any, varying: Any, kept: list[Array] | None) -> Any:
        """What the function gives, by means of the results of `once`; without them all anew."""
        if kept is None:
            arguments = jax.tree.leaves((fixed, varying))
            return jax.tree.unflatten(self._structure, jaxpr_as_fun(self._closed)(*arguments))
        following: Iterator[Array] = iter(kept)

        def use(value: _Value) -> None:
            if value.kind == _FIXED and not value.kept:
                value.kept, value.value = True, next(following)

        given = [_Value(_GIVEN, x) for x in jax.tree.leaves(fixed)]
        others = [_Value(_VARYING, x) for x in jax.tree.leaves(varying)]
        results = self._run([*given, *others], use, _FIXED)
        return jax.tree.unflatten(self._structure, [result.value for result in results])

    def _run(self, values: list[_Value], use: Callable[[_Value], None], left: int) -> list[_Value]:
        """The results; operations whose kind is `left` are left out."""
        results = self._inside(self._closed, values, use, left)
        for result in results:
            use(result)
        return results

    def _inside(
        self, closed: Any, values: list[_Value], use: Callable[[_Value], None], left: int
    ) -> list[_Value]:
        jaxpr, consts = (
            (closed.jaxpr, closed.consts) if isinstance(closed, ClosedJaxpr) else (closed, [])
        )
        known = dict(zip(jaxpr.constvars, (_Value(_CONSTANT, x) for x in consts), strict=True))
        known |= zip(jaxpr.invars, values, strict=True)

        def read(atom: Any) -> _Value:
            return _Value(_CONSTANT, atom.val) if isinstance(atom, Literal) else known[atom]

        for eqn in jaxpr.eqns:
            operands, name = [read(atom) for atom in eqn.invars], eqn.primitive.name
            if name in CALLS:
                results = self._inside(eqn.params[CALLS[name]], operands, use, left)
            else:
                results = self._apply(eqn, operands, use, left)
            known |= zip(eqn.outvars, results, strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def _apply(
        self, eqn: Any, operands: list[_Value], use: Callable[[_Value], None], left: int
    ) -> list[_Value]:
        kind = max((operand.kind for operand in operands), default=_CONSTANT)
        if kind == _GIVEN and eqn.primitive.name not in _MOVES:
            kind = _FIXED
        if any(out.aval.shape[-1:] != (self._lanes,) for out in eqn.outvars):
            kind = _VARYING if kind == _FIXED else kind  # what is kept has the lanes behind
        if kind == _VARYING:
            for operand in operands:
                use(operand)
        if kind == left:
            return [_Value(kind, None) for _ in eqn.outvars]
        values = eqn.primitive.bind(*(operand.value for operand in operands), **eqn.params)
        values = values if eqn.primitive.multiple_results else [values]
        if kind == _FIXED and eqn.primitive.name not in _MOVES:
            self.saved += sum(value.size for value in values) // max(self._lanes, 1)
        return [_Value(kind, value) for value in values]
