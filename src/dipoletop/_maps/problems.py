"""A sweep's problem: from flat indices to the equations and starts of its points, vectorised."""

import dataclasses
import inspect
import threading
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import check_equation, real, refuse
from .._base.digests import array_digest, program_digest
from .._base.linalg import length
from .._base.parallel import as_worker
from .._base.types import Equation, Verdict
from .._branch.march import physical
from ..equations._common import sizes_of
from ..equations.tangent import Tangent
from .grids import Grid, Points, Sample

Problem = Callable[..., tuple[Equation, Float[Array, "3"]]]
"""From the named values of one point to the equation and the start ω₀."""


@dataclasses.dataclass(frozen=True)
class Builder:
    """From flat indices to (equation, ω₀), both with a trailing lane axis; see `builder`."""

    problem: Problem
    over: Grid | Points | Sample
    derivatives: tuple[str, ...]
    _one_at_a_time: Any = dataclasses.field(default_factory=threading.Lock)

    def __call__(self, index: np.ndarray) -> tuple[Any, Float[Array, "3 N"]]:
        """The equations and starts of these points."""
        with as_worker():
            points = self.over.points(index)
            if self.derivatives:
                _check_derivatives(points, self.derivatives)
            return self._mapped(points)

    def _mapped(self, points: Any) -> tuple[Any, Float[Array, "3 N"]]:
        one = self._varied if self.derivatives else self._at
        with self._one_at_a_time:  # so that the user's function need not be thread-safe
            return jax.vmap(one, out_axes=-1)(points)

    def _at(self, point: Any) -> tuple[Any, Float[Array, "3"]]:
        made = self.problem(**point) if isinstance(point, dict) else self.problem(point)
        if not (isinstance(made, tuple | list) and len(made) == 2):
            refuse("problem", "return (equation, omega0)", f"returns {type(made).__name__}")
        check_equation(made[0])
        return made[0], real("omega0 of problem", made[1], (3,), batch=False)

    def _varied(self, point: Any) -> Any:
        return _varied(self._at, point, self.derivatives)

    def programs(self) -> dict[str, bytes]:
        """Digests of all that is computed for a point, by what it is."""
        one = np.zeros(1, int)
        made, omegas = self(one)
        equation = physical(made)
        arrays, rest = eqx.partition(equation, eqx.is_array)

        def of(method: Callable[[Any, Any], Any], argument: Any) -> bytes:
            def leaves(arrays: Any, argument: Any) -> list[Any]:
                return jax.tree.leaves(method(eqx.combine(arrays, rest), argument))

            return program_digest(leaves, arrays, argument)

        with as_worker():
            state = jax.eval_shape(equation.lift, omegas)
            found = {
                "problem": program_digest(self._mapped, self.over.points(one)),
                "field": of(lambda equation, y: equation(0.0, y, None), state),
                "lift": of(lambda equation, omega: equation.lift(omega), omegas),
                "verdict": of(_verdict, state),
                "sizes": of(lambda equation, y: sizes_of(equation)(y), state),
            }
            if isinstance(self.over, Sample):
                found["draw"] = program_digest(self.over.draw, jax.random.key(0))
        return found


def _verdict(equation: Any, y: Any) -> Verdict:
    """The verdict as it counts for this equation."""
    found = Verdict(*equation.verdict(y))
    return found._replace(certified=found.certified_for(equation))


def builder(
    problem: Problem, over: Grid | Points | Sample, derivatives: tuple[str, ...] = ()
) -> Builder:
    """From flat indices to (equation, ω₀), both with a trailing lane axis.

    With `derivatives` the equation is a `Tangent`, whose variations are along these arguments.
    """
    check_problem(problem)
    if not isinstance(over, Grid | Points | Sample):
        refuse("over", "be a Grid, Points or a Sample", f"is {type(over).__name__}")
    if not isinstance(over, Sample):
        _check_names(problem, tuple(over.coords if isinstance(over, Grid) else over.columns))
    return Builder(problem, over, derivatives)


def check_problem(problem: Any) -> None:
    """Refuse what cannot be called."""
    if not callable(problem):
        refuse("problem", "be a function that gives (equation, omega0)", f"is {problem!r}")


def _varied(at: Any, point: dict[str, Array], derivatives: tuple[str, ...]) -> Any:
    """A point's equation with its variations along some arguments of the problem, and its start."""

    def made(values: tuple[Array, ...]) -> Any:
        equation, omega0 = at(point | dict(zip(derivatives, values, strict=True)))
        arrays, rest = eqx.partition(physical(equation), eqx.is_inexact_array)
        return (arrays, omega0), rest

    (arrays, omega0), push, rest = jax.linearize(
        made, tuple(point[name] for name in derivatives), has_aux=True
    )
    units = tuple(jnp.eye(len(derivatives)))
    parameters, starts = jax.vmap(push)(units)
    return Tangent(eqx.combine(arrays, rest), parameters, starts, length(omega0)), omega0


def _check_derivatives(points: Any, derivatives: tuple[str, ...]) -> None:
    numbers = (
        [name for name in points if points[name].ndim == 1] if isinstance(points, dict) else []
    )
    for name in derivatives:
        if name not in numbers:
            known = ", ".join(numbers) or "none here"
            refuse("derivatives", f"name arguments that are numbers ({known})", f"names `{name}`")


def _check_names(problem: Problem, names: tuple[str, ...]) -> None:
    try:
        signature = inspect.signature(problem)
    except ValueError:  # some callables have none to look at
        return
    try:
        signature.bind(**dict.fromkeys(names))
    except TypeError as error:
        refuse(
            "over",
            f"name the arguments of `problem` {signature}",
            f"has {', '.join(names)} ({error})",
        )


def block_digest(block: tuple[Any, Float[Array, "3 N"]]) -> bytes:
    """That of equations and starts, parameter by parameter."""
    return array_digest(*jax.tree.leaves(eqx.filter(block, eqx.is_array)))
