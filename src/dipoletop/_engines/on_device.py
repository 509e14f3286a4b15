"""Lift, integrate and finish runs on one device of JAX, for the engines that are written in JAX."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._base.parallel import Device
from .._base.tolerances import Tolerances
from .._base.types import Equation
from .interface import EndStates, Engine, Finish, Queue, T


def classify_on_device(engine: Engine, finish: Finish[T], queue: Queue, device: Device) -> T:
    """`Engine.classify` of an engine whose `end_states` is a program of JAX."""
    arrays, rest = eqx.partition(queue, lambda x: eqx.is_array(x) or isinstance(x, np.ndarray))
    equation, omegas, limits, until = eqx.combine(jax.device_put(arrays, device), rest)
    ends = engine.end_states(equation, lifted(equation, omegas), limits, until=until)
    return _finished(finish, equation, ends, limits.tolerances)


@eqx.filter_jit
def lifted(equation: Equation, omegas: Any) -> Float[Array, "n N"]:
    """The states that start at these angular velocities."""
    return equation.lift(omegas)


@eqx.filter_jit
def _finished(finish: Finish[T], equation: Any, ends: EndStates, tolerances: Tolerances) -> T:
    return finish(equation, ends, tolerances)
