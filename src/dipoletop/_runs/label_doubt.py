"""The doubt of a label, which shows the loose runs that must be repeated, and slow labels.

A motion near the boundary between outcomes comes near to a motion on it, which loses all its
angular velocity. At small amplitude ω⊥² falls there as fast as the distance from the boundary
grows: at the saddle of `planar` the two rates are equal, at order 1 and at the consistent levels.
So (|ω|/|ω₀|)² at the end of a run measures how near it has been. The error is a phase that grows
with the number of turns, since the error of its rate is about constant. So the doubt of a label is

    rtol · n² / (|ω|/|ω₀|)²,      n the number of steps,

or infinite where a small displacement of the last state changes the verdict: at order 1 the region
of residual rotation reaches up to the basin boundary, so that an error may carry a state into it.
`benchmarks/accuracy/label_precision.py` searches for labels that are wrong nevertheless, at every
level and for bodies of every kind, among random starts and among starts close to the boundary.

Where all slow motions have the same outcome, an absolute tolerance saves many steps. Elsewhere a
slow motion may still be near the boundary, and an error that is larger than the motion could change
the outcome.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import concrete
from .._base.guards import safe_divisor
from .._base.linalg import length, scale
from .._base.tolerances import Tolerances
from .._base.types import DecidingEquation, Flag, Outcome, Real, Vector, Verdict
from .._engines.interface import EndStates, Finish, Paused
from ..equations._common import has_body_field
from ..equations._families import LONGITUDINAL, TRANSVERSE
from ..equations._verdicts.transverse import has_boundary, has_boundary_at_rest
from ..equations.levels import Level
from ..equations.rigid import Reduced, SemiReduced
from ..equations.transverse import TransverseReduced, TransverseSemi
from .classification import Classification, Value, classification_of
from .conditioning import Vicinity, vicinity, without_error_estimates

CERTAIN = 4.0  # doubt below which a label is certain: no wrong label had a doubt below 8
FADED = 1e-6  # (|ω|/|ω₀|)² below which a label is in doubt although no boundary exists
SHAKY = 20.0  # displacement of the last state that must not change the outcome, in tolerances


class Ended(NamedTuple):
    """The results of runs that have ended."""

    runs: Classification
    omega: Float[Array, "3 *n"] | Float[np.ndarray, "3 *n"]
    """The angular velocities at which they ended."""
    doubt: Float[Array, "*n"] | Float[np.ndarray, "*n"] | None = None
    """Doubt of each label (module docstring); only for `value=False`; inf without a label."""
    around: Vicinity | None = None
    """The vicinity of the starts; only if ω∞ is wanted."""
    paused: Paused | None = None
    """Where runs that are out of steps go on, if that was wanted and the engine can pause."""


def finish_of(value: Value) -> Finish[Ended]:
    """Return the function that an engine applies to the end states of its runs."""
    return ended_with_label if value is False else ended_with_value


def ended_with_value(
    equation: DecidingEquation, omegas: Vector, ends: EndStates, tolerances: Tolerances
) -> Ended:
    """Return the classification with ω∞, and the vicinity of the starts."""
    runs, last = classification_of(equation, ends, tolerances), equation.omega(jnp.asarray(ends.y))
    return Ended(runs, last, around=vicinity(equation, omegas))


def ended_with_label(
    equation: DecidingEquation, omegas: Vector, ends: EndStates, tolerances: Tolerances
) -> Ended:
    """Return the classification, with ω∞ only if it is constant, and the doubt of the label."""
    runs = classification_of(equation, ends, tolerances)
    labels = without_error_estimates(runs, False, jnp)
    omega = equation.omega(jnp.asarray(ends.y))
    if not made_twice(equation):
        return Ended(labels, omega)
    square, first = (w[0] ** 2 + w[1] ** 2 + w[2] ** 2 for w in (omega, omegas))
    bounded = _is_bounded(equation)
    steps = runs.steps.astype(square.dtype)
    doubt = jnp.where(bounded, tolerances.rtol * steps**2, FADED) * first / square
    error = tolerances.rtol + tolerances.atol / safe_divisor(jnp.sqrt(square))
    unknown = runs.outcome <= Outcome.UNDECIDED
    unknown |= bounded & _is_shaky(equation, omega, error, runs)
    return Ended(labels, omega, jnp.where(unknown, jnp.inf, doubt))


def _is_shaky(equation: Any, omega: Vector, error: Real, runs: Classification) -> Flag:
    """Return whether a state with a smaller component along the dipole is no longer residual."""
    axis = _dipole_axis(equation)
    along = omega[0] * axis[0] + omega[1] * axis[1] + omega[2] * axis[2]
    moved = omega - (SHAKY * error * along)[None] * axis
    outcome = jnp.asarray(Verdict(*equation.verdict(moved)).outcome, int)
    return (outcome != runs.outcome) & (runs.outcome == Outcome.RESIDUAL)


def _dipole_axis(equation: Any) -> Vector:
    """Return the direction of the dipole of each lane; axis 1 if the body is not a parameter."""
    if not has_body_field(equation):
        return jnp.array([[1.0], [0.0], [0.0]])
    dipole = equation.body.dipole
    return scale(1 / safe_divisor(length(dipole)), dipole)


def made_twice(equation: Any) -> bool:
    """Return whether the doubt of this module is known to hold for an equation."""
    return type(equation) in (TransverseReduced, TransverseSemi, Reduced, SemiReduced)


def _is_bounded(equation: Any) -> Any:
    """Return whether there is a boundary between outcomes."""
    if type(equation) not in (TransverseReduced, TransverseSemi):
        return True
    return has_boundary(equation.delta, level_of_top(equation))


def exact_when_slow(equation: Any, value: Value) -> Any:
    """Return whether runs need a relative accuracy to the end: one value, or one for each δ."""
    if value or type(equation) not in (*TRANSVERSE, *LONGITUDINAL):
        return True
    if type(equation) in LONGITUDINAL:  # always residual
        return False
    delta = equation.delta
    if concrete(delta):  # in NumPy, since JAX compiles for each number of lanes
        delta = np.asarray(delta)
    return has_boundary_at_rest(delta, level_of_top(equation))


def level_of_top(equation: Any) -> Level:
    """Return the level whose basin boundaries a top has: SEMI for the full equation."""
    order = getattr(equation, "order", None)
    return Level.SEMI if order is None else Level.of_order(order)
