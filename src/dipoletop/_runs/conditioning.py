"""How exact ω∞ is: its condition, by the ends of neighbouring starts.

A run of n steps, each with an error of at most rtol·|ω|, misses ω∞ by no more than

    C(n)·rtol·(MIDWAY·|ω∞| + |s ∂ω∞/∂ω₀|),      C(n) = FIXED + PER_STEP·n,

s being what errors of the components of ω₀ are measured by (`scales_of`), |ω₀| or less.

Both were measured (benchmarks/accuracy/residual.py). C is small, since Dopri8 estimates the error
of the lower one of its two orders; MIDWAY is there since a motion may be more sensitive on its way
than at its start. The gradient is that of differences: every start is run again with each
component of ω₀ moved, so no equation needs anything more for it. Near a zero of ω∞, which is the
border between rotations in opposite senses or of the basin, the gradient is large or infinite;
where ω∞ is not linear over the distance, not even at the second, smaller one, it is not known.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.types import Outcome, Real, Verdict
from ..equations._common import Scales

Run = Callable[[Any, Any], Any]
"""From starts (3, N) and `Limits` to classifications."""

FIXED, PER_STEP, MIDWAY = 0.04, 1.2e-2, 5.0  # measured
COARSE = (1e3, 3.0)  # tolerances of the neighbours over rtol, one after the other
COARSEST = 1e-4  # the largest of them
LONG = 400  # steps from which neighbours are farther off, since their own errors are larger
TURNED = 0.01  # largest distance · steps: beyond, neighbours may be off by a whole turn
ALONE = 10.0, 30.0  # of a single start: tolerance of the neighbours over rtol; distance over that
LINEAR = 0.2  # of |ω∞|: the largest change that tells a gradient


def series_error(equation: Any, verdict: Verdict) -> Real:
    """The error of ω∞ as the formula at the end of a run has it; 0 if ω∞ is constant and exact."""
    size = jnp.where(verdict.outcome == Outcome.RESIDUAL, jnp.abs(verdict.omega_inf), 0.0)
    error = (verdict.error + 4 * jnp.finfo(size.dtype).eps) * size
    if not verdict.belongs_to(equation):
        return error
    # Where ω₃ underflows ω₁ seems to be constant, and is not.
    exact = (verdict.error == 0) & (size**2 >= jnp.finfo(size.dtype).tiny)
    return jnp.where(exact, 0.0, error)


def integration_error(value: Any, steps: Any, change: Any, scale: Any) -> Any:
    """The error of ω∞ by the formula above, with change = |s ∂ω∞/∂ω₀|.

    An absolute tolerance is the worse the slower the top is in the end.
    """
    rtol, atol = scale
    size = abs(value)
    return (FIXED + PER_STEP * steps) * (rtol + atol / size) * (MIDWAY * size + change)


def checked(found: Any, run: Run, omegas: Any, limits: Any, scales: Scales) -> Any:
    """Classifications with the integration's part of the error of ω∞; NaN for ω∞ if it exceeds it.

    Args:
        found: of the runs, in NumPy, with the rest of the error.
        run: what made them.
        omegas: the starts, (3, N).
        limits: those of the runs.
        scales: how the equation measures ω.
    """
    ran = integrated(found)
    if not ran.any():
        return known(found, 0.0, np)
    starts = np.asarray(omegas)
    moves = np.eye(3)[:, :, None] * np.asarray(_scaled(scales, starts))
    scale = float(limits.rtol), np.asarray(limits.atol)
    with np.errstate(all="ignore"):  # of runs that failed
        change = _change(found, run, (starts, moves), limits, ran)
        error = integration_error(found.omega_inf, found.steps, change, scale)
    return known(found, np.where(ran, error, 0.0), np)


@functools.partial(jax.jit, static_argnums=0)
def _scaled(scales: Scales, starts: Array) -> Array:
    return scales(starts)


def _change(found: Any, run: Run, around: Any, limits: Any, wanted: np.ndarray) -> np.ndarray:
    """|s ∂ω∞/∂ω₀| of the wanted runs; infinite where it cannot be told.

    `around` are the starts, shape (3, N), and the three directions of their neighbours.
    """
    value, (starts, moves) = found.omega_inf, around
    change, rtol = np.full(value.shape, np.inf, value.dtype), float(limits.rtol)
    for coarse in dict.fromkeys(max(1.0, min(c, COARSEST / rtol)) for c in COARSE):
        part = coarse * rtol * np.maximum(1.0, found.steps / LONG)
        tried = wanted & np.isinf(change) & np.isfinite(value) & (part * found.steps <= TURNED)
        if not tried.any():
            continue
        looser = replace(
            limits,
            rtol=coarse * limits.rtol,
            atol=coarse * np.asarray(limits.atol),
            t1=np.where(tried, np.inf, 0.0).astype(value.dtype),
        )
        ends = [np.asarray(run(starts + part * move, looser).omega_inf) for move in moves]
        moved = [(end - value) / value for end in ends]
        linear = np.max(np.abs(moved), axis=0) <= LINEAR
        change = np.where(tried & linear, np.linalg.norm(moved, axis=0) / part, change)
    return change * np.abs(value)


def checked_alone(
    run: Callable[..., Any], start: Float[Array, "n"], sizes: Float[Array, "n"], scale: Any
) -> Any:
    """The same for one start, traced: run(start, (rtol, atol), whether it is to be run).

    `sizes` is what errors of its components are measured by.
    """
    rtol, atol = scale
    most, far = ALONE
    coarse = jnp.clip(COARSEST / rtol, 1.0, most)
    part = far * coarse * rtol
    n = start.shape[0]
    moves = jnp.concatenate([jnp.zeros((1, n), start.dtype), part * jnp.diag(sizes)])
    factors = jnp.where(jnp.arange(n + 1) > 0, coarse, 1.0)

    def one(wanted: Array, case: Any) -> Any:
        move, factor = case
        found = run(start + move, (factor * rtol, factor * atol), wanted)
        return wanted & integrated(found), found

    _, every = jax.lax.scan(one, jnp.asarray(True), (moves, factors))
    found = jax.tree.map(lambda x: x[0], every)
    value = found.omega_inf
    moved = (every.omega_inf[1:] - value) / jnp.where(value == 0, 1.0, value)
    linear = jnp.max(jnp.abs(moved)) <= LINEAR
    change = jnp.where(linear, jnp.sqrt(jnp.sum(moved**2)) / part, jnp.inf) * jnp.abs(value)
    error = integration_error(value, found.steps.astype(value.dtype), change, scale)
    return known(found, jnp.where(integrated(found), error, 0.0), jnp)


def unchecked(found: Any, value: Any, xp: Any) -> Any:
    """Without steps ω∞ is as exact as the formula that gives it; else there is no estimate."""
    without = integrated(found)
    omega_inf = found.omega_inf
    if not value:
        omega_inf = xp.where(without, xp.nan, omega_inf)
    error = xp.where(without, xp.inf, found.omega_inf_error)
    return replace(found, omega_inf=omega_inf, omega_inf_error=error)


def integrated(found: Any) -> Any:
    """Whether ω∞ has the error of an integration: not if it is constant, known at once, or 0."""
    some = (found.outcome == Outcome.RESIDUAL) & (found.steps > 0)
    return some & (found.omega_inf_error != 0)


def known(found: Any, more: Any, xp: Any) -> Any:
    """A classification with more error of ω∞; where that exceeds ω∞, it and its slopes are NaN."""
    error = found.omega_inf_error + more
    unknown = (found.outcome == Outcome.RESIDUAL) & ~(error < abs(found.omega_inf))
    value = xp.where(unknown, xp.nan, found.omega_inf)
    slopes = None if found.slopes is None else xp.where(unknown, xp.nan, found.slopes)
    return replace(found, omega_inf=value, omega_inf_error=error, slopes=slopes)


def is_known(found: Any, change: Any, scale: Any) -> Any:
    """Whether the error of ω∞ is less than its size, change = |s ∂ω∞/∂ω₀| being known."""
    value = found.omega_inf
    error = integration_error(value, found.steps.astype(value.dtype), change, scale)
    certain = (error < jnp.abs(value)) | ~integrated(found)
    return jax.lax.stop_gradient(certain)
