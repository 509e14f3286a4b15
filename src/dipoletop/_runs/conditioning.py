"""The error of ω∞ that the integration causes, estimated from neighbouring starts.

ω∞ is a function of the state that is constant along a motion. Step k of a run leaves an error eₖ in
the state, of at most rtol·s in each component, where s is the scale of the errors of ω
(`omega_scale_of`, |ω| or less). It moves the run to a neighbouring motion, whose ω∞
differs by ∇ω∞(τₖ)·eₖ. To first order the error of ω∞ after n steps is the sum of these:

    |Σₖ ∇ω∞(τₖ)·eₖ| ≤ n·rtol·max |s ∂ω∞/∂ω|,

with the gradient at any time of the run. Two values of |s ∂ω∞/∂ω| are available: |s ∂ω∞/∂ω₀| at
the start, and about |ω∞| at the end, where ω lies along the dipole. The estimate uses both,

    C(n)·rtol·(MIDWAY·|ω∞| + |s ∂ω∞/∂ω₀|),      C(n) = FIXED + PER_STEP·n.

C and MIDWAY were measured (benchmarks/accuracy/residual.py). C is far below n, since Dopri8
estimates the error of the lower of its two orders, and since errors of different steps partly
cancel; MIDWAY exceeds 1, since a motion can be more sensitive on its way than at both ends.

The gradient at the start comes from differences. Each start is run three more times, with component
i of ω₀ moved by h·sᵢ:

    |s ∂ω∞/∂ω₀|² ≈ Σᵢ [(ω∞(ω₀ + h·sᵢ·eᵢ) − ω∞(ω₀))/h]².

Unlike first variations, this works for any equation. The neighbours may be run at a looser
tolerance, if h is so large that their own errors do not matter. Near a zero of ω∞, at the boundary
of the basin or between rotations in opposite senses, the gradient is large or infinite. There ω∞
is not linear over the distance h; if it is not linear over the second, smaller h either, the error
is unknown (infinite).
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.tolerances import Tolerances
from .._base.types import OmegaScale, Outcome
from .._engines.interface import Limits, power_of_two
from .classification import Classification, Value
from .memory_limits import Lanes

FIXED, PER_STEP, MIDWAY = 0.04, 1.2e-2, 5.0  # measured
NEIGHBOUR_RTOLS = 1e3, 3.0  # rtol of the neighbours over the run's, at the first and second try
LARGEST_RTOL = 1e-4  # largest rtol of the neighbours
LONG_RUN = 400  # steps from which the distance grows like the errors of the neighbours
LARGEST_PHASE = 0.01  # distance · steps: beyond, neighbours may differ by a whole rotation
SINGLE_RTOL, SINGLE_DISTANCE = 10.0, 30.0  # for one start: rtol over the run's; distance over rtol
LINEAR = 0.2  # largest relative change of ω∞ that still gives a gradient

RunSome = Callable[[Lanes, Limits, Float[np.ndarray, "3 N"]], Classification]
"""A function of the indices of some runs, limits and all starts to their classifications."""


def with_error_estimates(
    runs: Classification,
    run: RunSome,
    omegas: Float[np.ndarray, "3 N"] | Float[Array, "3 N"],
    limits: Limits,
    scales: OmegaScale,
) -> Classification:
    """Add the error of the integration to classifications; ω∞ is NaN where the error exceeds it.

    Args:
        runs: in NumPy, with the error of the formula for ω∞ at their ends.
        run: classifies neighbours of the runs.
        omegas: the starts ω₀, shape (3, N).
        limits: the limits of the runs.
        scales: the function that gives the scales s of ω₀.
    """
    integrated = is_integrated(runs)
    if not integrated.any():
        return _with_added_error(runs, 0.0, np)
    starts = np.asarray(omegas)
    around = starts, _scaled(scales, starts)
    tolerances = float(limits.rtol), np.asarray(limits.atol)
    with np.errstate(all="ignore"):  # of runs that failed
        gradient = _gradient_by_neighbours(runs, run, around, limits, integrated)
        error = _integration_error(runs.omega_inf, runs.steps, gradient, tolerances)
    return _with_added_error(runs, np.where(integrated, error, 0.0), np)


def _scaled(scales: OmegaScale, omegas: Float[np.ndarray, "3 N"]) -> Float[np.ndarray, "3 N"]:
    """Return the scales s of N starts, by a program for a power of 2."""
    size = omegas.shape[1]
    padded = np.zeros((3, power_of_two(size)), omegas.dtype)
    padded[:, :size] = omegas
    return np.asarray(_jitted_scales(scales, padded))[:, :size]


@functools.partial(jax.jit, static_argnums=0)
def _jitted_scales(scales: OmegaScale, omegas: Array) -> Array:
    return scales(omegas)


def _gradient_by_neighbours(
    runs: Classification,
    run: RunSome,
    around: tuple[np.ndarray, np.ndarray],
    limits: Limits,
    wanted: Bool[np.ndarray, "N"],
) -> Float[np.ndarray, "N"]:
    """Return |s ∂ω∞/∂ω₀| of the wanted runs; infinite where it is unknown.

    `around` holds the starts and the scales s, both of shape (3, N).
    """
    omega_inf, (starts, sizes) = runs.omega_inf, around
    gradient = np.full(omega_inf.shape, np.inf, omega_inf.dtype)
    rtol = float(limits.rtol)
    for looser in dict.fromkeys(max(1.0, min(x, LARGEST_RTOL / rtol)) for x in NEIGHBOUR_RTOLS):
        distance = looser * rtol * np.maximum(1.0, runs.steps / LONG_RUN)
        tried = wanted & np.isinf(gradient) & np.isfinite(omega_inf)
        tried &= distance * runs.steps <= LARGEST_PHASE
        lanes = np.flatnonzero(tried)
        if not lanes.size:
            continue
        limits_here, middle, changes = limits.loosened(looser), omega_inf[lanes], []
        for axis in range(3):
            moved = starts.copy()
            moved[axis] += distance * sizes[axis]
            neighbours = run(lanes, limits_here, moved).omega_inf
            changes.append((neighbours - middle) / middle)
        linear = np.max(np.abs(changes), axis=0) <= LINEAR
        found = np.linalg.norm(changes, axis=0) / distance[lanes]
        gradient[lanes] = np.where(linear, found, np.inf)
    return gradient * np.abs(omega_inf)


def run_with_error_estimate(
    run: Callable[[Array, Tolerances, Bool[Array, ""]], Classification],
    start: Float[Array, "n"],
    sizes: Float[Array, "n"],
    tolerances: Tolerances,
) -> Classification:
    """Classify one start in a trace, with the error of the integration.

    Args:
        run: classifies a start at given tolerances; the last argument says whether to run it.
        start: ω₀, or a whole state.
        sizes: the scales of the errors of its components.
        tolerances: the tolerances of the run.
    """
    rtol, atol = tolerances
    looser = jnp.clip(LARGEST_RTOL / rtol, 1.0, SINGLE_RTOL)
    distance = SINGLE_DISTANCE * looser * rtol
    n = start.shape[0]
    # The run itself comes first, its neighbours follow in the same loop, which compiles once.
    moves = jnp.concatenate([jnp.zeros((1, n), start.dtype), distance * jnp.diag(sizes)])
    factors = jnp.where(jnp.arange(n + 1) > 0, looser, 1.0)

    def next_run(wanted: Bool[Array, ""], case: Any) -> Any:
        move, factor = case
        result = run(start + move, Tolerances(factor * rtol, factor * atol), wanted)
        return wanted & is_integrated(result), result

    _, runs = jax.lax.scan(next_run, jnp.asarray(True), (moves, factors))
    result = jax.tree.map(lambda x: x[0], runs)
    omega_inf = result.omega_inf
    changes = (runs.omega_inf[1:] - omega_inf) / jnp.where(omega_inf == 0, 1.0, omega_inf)
    linear = jnp.max(jnp.abs(changes)) <= LINEAR
    gradient = jnp.where(linear, jnp.sqrt(jnp.sum(changes**2)) / distance, jnp.inf)
    gradient = gradient * jnp.abs(omega_inf)
    steps = result.steps.astype(omega_inf.dtype)
    error = _integration_error(omega_inf, steps, gradient, tolerances)
    return _with_added_error(result, jnp.where(is_integrated(result), error, 0.0), jnp)


def without_error_estimates(runs: Classification, value: Value, xp: ModuleType) -> Classification:
    """Return classifications with an unknown error of ω∞, unless ω∞ was not integrated.

    Without `value` ω∞ is NaN unless it is constant. `xp` is NumPy or its counterpart in JAX.
    """
    if value:
        unknown, omega_inf = is_integrated(runs), runs.omega_inf
    else:
        unknown = (runs.outcome == Outcome.RESIDUAL) & (runs.omega_inf_error != 0)
        omega_inf = xp.where(unknown, xp.nan, runs.omega_inf)
    return replace(
        runs, omega_inf=omega_inf, omega_inf_error=xp.where(unknown, xp.inf, runs.omega_inf_error)
    )


def is_integrated(runs: Classification) -> Any:
    """Return whether ω∞ was integrated, which means not 0, not constant, not known at once."""
    rotates = (runs.outcome == Outcome.RESIDUAL) & (runs.steps > 0)
    return rotates & (runs.omega_inf_error != 0)


def is_larger_than_its_error(runs: Classification, gradient: Any, tolerances: Tolerances) -> Any:
    """Return whether ω∞ exceeds the error of the integration, for a gradient |s ∂ω∞/∂ω₀|."""
    omega_inf = runs.omega_inf
    steps = runs.steps.astype(omega_inf.dtype)
    error = _integration_error(omega_inf, steps, gradient, tolerances)
    certain = (error < jnp.abs(omega_inf)) | ~is_integrated(runs)
    return jax.lax.stop_gradient(certain)


def _integration_error(
    omega_inf: Any, steps: Any, gradient: Any, tolerances: tuple[Any, Any]
) -> Any:
    """Compute the error of ω∞ by the formula of this module, with gradient = |s ∂ω∞/∂ω₀|.

    The slower the top is in the end, the more an absolute tolerance counts.
    """
    rtol, atol = tolerances
    size = abs(omega_inf)
    return (FIXED + PER_STEP * steps) * (rtol + atol / size) * (MIDWAY * size + gradient)


def _with_added_error(runs: Classification, more: Any, xp: ModuleType) -> Classification:
    """Add to the error of classifications; where it exceeds ω∞, ω∞ and its slopes are NaN."""
    error = runs.omega_inf_error + more
    unknown = (runs.outcome == Outcome.RESIDUAL) & ~(error < abs(runs.omega_inf))
    omega_inf = xp.where(unknown, xp.nan, runs.omega_inf)
    slopes = None if runs.slopes is None else xp.where(unknown, xp.nan, runs.slopes)
    return replace(runs, omega_inf=omega_inf, omega_inf_error=error, slopes=slopes)
