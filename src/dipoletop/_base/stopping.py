"""When a run ends: status codes and rules that every engine follows."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .linalg import largest
from .tolerances import Tolerances
from .types import Outcome, Real, State, Verdict

RUNNING, FINISHED, EXHAUSTED, BROKEN = 2, 1, 0, -1
"""Status of a run: still at work; finished (see `Until`); out of steps; not finite, a runaway, or
a step size below rounding."""

Until = Literal["outcome", "value", "slope", "time"]
"""When a run is finished. "outcome": as soon as its outcome is certain; "value": also ω∞, to the
tolerance; "slope": also the derivatives of ω∞; "time": at its end time t1 only."""
VALUE_MARGIN = 0.1  # of the tolerance: the allowed error of ω∞ by its local formula


def decided(
    equation: Any, y: State, tolerances: Tolerances, until: Until, prepared: Any = None
) -> Bool[Array, "*lanes"]:
    """Whether the verdict on a state finishes the run.

    `prepared` is that of `prepared_verdicts`, or None.
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
    return certain & (slopes_settled(verdict, tolerances.rtol) | (verdict.outcome == Outcome.STOP))


def prepared_verdicts(equation: Any) -> Any:
    """What an equation prepares for its verdicts (`OptionalMembers`), or None."""
    prepare = getattr(equation, "prepare", None)
    return None if prepare is None else prepare()


def verdict_on(equation: Any, y: State, prepared: Any = None) -> Verdict:
    """The verdict on a state, by what the equation has prepared for it, if anything."""
    given = (y,) if prepared is None else (y, prepared)
    return Verdict(*equation.verdict(*given))


def settled(verdict: Verdict, tolerances: Tolerances, margin: float) -> Bool[Array, "*lanes"]:
    """Whether the estimated error of ω∞ is within `margin` times the tolerance, or ω∞ is 0."""
    rtol, atol = tolerances
    size = jnp.abs(verdict.omega_inf)
    within = verdict.error * size <= margin * (rtol * size + atol)
    return within | (verdict.outcome != Outcome.RESIDUAL)


def slopes_settled(verdict: Verdict, rtol: Real) -> Bool[Array, "*lanes"]:
    """Whether the estimated error of the derivatives of ω∞, which is high, is within rtol."""
    return verdict.slope <= rtol


def sound(t: Real, y: State, rate: State) -> Bool[Array, "*lanes"]:
    """Whether a state can be integrated further: its rate is finite, and it is no runaway.

    A runaway is too large for the powers in the rates, or it is large and changes so fast that
    floating-point time does not resolve it.
    """
    size, speed = largest(jnp.abs(y)), largest(jnp.abs(rate))
    limit = float(jnp.finfo(y.dtype).max) ** 0.1
    unresolved = (size > 1) & (100 * jnp.finfo(y.dtype).eps * speed * t > size)
    return (size < limit) & (speed < jnp.inf) & ~unresolved
