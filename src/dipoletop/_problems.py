"""A sweep's problem: from flat indices to the equations and starts of its points, vectorised."""

import hashlib
import inspect
import threading
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._checks import check_equation, refuse
from ._types import Equation
from .equations.tangent import Tangent
from .grids import Grid, Points, Sample
from .manifold import physical

Problem = Callable[..., tuple[Equation, Float[Array, "3"]]]
"""From the named values of one point to the equation and the start ω₀."""


def builder(
    problem: Problem, over: Grid | Points | Sample, derivatives: tuple[str, ...] = ()
) -> Callable[[np.ndarray], Any]:
    """From flat indices to (equation, ω₀), both with a trailing lane axis.

    With `derivatives` the equation is a `Tangent`, whose variations are along these arguments.
    """
    check_problem(problem)
    if not isinstance(over, Grid | Points | Sample):
        refuse("over", "be a Grid, Points or a Sample", f"is {type(over).__name__}")
    if not isinstance(over, Sample):
        _check_names(problem, tuple(over.coords if isinstance(over, Grid) else over.columns))
    one_at_a_time = threading.Lock()  # tracing a user's function from two threads is his risk

    def build(index: np.ndarray) -> tuple[Any, Float[Array, "3 N"]]:
        points = over.points(index)

        def at(point: Any) -> Any:
            made = problem(**point) if isinstance(point, dict) else problem(point)
            if not (isinstance(made, tuple) and len(made) == 2):
                refuse("problem", "return (equation, omega0)", f"returns {type(made).__name__}")
            if jnp.shape(made[1]) != (3,):
                shape = jnp.shape(made[1])
                refuse("problem", "return a start of shape (3,)", f"its start has shape {shape}")
            check_equation(made[0])
            return made

        def varied(point: Any) -> Any:
            return _varied(at, point, derivatives)

        if derivatives:
            _check_derivatives(points, derivatives)
        with one_at_a_time:
            return jax.vmap(varied if derivatives else at, out_axes=-1)(points)

    return build


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
    return Tangent(eqx.combine(arrays, rest), *jax.vmap(push)(units)), omega0


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


def fingerprint(build, size: int) -> str:
    """A hash of what the problem is at a few of its points, to recognise a foreign store."""
    probe = np.unique(np.linspace(0, size - 1, 17).astype(int))
    leaves, structure = jax.tree.flatten(build(probe))
    digest = hashlib.sha256(str(structure).encode())
    for leaf in leaves:
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()
