"""The settings of runs, which `classify`, `classify_many` and `sweep` share."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.checks import check_verdict
from .._base.parallel import Device
from .._base.tolerances import MAX_STEPS, absolute, budget, check_atol, tolerance
from .._engines.interface import Engine, Limits
from .._engines.select import select_engines
from .classification import Value, stopping_rule
from .label_doubt import exact_when_slow, finish_of
from .slow_runs import SlowFlow, check_slow_flow


class RunSettings(NamedTuple):
    """How runs are made: the arguments of `classify`, `classify_many` and `sweep`."""

    rtol: Any = 1e-8
    atol: Any = None
    """None, a number, or one number for each run."""
    max_steps: Any = MAX_STEPS
    value: Value = True
    engine: str = "auto"
    slow_flow: SlowFlow = "auto"
    devices: Sequence[Any] | None = None
    in_two_passes: bool = True
    """Whether runs whose outcome alone is wanted are made in two passes, if that pays."""

    def checked(self, equation: Any, size: int | None = None) -> "RunSettings":
        """Return the settings after checking them for runs of an equation.

        Settings that have been checked pass again, as in the workers of a cluster.

        Args:
            equation: the equation.
            size: the number of runs, if `atol` may be one number for each.
        """
        check_verdict(equation)
        check_slow_flow(self.slow_flow, equation)
        if self.atol is not None:
            check_atol(self.atol, () if size is None else (size,))
        rtol, most = tolerance("rtol", self.rtol, xp=np), budget("max_steps", self.max_steps)
        return self._replace(rtol=rtol, max_steps=most)

    def engines(
        self, equation: Any, devices: Sequence[Device], *, warn: bool = True
    ) -> Mapping[Device, Engine]:
        """Return the engine of each device."""
        rule = stopping_rule(equation, self.value), finish_of(self.value)
        return select_engines(self.engine, equation, devices, *rule, warn=warn)

    def limits(
        self,
        equation: Any,
        omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
        wanted: Bool[np.ndarray, "N"],
    ) -> Limits:
        """Return the limits of N runs; those that are not wanted take no step."""
        atol = absolute(self.atol, self.rtol, omegas, exact_when_slow(equation, self.value))
        t1 = np.where(wanted, np.inf, 0.0).astype(omegas.dtype, copy=False)
        most: Any = np.asarray(self.max_steps)
        return Limits(self.rtol, np.asarray(atol), t1, most)
