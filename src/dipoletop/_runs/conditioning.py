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

A gradient grows exponentially in time at most, and so in the number of steps. Measured,

    |s ∂ω∞/∂ω₀| ≤ max(s) tr J tr J⁻¹/3 exp(n′/GROWTH),     n′ = n (rtol/1e-8)^⅛,

for tops and random bodies at order 1 and semi-reduced, rtol from 1e-4 to 1e-12. If the error is
small with this bound, as for about half of all runs, the bound takes the place of the gradient.

The gradient at the start comes from differences. Each start is run again with ω₀ moved by h·s along
some unit vectors eₖ of ω₀/s, for s a diagonal matrix:

    |s ∂ω∞/∂ω₀|² ≈ Σₖ [(ω∞(ω₀ + h·s eₖ) − ω∞(ω₀))/h]².

Since ω∞ is constant along a motion, ∂ω∞/∂ω₀·f = 0 with f the rate of ω at the start. So two vectors
across s⁻¹f are enough if f depends on ω only; else there are three. Unlike first variations, this
works for any equation. The neighbours may be run at a looser tolerance, if h is larger than that.
They may not differ by a whole rotation, so h falls with the number of steps. Near a zero of ω∞, at
the boundary of the basin or between rotations in opposite senses, the gradient is large or
infinite. There ω∞ is not linear over the distance h; if it is not linear over the smallest h
either, the error is unknown (infinite).
"""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.checks import or_nan
from .._base.guards import safe_divisor
from .._base.linalg import inverse, largest, length, scale, trace
from .._base.tolerances import Tolerances
from .._base.types import Equation, Outcome, Regime, Vector
from .._engines.interface import Limits
from ..equations._common import has_body_field, omega_scale_of
from ..equations.longitudinal import LongitudinalReduced, LongitudinalSemi
from ..equations.rigid import Reduced, SemiReduced
from ..equations.transverse import TransverseReduced, TransverseSemi
from .classification import Classification, Value
from .memory_limits import Lanes

FIXED, PER_STEP, MIDWAY = 0.04, 1.6e-2, 5.0  # measured
GROWTH, ENOUGH = 8.0, 20.0  # measured; relative error over rtol with which the bound is good enough
NEIGHBOUR_RTOLS = 1e4, 1e3, 1e2, 1e1  # rtol of the neighbours over the run's, in successive tries
LARGEST_RTOL = 1e-4  # largest rtol of the neighbours
DISTANCE = 2.0  # h over the rtol of the neighbours
LARGEST_PHASE = 0.1  # h · steps: beyond, neighbours may differ by a whole rotation
SINGLE_RTOL, SINGLE_DISTANCE = 10.0, 30.0  # for one start: rtol over the run's; distance over rtol
LINEAR = 0.2  # largest relative change of ω∞ that still gives a gradient

RunSome = Callable[[Lanes, Limits, Float[np.ndarray, "k 3 some"]], Classification]
"""A function of the indices of some runs, limits, and k starts in place of each, to the
classifications of the runs from these, shape (k, some)."""
AUTONOMOUS = (
    TransverseReduced,
    TransverseSemi,
    LongitudinalReduced,
    LongitudinalSemi,
    Reduced,
    SemiReduced,
)
"""Equations whose rate depends on ω only, which is the whole state."""


class Vicinity(NamedTuple):
    """What the gradient at a start needs beside ω₀."""

    directions: Float[Array, "k 3 *n"] | Float[np.ndarray, "k 3 *n"]
    """The vectors s eₖ to the neighbours, in units of h; NaN at rest."""
    reach: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    """max(s) tr J tr J⁻¹/3, by which the gradient is bounded; infinite if there is no bound."""


def vicinity(equation: Any, omegas: Vector) -> Vicinity:
    """Return the vicinity of starts."""
    scales = omega_scale_of(equation)(omegas)
    if type(equation) not in AUTONOMOUS:
        zero = jnp.zeros_like(scales[0])
        axes = [jnp.stack([scales[k] if i == k else zero for i in range(3)]) for k in range(3)]
        return Vicinity(jnp.stack(axes), zero + jnp.inf)
    if has_body_field(equation):
        inertia = equation.body.inertia
        spread = trace(inertia) * trace(inverse(inertia)) / 3
    else:  # moments 1, 1 and 1 − δ
        last = 1 - equation.delta
        spread = (2 + last) * (2 + 1 / last) / 3
    return Vicinity(_across_flow(equation, omegas, scales), largest(scales) * spread)


def _across_flow(equation: Equation, omegas: Vector, scales: Vector) -> Float[Array, "2 3 *lanes"]:
    """Return s e₁ and s e₂, for two unit vectors across s⁻¹f."""
    rate = equation(jnp.zeros_like(omegas[0]), omegas, None) / safe_divisor(scales)
    rate = rate / safe_divisor(largest(jnp.abs(rate)))[None]
    moves = largest(jnp.abs(rate)) > 0
    a, b, c = scale(1 / safe_divisor(length(rate)), rate)
    # Two unit vectors across (a, b, c): Duff et al., J. Comput. Graph. Tech. 6 (2017) 1.
    sign = jnp.where(c < 0, -1.0, 1.0).astype(c.dtype)
    part = -1 / (sign + c)
    both = a * b * part
    first = jnp.stack([1 + sign * a**2 * part, sign * both, -sign * a])
    second = jnp.stack([both, sign + b**2 * part, -b])
    return or_nan(jnp.stack([scales * first, scales * second]), moves[None, None])


def with_error_estimates(
    runs: Classification,
    run: RunSome,
    around: tuple[Any, Vicinity],
    limits: Limits,
) -> Classification:
    """Add the error of the integration to classifications; ω∞ is NaN where the error exceeds it.

    Args:
        runs: in NumPy, with the error of the formula for ω∞ at their ends.
        run: classifies neighbours of the runs.
        around: the starts ω₀, shape (3, N), and their vicinity.
        limits: the limits of the runs.
    """
    integrated = is_integrated(runs)
    if not integrated.any():
        return _with_added_error(runs, 0.0, np)
    tolerances = float(limits.rtol), np.asarray(limits.atol)
    with np.errstate(all="ignore"):  # of runs that failed
        bound = around[1].reach * np.exp(runs.steps * (tolerances[0] / 1e-8) ** 0.125 / GROWTH)
        error = _integration_error(runs.omega_inf, runs.steps, bound, tolerances)
        unclear = integrated & ~(error <= ENOUGH * tolerances[0] * np.abs(runs.omega_inf))
        if unclear.any():
            gradient = _gradient_by_neighbours(runs, run, around, limits, unclear)
            found = _integration_error(runs.omega_inf, runs.steps, gradient, tolerances)
            error = np.where(unclear, found, error)
    return _with_added_error(runs, np.where(integrated, error, 0.0), np)


def _gradient_by_neighbours(
    runs: Classification,
    run: RunSome,
    around: tuple[Any, Vicinity],
    limits: Limits,
    wanted: Bool[np.ndarray, "N"],
) -> Float[np.ndarray, "N"]:
    """Return |s ∂ω∞/∂ω₀| of the wanted runs; infinite where it is unknown."""
    omega_inf, (starts, (directions, _)) = runs.omega_inf, around
    gradient = np.full(omega_inf.shape, np.inf, omega_inf.dtype)
    rtol = float(limits.rtol)
    for looser in dict.fromkeys(max(1.0, min(x, LARGEST_RTOL / rtol)) for x in NEIGHBOUR_RTOLS):
        distance = DISTANCE * looser * rtol
        tried = wanted & np.isinf(gradient) & np.isfinite(omega_inf)
        tried &= distance * runs.steps <= LARGEST_PHASE
        lanes = np.flatnonzero(tried)
        if not lanes.size:
            continue
        # The longest runs first, so that none of them is left alone at the end.
        lanes = lanes[np.argsort(-runs.steps[lanes], kind="stable")]
        # By `take`, whose arrays are contiguous along the lanes.
        moved = np.take(np.asarray(starts), lanes, -1) + distance * np.take(directions, lanes, -1)
        found = run(lanes, limits.loosened(looser), moved).omega_inf
        changes = found / omega_inf[lanes] - 1
        linear = np.max(np.abs(changes), axis=0) <= LINEAR
        gradient[lanes] = np.where(linear, np.linalg.norm(changes, axis=0) / distance, np.inf)
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
    """Return whether ω∞ was integrated: not 0, constant, known at once, or predicted."""
    rotates = (runs.outcome == Outcome.RESIDUAL) & (runs.steps > 0)
    return rotates & (runs.omega_inf_error != 0) & (runs.regime == Regime.RESOLVED)


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
