"""Classification: from the state that ended a run to its outcome, ω∞ and the error of ω∞."""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import TypeAliasType

from .._base.checks import concrete
from .._base.refusals import refuse
from .._base.stopping import BROKEN, Until, settled
from .._base.summaries import with_error
from .._base.tolerances import Tolerances
from .._base.types import (
    DecidingEquation,
    Equation,
    Outcome,
    Real,
    Regime,
    Stop,
    Verdict,
    fate_of,
    implied_probability,
)
from .._engines.interface import EndStates
from ..equations.tangent import Tangent

UNCHECKED = "unchecked"
Value = TypeAliasType("Value", bool | Literal["unchecked"])
"""Whether ω∞ is wanted: with an estimate of its error (True), without (UNCHECKED), or not."""


class Classification(eqx.Module):
    """How runs end.

    Every field is a number for a single run, and has the shape (N,) for N runs of
    `classify_many`. The computed basin boundary is itself uncertain by about `rtol`: a start closer
    to it can have either label, certified or not.

    Attributes:
        outcome: a member of `Outcome`: RESIDUAL, STOP, UNDECIDED (out of steps, or chance decides)
            or FAILED.
        omega_inf: residual angular velocity along the dipole, signed, in units of 1/τ₀; 0 for
            STOP. NaN if undecided or failed, if the run ended before ω∞ was known (out of steps,
            or with `value=False`), and if `omega_inf_error` exceeds it.
        omega_inf_error: estimated absolute error of `omega_inf`: 0 for STOP, and where ω₁ is
            constant; infinite where there is no estimate.
        time: τ at which the run ended, in units of τ₀; NaN where the outcome was predicted, since
            the slow flow has no such time.
        steps: integration steps tried, the rejected ones included.
        certified: whether the state that ended the run lies in a region that is proven to decide,
            for this level of the equation only.
        stop: a member of `Stop`: the way in which a top stops.
        slopes: the derivatives of ω∞ along the m variations of a `Tangent` equation, shape (m,),
            or (m, N) from `classify_many`; None for any other equation. (The axis of `jax.vmap` is
            in front, as for every field.) 0 where the top and all its neighbours stop. Infinite
            along a change that turns the dipole of a general body off its principal axis, or
            violates the condition under which ω₁ is conserved (δ = 0 or ω₃ = 0). NaN where ω∞ is
            not known or not differentiable.
        regime: a member of `Regime`, the law that gave outcome and ω∞: RESOLVED where the equation
            was integrated or its first state decided, else the regime of `predict`. A label that
            the first state decided may be certified even if ω∞ was predicted.
        probability: the probability of residual rotation: 1 for RESIDUAL and 0 for STOP; between
            them where chance decides, so that the outcome is UNDECIDED; NaN where it is not known.
    """

    outcome: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    omega_inf: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    omega_inf_error: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    time: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    steps: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    certified: Bool[Array, "*n"] | Bool[np.ndarray, "*n"]
    stop: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    slopes: Float[Array, "m *n"] | Float[np.ndarray, "m *n"] | None = None
    regime: Int[Array, "*n"] | Int[np.ndarray, "*n"] | None = None
    probability: Float[Array, "*n"] | Float[np.ndarray, "*n"] | None = None

    @property
    def fate(self) -> Int[Array, "*n"] | Int[np.ndarray, "*n"]:
        """Members of `Fate`: outcome, kind of stop, and the sense of ω∞ if that is known."""
        return fate_of(self.outcome, self.stop, self.omega_inf)

    def __repr__(self) -> str:
        """Return the numbers of a single run, or counts of many; if traced, the shapes."""
        leaves = jax.tree.leaves(self)
        known = all(isinstance(leaf, jax.Array | np.ndarray | np.generic) for leaf in leaves)
        if len(leaves) < 7 or not (known and concrete(self)):
            return eqx.tree_pformat(self)
        shown = _of_one(self) if np.ndim(self.outcome) == 0 else _of_many(self)
        return f"Classification({shown})"


def _of_one(run: Classification) -> str:
    outcome, stop = Outcome(int(run.outcome)), Stop(int(run.stop))
    shown = [outcome.name if stop == Stop.NONE else f"{outcome.name} {stop.name}"]
    if outcome == Outcome.RESIDUAL:
        omega_inf, error = float(run.omega_inf), float(run.omega_inf_error)
        known = math.isfinite(omega_inf)
        shown.append(f"omega_inf={with_error(omega_inf, error)}" if known else "omega_inf unknown")
    shown += [f"time={float(run.time):.6g}", f"steps={int(run.steps)}"]
    if outcome in (Outcome.RESIDUAL, Outcome.STOP):
        shown.append("certified" if run.certified else "not certified")
    if run.slopes is not None:
        shown.append(f"slopes={np.asarray(run.slopes).tolist()}")
    if run.regime is not None and run.regime != Regime.RESOLVED:
        shown.append(f"predicted: {Regime(int(run.regime)).name}")
        if outcome == Outcome.UNDECIDED:
            probability = float(np.asarray(run.probability))
            shown.append(f"residual with probability {probability:.4g}")
    return ", ".join(shown)


def _of_many(runs: Classification) -> str:
    outcomes = np.asarray(runs.outcome)
    shown = [f"{outcomes.size} runs"]
    for outcome in (Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED):
        if count := np.count_nonzero(outcomes == outcome):
            shown.append(f"{count} {outcome.name} ({count / outcomes.size:.2%})")
    shown.append(f"{np.count_nonzero(runs.certified)} certified")
    if runs.regime is not None and (count := np.count_nonzero(runs.regime)):
        shown.append(f"{count} predicted")
    shown.append(f"{np.sum(runs.steps)} steps")
    return ", ".join(shown)


def stopping_rule(equation: Equation, value: Value) -> Until:
    """Return the condition under which a run ends."""
    if not (isinstance(value, bool) or (isinstance(value, str) and value == UNCHECKED)):
        refuse("value", f"be True, False or {UNCHECKED!r}", f"is {value!r}")
    if not value:
        return "outcome"
    return "slope" if isinstance(equation, Tangent) else "value"


def classification_of(
    equation: DecidingEquation, ends: EndStates, tolerances: Tolerances
) -> Classification:
    """Return the classification of runs by the states that ended them.

    A state that is not a number decides nothing.

    Args:
        equation: the equation; for many runs its arrays have a trailing axis of lanes.
        ends: the end states of the runs.
        tolerances: the tolerances of the steps.
    """
    y = jnp.asarray(ends.y)
    verdict = Verdict(*equation.verdict(y))
    broken = ends.status == BROKEN
    decided = ~broken & (verdict.outcome != Outcome.UNDECIDED)
    without_outcome = jnp.where(broken, Outcome.FAILED, Outcome.UNDECIDED)
    known = decided & settled(verdict, tolerances, 1.0)
    slopes = None
    if isinstance(equation, Tangent):
        certain = known & (verdict.slope <= tolerances.rtol)  # an estimate, and conservative
        stops = verdict.outcome == Outcome.STOP
        certain &= ~(stops & equation.may_cross_boundary(y, tolerances.rtol))
        slopes = jnp.where(certain[None], equation.omega_inf_tangents(y), jnp.nan)
    outcome = jnp.where(decided, verdict.outcome, without_outcome).astype(int)
    return Classification(
        outcome,
        jnp.where(known, verdict.omega_inf, jnp.nan),
        jnp.where(known, _error_of_formula(equation, verdict), jnp.nan),
        ends.t,
        jnp.asarray(ends.steps, int),
        decided & verdict.certified_for(equation),
        jnp.where(decided, verdict.stop, Stop.NONE).astype(int),
        slopes,
        jnp.full_like(outcome, Regime.RESOLVED),
        implied_probability(outcome, jnp),
    )


def _error_of_formula(equation: Equation, verdict: Verdict) -> Real:
    """Return the error of the formula for ω∞ at the state that ended a run; 0 if ω₁ is constant."""
    size = jnp.where(verdict.outcome == Outcome.RESIDUAL, jnp.abs(verdict.omega_inf), 0.0)
    error = (verdict.error + 4 * jnp.finfo(size.dtype).eps) * size
    if not verdict.belongs_to(equation):
        return error
    # Where squares of ω underflow, ω₁ only seems to be constant.
    exact = (verdict.error == 0) & (size**2 >= jnp.finfo(size.dtype).tiny)
    return jnp.where(exact, 0.0, error)
