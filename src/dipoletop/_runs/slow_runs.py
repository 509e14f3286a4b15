"""Runs that radiate too slowly to be followed, whose end the slow flow predicts.

A run turns about 1/(τ₀Ω) times before its outcome is certain, so its cost grows without bound as
the amplitude falls. Where the estimated number of steps exceeds the budget, the engine only tests
the first state, and averages over free rotation (`_averaging`) predict what it does not decide.
That number (`run_lengths`) depends on L∞, which the averages give. So a run of a body whose length
is not clear is begun, and paused when it has taken a part of its budget, for the averages to tell
whether it goes on.

A law holds only while little is radiated in a period. A run that brakes too fast for it at ω₀ is
predicted from the state that it has reached. That gives its outcome but not ω∞, which depends on
the phase: the error of the integration until then is not estimated.
"""

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from typing_extensions import TypeAliasType

from .._averaging.capture import is_random
from .._averaging.predicted_ends import CERTAIN, LARGEST_ERROR, End
from .._averaging.untimed_ends import ends_of_many, least_errors, put_ends, unknown_ends
from .._base.refusals import refuse
from .._base.types import (
    PREDICTED_FATES,
    RESIDUAL_FATES,
    Fate,
    Outcome,
    Regime,
    Stop,
    implied_probability,
)
from .._engines.interface import Limits
from ..equations._common import is_full
from ..equations._families import LONGITUDINAL, RIGID, TRANSVERSE
from ..equations._verdicts.transverse import has_boundary_at_rest
from ..equations.levels import Level
from ..equations.tangent import Tangent
from .classification import Classification
from .memory_limits import part_of
from .run_lengths import (
    ROUNDING,
    WINDOWS,
    SlowMotions,
    is_across,
    is_consistent,
    phase_of_needle,
    slow_motions,
    steps_per_radian,
)

SlowFlow = TypeAliasType("SlowFlow", bool | Literal["auto"])
"""Whether runs are predicted: where their estimated number of steps exceeds the budget ("auto"),
wherever the first state does not decide (True), or not at all (False)."""

LEAST_RATIO = 0.03
"""The L∞/L₀ that is assumed before the slow flow is computed; runs that slow down further are
found when they have taken many steps. If it were smaller, more runs would be predicted in vain:
that costs as much as a few of them, and seconds of compilation the first time."""
PATIENCE, PATIENCE_WITH_TOPS = 0.2, 0.1
"""Parts of the budget after which it is estimated anew how long a run of a body or top will be."""
FEW = 1000  # steps that cost about as much as a prediction
MARGIN = 0.75  # part of the budget: runs with a larger estimate rarely take less than half of it


class Origins(NamedTuple):
    """The states of N runs from which laws may predict their ends."""

    equation: Any
    """A predictable equation, with a trailing axis of N lanes."""
    omegas: Any
    """The angular velocities, shape (3, N)."""
    passed: Int[np.ndarray, "N"]
    """The steps taken before these states."""
    begun: Bool[np.ndarray, "N"]
    """Whether the run has taken steps."""

    @classmethod
    def at_starts(cls, equation: Any, omegas: Any) -> "Origins":
        """Return the origins of runs that have not begun."""
        size = omegas.shape[1]
        return cls(equation, omegas, np.zeros(size, int), np.zeros(size, bool))

    @classmethod
    def of_runs(
        cls, equation: Any, omegas: Any, reached: Any, steps: Int[np.ndarray, "N"]
    ) -> "Origins":
        """Return the origins of runs from ω₀ that have reached ω after some steps.

        They are ω₀, unless a rotation brakes too fast there for a law, which may hold later.
        """
        holds, begun = cls.at_starts(equation, omegas).may_have_law, steps > 0
        if type(equation) not in TRANSVERSE and begun.any():
            inertia, dipole, omega, *_ = slow_motions(equation, omegas)
            errors = least_errors(inertia[begun], dipole[begun], omega[begun])
            holds[begun] = ~(errors > LARGEST_ERROR)
        place = np.where(holds, np.asarray(omegas), np.asarray(reached))
        return cls(equation, place, np.where(holds, 0, steps), begun)

    @property
    def may_have_law(self) -> Bool[np.ndarray, "N"]:
        """Whether a law may hold; none does where the rotation brakes too fast.

        The criterion is the error that `ends_of_many` finds. It has a closed form for transverse
        tops; of other bodies all may have a law.
        """
        if type(self.equation) not in TRANSVERSE:
            return np.ones(self.omegas.shape[1], bool)
        delta = np.asarray(self.equation.delta)
        errors = errors_of_needles(delta, np.asarray(self.omegas))
        return (delta <= 0) | ~(errors > LARGEST_ERROR).all(axis=0)

    def left(self, limits: Limits) -> Float[np.ndarray, "N"]:
        """Return the estimated number of steps to come above which a run is predicted.

        A run that has begun is predicted only if it surely exceeds its budget.
        """
        left = int(limits.max_steps) - self.passed
        return np.where(self.begun, left / MARGIN, MARGIN * left)

    def are_slow(self, limits: Limits, label_only: bool) -> Bool[np.ndarray, "N"]:
        """Return which runs exceed their budget, by the estimate with the assumed L∞.

        Of bodies that have begun all are taken, since a prediction gives their L∞.
        """
        equation, left, rtol = self.equation, self.left(limits), float(limits.rtol)
        if type(equation) not in TRANSVERSE:
            steps = slow_motions(equation, self.omegas).steps(LEAST_RATIO, rtol, label_only)
            return self.begun | (steps > left)
        # The same formula for moments 1, 1 and 1 − δ, where most terms vanish: needles are slow.
        delta, (w1, w2, w3) = np.asarray(equation.delta), np.asarray(self.omegas)
        if not is_consistent(equation):  # their law is not known
            return np.zeros(w1.size, bool)
        left = left / WINDOWS if is_full(equation) else left
        with np.errstate(all="ignore"):
            phase = phase_of_needle(1 - delta, w3, w1**2 + w2**2)
        slow = (delta > 0) & (phase > left / steps_per_radian(rtol, label_only)[1])
        lanes = np.flatnonzero(slow)
        slow[lanes] = part_of(self, lanes, slow.size).may_have_law
        return slow

    def predictions(self, threads: int) -> "Predictions":
        """Return the predicted ends."""
        motions = slow_motions(self.equation, self.omegas)
        ends, others = self._sure_ends()
        if (some := np.flatnonzero(others)).size:
            body = motions.inertia[some], motions.dipole[some], motions.omega[some]
            wanted = motions.has_law[some]
            put_ends(ends, some, ends_of_many(*body, wanted=wanted, threads=threads))
        known = np.asarray((ends.outcome != Outcome.FAILED) & (ends.error <= LARGEST_ERROR))
        # The error of the integration until then is not estimated.
        unknown = (self.passed > 0) & (ends.outcome != Outcome.STOP)
        ends = replace(ends, omega_inf=np.where(unknown, np.nan, ends.omega_inf))
        return Predictions(motions, ends, known)

    def _sure_ends(self) -> tuple[End, Bool[np.ndarray, "N"]]:
        """Return the ends of tops that need no computation, and which are the others.

        Below δ_c2 almost every needle becomes residual; its sense is a matter of chance.
        """
        size = self.omegas.shape[1]
        if type(self.equation) not in TRANSVERSE:
            return unknown_ends(np.full(size, np.inf)), np.ones(size, bool)
        delta, omegas = np.asarray(self.equation.delta), np.asarray(self.omegas)
        errors = np.where(delta > 0, errors_of_needles(delta, omegas), np.inf)
        random = is_random(delta, omegas, np) & (errors[0] <= LARGEST_ERROR)
        error = np.where(random, *errors)
        sure = random | ((self.passed > 0) & (error <= LARGEST_ERROR))
        sure &= (
            is_consistent(self.equation) & (delta > 0) & ~has_boundary_at_rest(delta, Level.SEMI)
        )
        ends, lanes = unknown_ends(error), np.flatnonzero(sure)
        ends.outcome[lanes], ends.regime[lanes] = Outcome.RESIDUAL, Regime.UNFOLDED
        ends.probability[lanes] = np.eye(len(PREDICTED_FATES))[RESIDUAL_FATES].sum(0) / 2
        return ends, ~sure


def errors_of_needles(
    delta: Float[np.ndarray, "N"], omegas: Float[np.ndarray, "3 N"]
) -> Float[np.ndarray, "2 N"]:
    """Return the errors of predictions of transverse tops, 0 < δ < 1, at the start.

    They are that of the averages (`start_error`) and of a known phase (`error_of_phase`), with the
    angle θ between L and the symmetry axis, c = cos θ, β = δ/(1 − δ): the lines 1 ± βc of a dipole
    across that axis carry off L at the rate L³S, S = Σ(1 ± c)²(1 ± βc)³/4, and a period lasts
    2π/(βcL).
    """
    w1, w2, w3 = omegas
    axial, square = (1 - delta) * w3, w1**2 + w2**2
    with np.errstate(all="ignore"):
        size = np.sqrt(square + axial**2)
        c, beta = np.abs(axial) / size, delta / (1 - delta)
        rate = ((1 + c) ** 2 * (1 + beta * c) ** 3 + (1 - c) ** 2 * (1 - beta * c) ** 3) / 4
        of_averages = 2 * size * np.abs(rate) / (beta * c)
        of_phase = size + 2 * delta * np.abs(w3) ** 3 / square**2
        return np.stack([of_averages, of_phase])


def check_slow_flow(slow_flow: Any, equation: Any, why_not: str = "") -> None:
    """Refuse True where nothing can be predicted, and values that are not among the choices.

    Args:
        slow_flow: the argument of the user.
        equation: the equation of the runs.
        why_not: another reason why nothing can be predicted.
    """
    is_word = isinstance(slow_flow, str) and slow_flow == "auto"
    if not (is_word or isinstance(slow_flow, bool)):
        refuse("slow_flow", "be 'auto', True or False", f"is {slow_flow!r}")
    if slow_flow is True and (reason := why_not or why_unpredictable(equation)):
        refuse("slow_flow", "be 'auto' or False here", f"is True, but {reason}")


def why_unpredictable(equation: Any) -> str:
    """Return the reason why the runs of an equation cannot be predicted, or an empty text.

    A class of the user, or one with a torque from outside, has another slow motion.
    """
    if jnp.result_type(float) != jnp.float64:
        return "float64 is off"
    if isinstance(equation, Tangent):
        return "derivatives are wanted, which the slow flow does not give"
    if type(equation) not in (*RIGID, *TRANSVERSE, *LONGITUDINAL):
        return f"the slow motion of {type(equation).__name__} is not known"
    return ""


def first_budget(equation: Any, limits: Limits) -> Any:
    """Return the number of steps after which it is estimated anew how long a run will be."""
    part = PATIENCE if type(equation) in RIGID else 1.0
    if type(equation) in TRANSVERSE and is_consistent(equation):
        part = PATIENCE_WITH_TOPS
    steps = int(limits.max_steps)
    return np.asarray(min(steps, max(FEW, int(part * steps))))


class Predictions(NamedTuple):
    """The predicted ends of N runs."""

    motions: SlowMotions
    ends: End
    known: Bool[np.ndarray, "N"]
    """Whether a law holds, with an error that lets it decide."""

    def need_more_than(
        self, left: Float[np.ndarray, "N"], limits: Limits, label_only: bool
    ) -> Bool[np.ndarray, "N"]:
        """Return which runs need more steps than are left, if they reach the predicted L∞."""
        # The steps of a needle do not depend on L∞, which may be unknown.
        ratio = np.where(np.isnan(self.ends.ratio), 1.0, self.ends.ratio)
        steps = self.motions.steps(ratio, float(limits.rtol), label_only)
        return self.known & (steps > left)

    def filled_in(self, runs: Classification, label_only: bool) -> Classification:
        """Fill in unknown outcomes and ω∞, if a law is known. That certifies nothing."""
        ends, known = self.ends, self.known & is_open(runs, label_only)
        label = known & (runs.outcome == Outcome.UNDECIDED)
        agrees = (runs.outcome == Outcome.RESIDUAL) & (ends.outcome == Outcome.RESIDUAL)
        value = label | (known & agrees & np.isfinite(ends.omega_inf))
        error = ends.error * np.abs(ends.omega_inf)
        probability = np.sum(ends.probability[:, RESIDUAL_FATES], axis=1)
        return replace(
            runs,
            outcome=np.where(label, ends.outcome, runs.outcome),
            omega_inf=np.where(value, ends.omega_inf, runs.omega_inf),
            omega_inf_error=np.where(value, error, runs.omega_inf_error),
            time=np.where(label, np.nan, runs.time),
            stop=np.where(label, _stops(ends, self.motions), runs.stop),
            regime=np.where(value, ends.regime, Regime.RESOLVED),
            probability=np.where(label, probability, implied_probability(runs.outcome)),
        )


def is_open(runs: Classification, label_only: bool) -> Bool[np.ndarray, "N"]:
    """Return whether the outcome of a run, or a wanted ω∞, is not known."""
    undecided = np.asarray(runs.outcome == Outcome.UNDECIDED)
    lacks_value = (runs.outcome == Outcome.RESIDUAL) & np.isnan(runs.omega_inf_error)
    return undecided if label_only else undecided | np.asarray(lacks_value)


def _stops(ends: End, motions: SlowMotions) -> Any:
    """Return the way in which tops stop, unless chance decides it.

    A top with its dipole across its symmetry axis precesses about that axis while it decays.
    """
    (j1, j2, j3), (n1, _, n3) = motions.ascending
    first, last = (j2 - j1) <= ROUNDING * j3, (j3 - j2) <= ROUNDING * j3
    prolate, oblate = last & ~first, first & ~last
    across = prolate & is_across(n1, j2 - j1, j3)
    across |= oblate & is_across(n3, j3 - j2, j3)
    share = dict(zip(PREDICTED_FATES, ends.probability.T, strict=True))
    of_axes = share[Fate.AXIS_1] + share[Fate.AXIS_2] + share[Fate.AXIS_3]
    about_symmetry = across * np.where(prolate, share[Fate.AXIS_1], share[Fate.AXIS_3])
    ways = {
        Stop.AXIS: of_axes - about_symmetry,
        Stop.ROTATING: about_symmetry,
        Stop.WOBBLING: share[Fate.WOBBLING],
        Stop.TUMBLING: share[Fate.TUMBLING_LOW] + share[Fate.TUMBLING_HIGH],
    }
    return np.select([chance > CERTAIN for chance in ways.values()], list(ways), Stop.NONE)
