"""The problem of a sweep over tops, and the start that its quantities mean."""

import functools
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from .._base.types import Equation
from ..equations.coordinates import cylindrical
from ..equations.levels import Level
from ..equations.transverse import equation_at
from .problems import Problem


def initial_condition(values: Mapping[str, ArrayLike]) -> Array:
    """Return ω₀, shape (3,), from the quantities by name."""
    if "amplitude" not in values:
        return cylindrical(values["w_perp"], values["w3"], values["phi"])
    amplitude, theta = values["amplitude"], values["theta"]
    return cylindrical(amplitude * jnp.sin(theta), amplitude * jnp.cos(theta), values["phi"])


@functools.cache  # the same function for every sweep of a level, so that it is traced once
def problem_of_top(level: Level) -> Problem:
    """Return the problem of a sweep at a level, over δ and the quantities of a start."""

    def problem(**point: Any) -> tuple[Equation, Array]:
        return equation_at(level, point["delta"]), initial_condition(point)

    return problem
