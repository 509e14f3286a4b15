"""Rules for the end of a run, and status codes, common to all engines."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .linalg import largest
from .tolerances import Tolerances
from .types import Outcome, Real, State, Verdict

RUNNING, FINISHED, EXHAUSTED, BROKEN = 2, 1, 0, -1
"""Status of a run: running; finished (see `Until`); out of steps; broken, that is not finite, a
runaway, or with a step size below rounding."""

Until = Literal["outcome", "value", "slope", "time"]
"""The condition for the end of a run. "outcome": the outcome is certain; "value": also ω∞ is known
to the tolerance; "slope": also its derivatives; "time": the end time t1 is reached."""
VALUE_MARGIN = 0.1  # allowed error of ω∞ by its local formula, relative to the tolerance


def decided(
    equation: Any, y: State, tolerances: Tolerances, until: Until, prepared: Any = None
) -> Bool[Array, "*lanes"]:
    """Return whether the verdict on a state finishes the run.

    `prepared` is the result of `prepared_verdicts`, or None.
    """
    if until == "time":
        return jnp.zeros(y.shape[1:], bool)
    verdict = verdict_on(equation, y, prepared)
    certain = verdict.outcome != Outcome.UNDECIDED
    if until == "outcome":
        return certain
    certain = certain & settled(verdict, tolerances, VALUE_MARGIN)
    if until == "value":
        return certain
    return certain & ((verdict.slope <= tolerances.rtol) | (verdict.outcome == Outcome.STOP))


def prepared_verdicts(equation: Any) -> Any:
    """Return the result of an equation's `prepare` (`OptionalMembers`), or None."""
    prepare = getattr(equation, "prepare", None)
    return None if prepare is None else prepare()


def verdict_on(equation: Any, y: State, prepared: Any = None) -> Verdict:
    """Return the verdict on a state, using the equation's `prepared` arrays, if any."""
    given = (y,) if prepared is None else (y, prepared)
    return Verdict(*equation.verdict(*given))


def settled(verdict: Verdict, tolerances: Tolerances, margin: float) -> Bool[Array, "*lanes"]:
    """Return whether ω∞ = 0 or its estimated error is within `margin` times the tolerance."""
    rtol, atol = tolerances
    size = jnp.abs(verdict.omega_inf) if verdict.size is None else verdict.size
    within = verdict.error * size <= margin * (rtol * size + atol)
    return within | (verdict.outcome != Outcome.RESIDUAL)


def sound(t: Real, y: State, rate: State) -> Bool[Array, "*lanes"]:
    """Return whether a state can be integrated further: a finite rate, and not a runaway.

    A runaway is too large for the powers in the rates, or is large and changes faster than
    floating-point time resolves.
    """
    size, speed = largest(jnp.abs(y)), largest(jnp.abs(rate))
    limit = float(jnp.finfo(y.dtype).max) ** 0.1
    unresolved = (size > 1) & (100 * jnp.finfo(y.dtype).eps * speed * t > size)
    return (size < limit) & (speed < jnp.inf) & ~unresolved
