"""How exact ω∞ is: its condition, by the ends of neighbouring starts.

A run of n steps, each with an error of at most rtol·|ω|, misses ω∞ by no more than

    C(n)·rtol·(MIDWAY·|ω∞| + |ω₀|·|∂ω∞/∂ω₀|),      C(n) = FIXED + PER_STEP·n.

Both were measured (benchmarks/bench_residual.py). C is small, since Dopri8 estimates the error of
the lower one of its two orders; MIDWAY is there since a motion may be more sensitive on its way
than at its start. The gradient is that of differences: every start is run again with each
component of ω₀ moved, so no equation needs anything more for it. Near a zero of ω∞, which is the
border between rotations in opposite senses or of the basin, the gradient is large or infinite;
where ω∞ is not linear over the distance, not even at the second, smaller one, it is not known.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._types import Outcome

FIXED, PER_STEP, MIDWAY = 0.02, 3e-3, 5.0  # measured
COARSE = (1e3, 3.0)  # tolerances of the neighbours over rtol, one after the other
COARSEST = 1e-4  # the largest of them
LONG = 400  # steps from which neighbours are farther off, since their own errors are larger
TURNED = 0.01  # largest distance · steps: beyond, neighbours may be off by a whole turn
ALONE = 10.0, 30.0  # of a single start: tolerance of the neighbours over rtol; distance over that
LINEAR = 0.2  # of |ω∞|: the largest change that tells a gradient


def integration_error(value: Any, steps: Any, change: Any, scale: Any) -> Any:
    """The error of ω∞ by the formula above, with change = |ω₀|·|∂ω∞/∂ω₀|.

    An absolute tolerance is the worse the slower the top is in the end.
    """
    rtol, atol = scale
    size = abs(value)
    return (FIXED + PER_STEP * steps) * (rtol + atol / size) * (MIDWAY * size + change)


def checked(found: Any, run: Callable[..., Any], omegas: Any, limits: Any) -> Any:
    """Classifications with the integration's part of the error of ω∞; NaN for ω∞ if it exceeds it.

    Args:
        found: of the runs, in NumPy, with the rest of the error.
        run: from starts (3, N) and `Limits` to classifications.
        omegas: the starts, (3, N).
        limits: those of the runs.
    """
    ran = (found.outcome == Outcome.RESIDUAL) & (found.steps > 0)
    scale = float(limits.rtol), np.asarray(limits.atol)
    with np.errstate(all="ignore"):  # of runs that failed
        change = _change(found, run, np.asarray(omegas), limits, ran)
        error = integration_error(found.omega_inf, found.steps, change, scale)
    return known(found, np.where(ran, error, 0.0), np)


def _change(found: Any, run: Any, starts: np.ndarray, limits: Any, wanted: np.ndarray) -> Any:
    """|ω₀|·|∂ω∞/∂ω₀| of the wanted runs; infinite where it cannot be told."""
    value, size = found.omega_inf, np.linalg.norm(starts, axis=0)
    change = np.full(size.shape, np.inf, size.dtype)
    rtol = float(limits.rtol)
    for coarse in dict.fromkeys(max(1.0, min(c, COARSEST / rtol)) for c in COARSE):
        part = coarse * rtol * np.maximum(1.0, found.steps / LONG)
        tried = wanted & np.isinf(change) & np.isfinite(value) & (part * found.steps <= TURNED)
        if not tried.any():
            continue
        times = np.where(tried, np.inf, 0.0).astype(size.dtype)
        looser = replace(
            limits, rtol=coarse * limits.rtol, atol=coarse * np.asarray(limits.atol), t1=times
        )
        ends = [run(near, looser).omega_inf for near in _neighbours(starts, part * size)]
        moved = [np.asarray(end) - value for end in ends]
        linear = np.max(np.abs(moved), axis=0) <= LINEAR * np.abs(value)
        change = np.where(tried & linear, np.linalg.norm(moved, axis=0) / part, change)
    return change


def _neighbours(starts: np.ndarray, distance: np.ndarray) -> Iterator[np.ndarray]:
    """The starts with one component moved, for each of the three."""
    for axis in range(3):
        near = starts.copy()
        near[axis] += distance
        yield near


def checked_alone(run: Callable[..., Any], omega0: Float[Array, "3"], scale: Any) -> Any:
    """The same for one start, traced: run(ω₀, (rtol, atol), whether it is to be run)."""
    rtol, atol = scale
    coarse, far = ALONE
    distance = far * coarse * rtol * jnp.sqrt(jnp.sum(omega0**2))
    moves = jnp.concatenate([jnp.zeros((1, 3), omega0.dtype), distance * jnp.eye(3)])
    factors = jnp.where(jnp.arange(4) > 0, coarse, 1.0).astype(omega0.dtype)

    def one(wanted: Array, case: Any) -> Any:
        move, factor = case
        found = run(omega0 + move, (factor * rtol, factor * atol), wanted)
        moving = (found.outcome == Outcome.RESIDUAL) & (found.steps > 0)
        return wanted & moving, found

    _, every = jax.lax.scan(one, jnp.asarray(True), (moves, factors))
    found = jax.tree.map(lambda x: x[0], every)
    value = found.omega_inf
    moved = every.omega_inf[1:] - value
    linear = jnp.max(jnp.abs(moved)) <= LINEAR * jnp.abs(value)
    change = jnp.where(linear, jnp.sqrt(jnp.sum(moved**2)) / (far * coarse * rtol), jnp.inf)
    error = integration_error(value, found.steps.astype(value.dtype), change, scale)
    ran = (found.outcome == Outcome.RESIDUAL) & (found.steps > 0)
    return known(found, jnp.where(ran, error, 0.0), jnp)


def known(found: Any, more: Any, xp: Any) -> Any:
    """A classification with more error of ω∞; where that exceeds ω∞, it and its slopes are NaN."""
    error = found.omega_inf_error + more
    unknown = (found.outcome == Outcome.RESIDUAL) & ~(error < abs(found.omega_inf))
    value = xp.where(unknown, xp.nan, found.omega_inf)
    slopes = None if found.slopes is None else xp.where(unknown, xp.nan, found.slopes)
    return replace(found, omega_inf=value, omega_inf_error=error, slopes=slopes)


def is_known(found: Any, gradient: Any, start: Float[Array, "3"], scale: Any) -> Any:
    """Whether the error of ω∞ is less than its size, |∂ω∞/∂ω₀| being known from the variations."""
    value, steps = found.omega_inf, found.steps.astype(start.dtype)
    change = gradient * jnp.sqrt(jnp.sum(start**2))
    error = jnp.where(steps > 0, integration_error(value, steps, change, scale), 0.0)
    certain = error < jnp.abs(value)
    return jax.lax.stop_gradient(certain | (found.outcome != Outcome.RESIDUAL))
