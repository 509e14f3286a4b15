"""numbalsoda: LSODA and DOP853 in machine code, one start after another, in one thread.

numba compiles the right-hand side and the loop over the starts; δ and the tolerance are run-time
arguments. Installing numbalsoda needs a Fortran compiler.
"""

from collections.abc import Callable
from typing import Any

import numba
import numbalsoda  # pyright: ignore[reportMissingImports]
import numpy as np
from jaxtyping import Float

from benchmarks.problems import mixed_basin

SOLVERS = {"DOP853": numbalsoda.dop853, "LSODA": numbalsoda.lsoda}
MAX_STEPS = 100_000  # of a run

_rate = numba.njit(mixed_basin.rate)


@numba.cfunc(numbalsoda.lsoda_sig)
def _field(t: Any, w: Any, change: Any, delta: Any) -> None:
    change[0], change[1], change[2] = _rate(delta[0], (w[0], w[1], w[2]))


def prepare(
    omegas: Float[np.ndarray, "n 3"],
    rtol: float,
    *,
    solver: str,
    delta: float,
    amplitude: float,
    time: float,
) -> Callable[[], Float[np.ndarray, "n 3"]]:
    """Return a task that returns the end states, NaN for failed runs."""
    follow, field = SOLVERS[solver], _field.address
    times, shape, atol = np.array([0.0, time]), np.array([delta]), rtol * amplitude

    @numba.njit
    def advance(omegas: Any) -> Any:
        ends = np.full_like(omegas, np.nan)
        for k in range(len(omegas)):
            states, success = follow(field, omegas[k], times, shape, rtol, atol, MAX_STEPS)
            if success:
                ends[k] = states[-1]
        return ends

    return lambda: advance(omegas)
