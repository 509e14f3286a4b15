"""The part of the error of ω∞ that the integration makes, estimated from neighbouring starts.

ω∞ is a function of the state that is constant along a motion. Step k of a run leaves an error eₖ in
the state, of at most rtol·s in each component, where s is the size by which errors of ω are
measured (`omega_scale_of`, |ω| or less). It moves the run to a neighbouring motion, whose ω∞
differs by ∇ω∞(τₖ)·eₖ. To first order the error of ω∞ after n steps is the sum of these:

    |Σₖ ∇ω∞(τₖ)·eₖ| ≤ n·rtol·max |s ∂ω∞/∂ω|,

with the gradient at any time of the run. Two values of |s ∂ω∞/∂ω| are at hand: |s ∂ω∞/∂ω₀| at the
start, and about |ω∞| at the end, where ω lies along the dipole. The estimate takes both,

    C(n)·rtol·(MIDWAY·|ω∞| + |s ∂ω∞/∂ω₀|),      C(n) = FIXED + PER_STEP·n.

C and MIDWAY were measured (benchmarks/accuracy/residual.py). C is far below n, since Dopri8
estimates the error of the lower of its two orders, and since errors of different steps partly
cancel; MIDWAY exceeds 1, since a motion can be more sensitive on its way than at both ends.

The gradient at the start is that of differences. Each start is run three more times, with
component i of ω₀ moved by h·sᵢ:

    |s ∂ω∞/∂ω₀|² ≈ Σᵢ [(ω∞(ω₀ + h·sᵢ·eᵢ) − ω∞(ω₀))/h]².

No equation needs anything more for this, unlike first variations. The neighbours may be run at a
looser tolerance, if the difference h is so much larger that their own errors do not matter. Near a
zero of ω∞, which is the border between rotations in opposite senses or that of the basin, the
gradient is large or infinite. There ω∞ is not linear over the distance h; if it is not over the
second, smaller h either, the error is unknown (infinite).
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
from .chosen_lanes import Lanes
from .classification import Classification, Value

FIXED, PER_STEP, MIDWAY = 0.04, 1.2e-2, 5.0  # measured
NEIGHBOUR_RTOLS = 1e3, 3.0  # of the neighbours over rtol, at the first and the second try
LARGEST_RTOL = 1e-4  # of the neighbours
LONG_RUN = 400  # steps from which the distance grows, as do the errors of the neighbours
LARGEST_PHASE = 0.01  # of distance · steps: beyond, neighbours may be off by a whole rotation
SINGLE_RTOL, SINGLE_DISTANCE = 10.0, 30.0  # of one start: rtol over the run's; distance over rtol
LINEAR = 0.2  # largest change of ω∞, relative to it, that still gives a gradient

RunSome = Callable[[Lanes, Limits, Float[np.ndarray, "3 N"]], Classification]
"""From the numbers of some runs, limits and the starts of all to the classifications of these."""


def with_error_estimates(
    runs: Classification,
    run: RunSome,
    omegas: Float[np.ndarray, "3 N"] | Float[Array, "3 N"],
    limits: Limits,
    scales: OmegaScale,
) -> Classification:
    """Classifications with the error of the integration; ω∞ is NaN where that exceeds it.

    Args:
        runs: in NumPy, with the error of the formula for ω∞ at their ends.
        run: classifies neighbours of the runs.
        omegas: the starts ω₀, shape (3, N).
        limits: those of the runs.
        scales: gives the sizes s of ω₀.
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
    """The sizes s of N starts, by a program for a power of 2."""
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
    """|s ∂ω∞/∂ω₀| of the wanted runs; infinite where it is unknown.

    `around` are the starts and the sizes s, both of shape (3, N).
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
    """One classification with the error of the integration, as `with_error_estimates`; traced.

    Args:
        run: classifies a start by tolerances; the last argument says whether it is to be run.
        start: ω₀, or a whole state.
        sizes: what errors of its components are measured by.
        tolerances: those of the run.
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
    """Classifications whose ω∞ has an unknown error, unless no integration has part in it.

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
    """Whether ω∞ has the error of an integration: it is not 0, constant, or known at once."""
    rotates = (runs.outcome == Outcome.RESIDUAL) & (runs.steps > 0)
    return rotates & (runs.omega_inf_error != 0)


def is_larger_than_its_error(runs: Classification, gradient: Any, tolerances: Tolerances) -> Any:
    """Whether ω∞ exceeds the error of the integration, by a known gradient |s ∂ω∞/∂ω₀|."""
    omega_inf = runs.omega_inf
    steps = runs.steps.astype(omega_inf.dtype)
    error = _integration_error(omega_inf, steps, gradient, tolerances)
    certain = (error < jnp.abs(omega_inf)) | ~is_integrated(runs)
    return jax.lax.stop_gradient(certain)


def _integration_error(
    omega_inf: Any, steps: Any, gradient: Any, tolerances: tuple[Any, Any]
) -> Any:
    """The error of ω∞ by the formula of this module, with gradient = |s ∂ω∞/∂ω₀|.

    An absolute tolerance weighs the more, the slower the top is in the end.
    """
    rtol, atol = tolerances
    size = abs(omega_inf)
    return (FIXED + PER_STEP * steps) * (rtol + atol / size) * (MIDWAY * size + gradient)


def _with_added_error(runs: Classification, more: Any, xp: ModuleType) -> Classification:
    """Classifications with more error; where it exceeds ω∞, that and its slopes are NaN."""
    error = runs.omega_inf_error + more
    unknown = (runs.outcome == Outcome.RESIDUAL) & ~(error < abs(runs.omega_inf))
    omega_inf = xp.where(unknown, xp.nan, runs.omega_inf)
    slopes = None if runs.slopes is None else xp.where(unknown, xp.nan, runs.slopes)
    return replace(runs, omega_inf=omega_inf, omega_inf_error=error, slopes=slopes)
