"""The problem of a sweep: the vectorised map from points to their equations and starts."""

import functools
import inspect
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._base.checks import check_equation, instance, real
from .._base.compiling import CompiledPrograms
from .._base.dependence import dependence
from .._base.digests import array_digest, program_digest
from .._base.linalg import length
from .._base.parallel import as_worker
from .._base.refusals import refuse
from .._base.types import DecidingEquation, Equation, State, Vector, Verdict
from ..equations._common import error_scale_of, physical
from ..equations.tangent import Tangent
from .columns import check_arguments
from .grids import Grid, Points, PointValues, Sample

Problem = TypeAliasType("Problem", Callable[..., tuple[Equation, Float[Array, "3"]]])
"""A function from the named values of one point to the equation and the start ω₀."""
StartBlock = tuple[Equation, Float[Array, "3 N"] | Float[np.ndarray, "3 N"]]
"""Equations and starts of N points; every array has a trailing lane axis."""


@dataclass(frozen=True)
class BlockBuilder:
    """A function from points to their equations and starts.

    With `derivatives` the equation is a `Tangent` with variations along these arguments.
    """

    problem: Problem
    over: Grid | Points | Sample
    derivatives: tuple[str, ...] = ()
    _tracing: Any = field(default_factory=threading.Lock)
    _programs: CompiledPrograms = field(default_factory=CompiledPrograms)
    _structures: list[Any] = field(default_factory=list)
    """That of a block, once it is known; like the programs it is the same over other values."""

    def __post_init__(self) -> None:
        check_problem(self.problem)
        instance("over", self.over, Grid | Points | Sample, "be a Grid, Points or a Sample")
        if not isinstance(self.over, Sample):
            _check_names(self.problem, tuple(self.over.header.values))
            check_arguments("over", self.over.header.values)

    def __call__(self, points: PointValues) -> StartBlock:
        """Return the block of these points of `over`; in NumPy on CPUs."""
        with as_worker():
            if jax.default_backend() != "cpu":
                return self._jitted(points)
            leaves = self._programs(lambda p: jax.tree.leaves(self._vectorised(p)), points)
            if not self._structures:
                self._structures.append(jax.tree.structure(self.template()))
            return jax.tree.unflatten(self._structures[0], map(np.asarray, leaves))

    def template(self) -> Any:
        """Return the shapes and types of a block of one point."""
        points = self.over.points(np.zeros(1, int))
        with as_worker():
            if self.derivatives:
                _check_derivatives(points, self.derivatives)
            return eqx.filter_eval_shape(self._vectorised, points)

    @functools.cached_property
    def _jitted(self) -> Callable[[PointValues], StartBlock]:
        return jax.jit(self._vectorised)

    def _vectorised(self, points: PointValues) -> StartBlock:
        of_point = self._with_variations if self.derivatives else self._equation_and_start
        with self._tracing:  # the user's function need not be thread-safe
            return jax.vmap(of_point, out_axes=-1)(points)

    def _equation_and_start(self, point: PointValues) -> tuple[Equation, Vector]:
        with jax.ensure_compile_time_eval():  # the problem's constants stay concrete: checked
            pair = self.problem(**point) if isinstance(point, dict) else self.problem(point)
        if not (isinstance(pair, tuple | list) and len(pair) == 2):
            refuse("problem", "return (equation, omega0)", f"returns {type(pair).__name__}")
        equation, omega0 = pair
        check_equation(equation)
        return equation, real("omega0 of problem", omega0, (3,), batch=False)

    def _with_variations(self, point: Any) -> tuple[Tangent, Vector]:
        """Return a point's equation with its variations along `derivatives`, and its start."""

        def varied(values: tuple[Array, ...]) -> Any:
            changes = dict(zip(self.derivatives, values, strict=True))
            equation, omega0 = self._equation_and_start(point | changes)
            arrays, rest = eqx.partition(physical(equation), eqx.is_inexact_array)
            return (arrays, omega0), rest

        values = tuple(point[name] for name in self.derivatives)
        (arrays, omega0), push_forward, rest = jax.linearize(varied, values, has_aux=True)
        units = tuple(jnp.eye(len(values)))
        parameters, starts = jax.vmap(push_forward)(units)
        varying = dependence(lambda *changes: push_forward(changes)[0], *values)
        equation = eqx.combine(arrays, rest)
        tangent = Tangent(equation, parameters, starts, length(omega0), varying=tuple(varying))
        return tangent, omega0

    def program_digests(self) -> dict[str, bytes]:
        """Return the digest of every function that is evaluated for a point, by its role."""
        points = self.over.points(np.zeros(1, int))
        made, omegas = self.template()
        equation = physical(made)
        with as_worker():
            state = jax.eval_shape(equation.lift, omegas)
            digests = {
                "problem": program_digest(self._vectorised, points),
                "field": _digest_of(lambda f, at: f(*at, None), equation, (jnp.zeros(()), state)),
                "lift": _digest_of(lambda f, omega: f.lift(omega), equation, omegas),
                "verdict": _digest_of(_verdict, equation, state),
                "sizes": _digest_of(lambda f, y: error_scale_of(f)(y), equation, state),
            }
            if isinstance(self.over, Sample):
                digests["draw"] = program_digest(self.over.draw, jax.random.key(0))
        return digests


def _digest_of(method: Callable[[Any, Any], Any], equation: Equation, argument: Any) -> bytes:
    """Return the digest of a method as a function of the equation's arrays and the argument."""
    arrays, rest = eqx.partition(equation, lambda leaf: isinstance(leaf, jax.ShapeDtypeStruct))

    def leaves(arrays: Any, argument: Any) -> list[Any]:
        return jax.tree.leaves(method(eqx.combine(arrays, rest), argument))

    return program_digest(leaves, arrays, argument)


def _verdict(equation: DecidingEquation, y: State) -> Verdict:
    """Return the verdict, certified only if its regions are proven for this class of equation."""
    verdict = Verdict(*equation.verdict(y))
    return verdict._replace(certified=verdict.certified_for(equation))


def check_problem(problem: Any) -> None:
    """Refuse a problem that is not callable."""
    if not callable(problem):
        refuse("problem", "be a function that gives (equation, omega0)", f"is {problem!r}")


def _check_derivatives(points: PointValues, derivatives: tuple[str, ...]) -> None:
    named = points if isinstance(points, dict) else {}
    numbers = [name for name, values in named.items() if values.ndim == 1]
    for name in derivatives:
        if name not in numbers:
            known = ", ".join(numbers) or "none here"
            refuse("derivatives", f"name arguments that are numbers ({known})", f"names `{name}`")


def _check_names(problem: Problem, names: tuple[str, ...]) -> None:
    """Refuse names that do not match the arguments of the problem."""
    try:
        signature = inspect.signature(problem)
    except ValueError:  # some callables have no signature
        return
    try:
        signature.bind(**dict.fromkeys(names))
    except TypeError as error:
        must = f"name the arguments of `problem` {signature}"
        refuse("over", must, f"has {', '.join(names)} ({error})")


def first_lanes(block: StartBlock, length: int) -> Any:  # a `StartBlock` of another length
    """Return the equations and starts of the first `length` points."""
    if block[1].shape[1] == length:
        return block
    return jax.tree.map(lambda x: x[..., :length] if eqx.is_array(x) else x, block)


def joined(blocks: Sequence[Any]) -> Any:  # of several lengths
    """Return one block with the lanes of several blocks."""
    if len(blocks) == 1:
        return blocks[0]
    arrays, rest = zip(*(eqx.partition(block, eqx.is_array) for block in blocks), strict=True)
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=-1), *arrays)
    return eqx.combine(together, rest[0])


def block_digest(block: StartBlock) -> bytes:
    """Return the digest of equations and starts, parameter by parameter."""
    return array_digest(*jax.tree.leaves(eqx.filter(block, eqx.is_array)))
