"""What an engine is: many runs of one equation in, the states in which they end out."""

from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.parallel import Device
from .._base.stopping import Until
from .._base.tolerances import Tolerances
from .._base.types import Equation

T = TypeVar("T")


class Limits(eqx.Module):
    """Tolerances and budget of runs, all traced: a new value compiles nothing.

    The error of a step is kept below atol + rtol·max(size(y), size(y_new)) in every component,
    with the size of `sizes_of`.
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


class EndStates(eqx.Module):
    """The states in which runs ended, one entry for each run on the trailing axis."""

    y: Float[Array, "n *N"] | Float[np.ndarray, "n *N"]
    t: Float[Array, "*N"] | Float[np.ndarray, "*N"]
    steps: Int[Array, "*N"] | Int[np.ndarray, "*N"]
    """Steps tried, rejected ones included."""
    status: Int[Array, "*N"] | Int[np.ndarray, "*N"]
    """FINISHED, EXHAUSTED or BROKEN, see `stopping`."""
    block_steps: Int[Array, "2"] | Int[np.ndarray, "2"] | None = None
    """Steps that the wide and the narrow block of lanes made together, if they were counted."""


Finish = Callable[[Equation, EndStates, Tolerances], T]
"""A pure function from equation, end states and tolerances to a pytree of arrays, lanes behind."""


class Unsupported(Exception):
    """An engine cannot run this equation."""


@runtime_checkable
class Engine(Protocol):
    """Integrates a queue of runs of one equation.

    The array fields of an equation carry a trailing axis of N lanes, one for each run.
    """

    name: ClassVar[str]
    """As in `basin.attrs["engine"]`."""
    has_own_threads: ClassVar[bool]
    """Whether `classify` divides one queue among `threads`; else its caller divides the runs."""

    def end_states(
        self,
        equation: Any,
        y0: Float[Array, "n N"],
        limits: Limits,
        *,
        until: Until = "value",
    ) -> EndStates:
        """Integrate from the states `y0`, shape (n, N), in order."""
        ...

    def classify(
        self,
        finish: Finish[T],
        equation: Any,
        omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
        limits: Limits,
        *,
        until: Until,
        device: Device,
        threads: int = 1,
    ) -> T:
        """Lift the starts ω₀, integrate them, and apply `finish` to the end states.

        Args:
            finish: see `Finish`.
            equation: with a trailing axis of N lanes on its arrays, of JAX or NumPy.
            omegas: starts ω₀, shape (3, N).
            limits: tolerances, end times and budget.
            until: when a run is finished.
            device: where it runs; arrays that lie elsewhere, or in NumPy, are moved there.
            threads: of an engine that has its own, how many share the queue.
        """
        ...
