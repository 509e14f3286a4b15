"""When a run ends: status codes and rules that every engine follows."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .linalg import largest
from .tolerances import Tolerances
from .types import Outcome, Real, State, Verdict

RUNNING, FINISHED, EXHAUSTED, BROKEN = 2, 1, 0, -1
"""Status of a run: still at work; finished by `Until`; out of steps; not finite, a runaway, or a
step size below rounding."""

Until = Literal["outcome", "value", "slope", "time"]
"""When a run is finished: its outcome is certain; also ω∞ to the tolerance; also the derivatives
of ω∞; or at time t1."""
VALUE_MARGIN = 0.1  # ω∞ is settled when its estimated error is this part of the tolerance


def decided(equation: Any, y: State, tolerances: Tolerances, until: Until) -> Bool[Array, "*lanes"]:
    """Whether a state ends a run; ω∞ need not be better than the integration is."""
    if until == "time":
        return jnp.zeros(y.shape[1:], bool)
    verdict = Verdict(*equation.verdict(y))
    certain = verdict.outcome != Outcome.UNDECIDED
    if until == "outcome":
        return certain
    certain = certain & settled(verdict, tolerances, VALUE_MARGIN)
    if until == "value":
        return certain
    return certain & (smooth(verdict, tolerances.rtol) | (verdict.outcome == Outcome.STOP))


def settled(verdict: Verdict, tolerances: Tolerances, margin: float) -> Bool[Array, "*lanes"]:
    """Whether the estimated error of ω∞ is within that part of the tolerance."""
    rtol, atol = tolerances
    size = jnp.abs(verdict.omega_inf)
    within = verdict.error * size <= margin * (rtol * size + atol)
    return within | (verdict.outcome != Outcome.RESIDUAL)


def smooth(verdict: Verdict, rtol: Real) -> Bool[Array, "*lanes"]:
    """Whether the derivatives of ω∞ are known to the tolerance, by an estimate that is high."""
    return verdict.slope <= rtol


def sound(t: Real, y: State, rate: State) -> Bool[Array, "*lanes"]:
    """Whether a state can be integrated further: a finite rate, and no runaway.

    A runaway is too large, or large and so fast that floating-point time does not resolve it.
    """
    size, speed = largest(jnp.abs(y)), largest(jnp.abs(rate))
    limit = float(jnp.finfo(y.dtype).max) ** 0.1  # leaves room for the powers in the rates
    blurred = (size > 1) & (100 * jnp.finfo(y.dtype).eps * speed * t > size)
    return (size < limit) & (speed < jnp.inf) & ~blurred
