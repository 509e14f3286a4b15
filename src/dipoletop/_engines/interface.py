"""The interface of an engine, which integrates many runs of one equation to their end states."""

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
    """Tolerances and budget of runs, all traced, so that new values need no compilation.

    The error of a step is kept below atol + rtol·max(size(y), size(y_new)) in every component,
    with the size by `error_scale_of`.
    """

    rtol: Float[Array, ""]
    atol: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    t1: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    """End time; a run with t1 ≤ 0 takes no step."""
    max_steps: Int[Array, ""]
    """The number of steps that a run may take; of windows, where it follows a physical branch."""

    @property
    def tolerances(self) -> Tolerances:
        """The tolerances alone."""
        return Tolerances(self.rtol, self.atol)  # pyright: ignore[reportArgumentType]

    def loosened(self, factor: float) -> "Limits":
        """Return the same limits with larger tolerances."""
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
    """The steps of the wide and of the narrow block of lanes, if they were counted."""


class Paused(NamedTuple):
    """Where runs that are out of steps, or have taken none, go on; lanes on the trailing axis."""

    y: Float[np.ndarray, "n N"]
    f: Float[np.ndarray, "n N"]
    """The rate at (t, y)."""
    t: Float[np.ndarray, "N"]
    compensation: Float[np.ndarray, "N"]
    """The rounding error of t."""
    h: Float[np.ndarray, "N"]
    """Size of the next step."""
    steps: Int[np.ndarray, "N"] | Float[np.ndarray, "N"]
    status: Int[np.ndarray, "N"] | Float[np.ndarray, "N"]


class Queue(NamedTuple):
    """N runs from ω₀; the array fields of the equation carry a trailing axis of N lanes."""

    equation: DecidingEquation
    omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"]
    """Initial conditions; on a processor one with a subnormal component counts as NaN."""
    limits: Limits
    until: Until
    paused: Paused | None = None
    """Where the runs go on; None: they begin."""
    pauses: bool = False
    """Whether it is wanted where runs that are out of steps would go on."""


Finish = Callable[[DecidingEquation, Vector, EndStates, Tolerances], T]
"""A pure function from equation, ω₀, end states and tolerances to a pytree of arrays.

The lanes are on the trailing axis of everything."""


def power_of_two(least: int) -> int:
    """Return the smallest power of two ≥ `least` and ≥ 128, so that few sizes are compiled."""
    return max(128, 1 << (least - 1).bit_length())


class Unsupported(Exception):
    """The reason why an engine cannot run an equation."""


@runtime_checkable
class Engine(Protocol):
    """An integrator of many runs of one equation."""

    name: ClassVar[str]
    """The name in `basin.attrs["engine"]`."""
    has_own_threads: ClassVar[bool]
    """Whether `classify` divides one queue among `threads`; else its caller divides the runs."""
    compiles_for_size: ClassVar[bool]
    """Whether a new number of runs needs a compilation."""

    def end_states(
        self, equation: Equation, y0: Float[Array, "n N"], limits: Limits, *, until: Until = "value"
    ) -> EndStates:
        """Integrate from the states `y0`; the fields of the equation carry N lanes, too."""
        ...

    def classify(
        self, finish: Finish[T], queue: Queue, device: Device, threads: int = 1
    ) -> tuple[T, Paused | None]:
        """Lift the starts ω₀, integrate the runs, and apply `finish` to the end states.

        Args:
            finish: see `Finish`.
            queue: the runs; its arrays may be of JAX or NumPy, and on any device.
            device: where they are integrated.
            threads: how many threads share the queue, for an engine that has its own.

        Returns:
            The result of `finish`, and where the runs go on; None if that is not wanted, or if
            with this engine runs can only begin again.
        """
        ...


def on_device(queue: Queue, device: Device) -> Any:
    """Return the queue with its arrays on a device, for JAX."""
    if device.platform == "cpu" and np.any(lost := subnormal(queue.omegas)):
        queue = queue._replace(omegas=np.where(lost, np.nan, queue.omegas))
    queue = queue._replace(pauses=False)  # JAX would compile once more
    arrays, rest = eqx.partition(queue, lambda x: eqx.is_array(x) or isinstance(x, np.ndarray))
    return eqx.combine(jax.device_put(arrays, device), rest)


@eqx.filter_jit
def lifted(equation: Equation, omegas: Float[Array, "3 N"]) -> Float[Array, "n N"]:
    """Return the initial states at the given angular velocities."""
    return equation.lift(omegas)
