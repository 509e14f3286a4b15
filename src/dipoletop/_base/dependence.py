"""Dependence of the results of a function on its arguments, from its traced program."""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import Literal


def dependence(function: Callable[..., Any], *arguments: Any) -> list[tuple[bool, ...]]:
    """Return for each argument, an array, whether each leaf of the result may depend on it.

    Every operation is taken to depend on all its operands, so the answer may be a false yes, but
    never a false no.
    """
    jaxpr = jax.make_jaxpr(lambda *x: jax.tree.leaves(function(*x)))(*arguments).jaxpr
    sources = {variable: {i} for i, variable in enumerate(jaxpr.invars)}

    def of(atom: Any) -> set[int]:
        return set() if isinstance(atom, Literal) else sources.get(atom, set())

    for eqn in jaxpr.eqns:
        common = set().union(*map(of, eqn.invars))
        sources |= dict.fromkeys(eqn.outvars, common)
    return [tuple(i in of(atom) for atom in jaxpr.outvars) for i in range(len(arguments))]
