"""What an engine is: it integrates many runs of one equation and returns their end states."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.checks import subnormal
from .._base.parallel import Device
from .._base.stopping import Until
from .._base.tolerances import Tolerances
from .._base.types import DecidingEquation, Equation, Vector

T = TypeVar("T")


class Limits(NamedTuple):
    """Tolerances and budget of runs, all traced: a new value compiles nothing.

    The error of a step is kept below atol + rtol·max(size(y), size(y_new)) in every component,
    with the size of `error_scale_of`.
    """

    rtol: Float[Array, ""]
    atol: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    t1: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    """End time; a run with t1 ≤ 0 takes no step."""
    max_steps: Int[Array, ""]
    """Budget of steps of each run; of windows, where runs follow a physical branch."""

    @property
    def tolerances(self) -> Tolerances:
        """The tolerances alone."""
        return Tolerances(self.rtol, self.atol)  # pyright: ignore[reportArgumentType]

    def loosened(self, factor: float) -> "Limits":
        """The same limits with larger tolerances."""
        rtol, atol = (np.asarray(factor * np.asarray(x)) for x in (self.rtol, self.atol))
        return self._replace(rtol=rtol, atol=atol)


class EndStates(NamedTuple):
    """The states in which runs ended, one entry for each run on the trailing axis."""

    y: Float[Array, "n *N"] | Float[np.ndarray, "n *N"]
    t: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    steps: Int[Array, "*N"] | Int[np.ndarray, "*N"]
    """Steps tried, rejected ones included."""
    status: Int[Array, "*N"] | Int[np.ndarray, "*N"]
    """FINISHED, EXHAUSTED or BROKEN, see `stopping`."""
    block_steps: Int[Array, "2"] | Int[np.ndarray, "2"] | None = None
    """Steps that the wide and the narrow block of lanes made together, if they were counted."""


class Queue(NamedTuple):
    """N runs from ω₀; the array fields of the equation carry a trailing axis of N lanes."""

    equation: DecidingEquation
    omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"]
    """On processors a start with a subnormal component is taken for one that is not a number."""
    limits: Limits
    until: Until


Finish = Callable[[DecidingEquation, Vector, EndStates, Tolerances], T]
"""A pure function from equation, ω₀, end states and tolerances to a pytree of arrays.

The lanes are on the trailing axis of everything."""


def power_of_two(least: int) -> int:
    """The smallest power of two that is at least `least` and 128, so that few sizes compile."""
    return max(128, 1 << (least - 1).bit_length())


class Unsupported(Exception):
    """An engine cannot run this equation."""


@runtime_checkable
class Engine(Protocol):
    """Integrates many runs of one equation."""

    name: ClassVar[str]
    """As in `basin.attrs["engine"]`."""
    has_own_threads: ClassVar[bool]
    """Whether `classify` divides one queue among `threads`; else its caller divides the runs."""
    compiles_for_size: ClassVar[bool]
    """Whether a new number of runs is compiled for."""

    def end_states(
        self, equation: Equation, y0: Float[Array, "n N"], limits: Limits, *, until: Until = "value"
    ) -> EndStates:
        """Integrate from the states `y0`; the fields of the equation carry N lanes, too."""
        ...

    def classify(self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1) -> T:
        """Lift the starts ω₀, integrate the runs, and apply `finish` to the end states.

        Args:
            finish: see `Finish`.
            queue: the runs; its arrays may be of JAX or NumPy, and on any device.
            device: where they are integrated.
            threads: of an engine that has its own, how many share the queue.
        """
        ...


def on_device(queue: Queue, device: Device) -> Any:
    """The queue with its arrays on a device, for JAX."""
    if device.platform == "cpu" and np.any(lost := subnormal(queue.omegas)):
        queue = queue._replace(omegas=np.where(lost, np.nan, queue.omegas))
    arrays, rest = eqx.partition(queue, lambda x: eqx.is_array(x) or isinstance(x, np.ndarray))
    return eqx.combine(jax.device_put(arrays, device), rest)


@eqx.filter_jit
def lifted(equation: Equation, omegas: Float[Array, "3 N"]) -> Float[Array, "n N"]:
    """The states that start at these angular velocities."""
    return equation.lift(omegas)
