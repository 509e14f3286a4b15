"""How a rotation that radiates strongly ends: integration turn by turn, and then the slow flow.

If a large part of the energy is radiated within one period, averages over free rotation do not
hold. The semi-reduced equation is integrated instead. Its verdict gives the outcome. A residual
rotation is integrated until it is constant, a stop until averages hold and describe the rest.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._averaging.ends import QUANTILES, certainty_of
from .._averaging.free_rotation import mean_square_speed
from .._averaging.histories import Values, in_units
from .._averaging.laws import (
    Law,
    Needle,
    SlowFlow,
    averaged_law_and_end,
    first_law,
)
from .._averaging.predicted_ends import End, Start, decided, scaled_rotation
from .._averaging.slow_flow import from_logit
from .._base.checks import ArrayLike
from .._base.compiling import compiled_soon
from .._base.tolerances import MAX_STEPS
from .._base.types import RESIDUAL_FATES, Fate, Outcome, Regime, Vector
from ..bodies import Body
from ..equations.rigid import SemiReduced
from .classification import Classification
from .classify import classify
from .run_lengths import SlowMotions
from .simulate import simulate

RTOL = 1e-8
HANDOVER = 1e-2
"""The estimated error below which averages are trusted."""
STRETCH = 0.5  # length of a stretch in units of 1/ω², about the time in which E falls
STRETCHES = 400  # largest number of stretches
UNFOLDED_STRETCHES = 16  # stretches for which other averages than the unfolded system are awaited
SETTLED = 1e-9  # (E − E∞)/E₀ below which a residual rotation counts as constant
POINTS, ROUNDS = 65, 3  # a search for a time narrows its bracket to POINTS**-ROUNDS


class _Course:
    """A rotation integrated stretch by stretch, in units of J₃ and κ/J₃."""

    def __init__(self, start: Start) -> None:
        inertia, dipole, omega = start.parts
        moment, size = jnp.linalg.eigvalsh(inertia)[2], jnp.linalg.norm(dipole)
        unit = start.strength * size**2 / moment
        self.start = start
        self.unit = float(unit)  # of time, κ/J₃
        self.equation = SemiReduced(Body(inertia / moment, dipole / size))
        # The ends of the stretches, and ω there.
        self.times: list[float] = [0.0]
        self.omegas: list[Vector] = [omega * unit]

    @property
    def reached(self) -> Start:
        """The end of the last stretch."""
        omega = self.omegas[-1] / self.unit
        return self.start._replace(variables=jnp.append(self.start.variables[:12], omega))

    def slow_end(self) -> End | None:
        """Return how the slow flow ends from there on; None if it does not hold."""
        law = self.first_law
        end = law.end(self.reached) if law == SlowFlow(Needle.NO) else None
        return end if end and end.error < HANDOVER else None

    def averaged(self) -> tuple[Law, End]:
        """Return the law from there on, the slow flow if it holds, and the end by it."""
        law, end = self.first_law, self.slow_end()
        return (law, end) if end else averaged_law_and_end(self.reached, law)

    @property
    def first_law(self) -> Law:
        """The first law from there on."""
        return first_law(*self.reached.parts, self.start.strength)

    def is_long(self, ratio: ArrayLike) -> bool:
        """Return whether the run would exceed the budget of steps if L∞/L₀ = `ratio`."""
        body = self.equation.body
        one = (np.asarray(x)[None] for x in (body.inertia, body.dipole, self.omegas[0]))
        motions = SlowMotions(*one, consistent=True, is_full=False)
        return bool(motions.steps(np.asarray(ratio)[None], RTOL, label_only=False)[0] > MAX_STEPS)

    def energy(self, omega: Vector) -> float:
        """Return E of a state in the units of `start`."""
        inertia, omega = self.start.parts[0], omega / self.unit
        return float(omega @ inertia @ omega) / 2

    def momentum(self, omega: Vector) -> float:
        """Return |L| of a state, in the units of `start`."""
        return float(jnp.linalg.norm(self.start.parts[0] @ omega)) / self.unit

    def run(self) -> Classification:
        """Return the outcome by integration alone, since averages do not hold here."""
        return classify(self.equation, self.omegas[0], rtol=RTOL, slow_flow=False)

    def residual_state(self, run: Classification) -> Vector:
        """Return the state in which a residual rotation ends."""
        return jnp.asarray(run.omega_inf) * self.equation.body.dipole

    def at(self, times: Float[np.ndarray, "T"]) -> Float[Array, "T 3"]:
        """Return the states at ascending times."""
        first = int(np.searchsorted(self.times, times[0], "right")) - 1
        known = self.times[first] == times[0]
        ts = jnp.asarray(times if known else np.append(self.times[first], times))
        if ts.size == 1:
            return self.omegas[first][None]
        run = simulate(self.equation, self.omegas[first], ts, throw=False)
        return run.omega if known else run.omega[1:]

    def follow(self, enough: Callable[[Vector], bool]) -> bool:
        """Integrate until `enough` holds; return False if that takes too long."""
        while not enough(self.omegas[-1]):
            time = self.times[-1] + STRETCH / float(jnp.sum(self.omegas[-1] ** 2))
            omega = self.at(np.array([time]))[-1]
            if len(self.times) > STRETCHES or not bool(jnp.all(jnp.isfinite(omega))):
                return False
            self.times.append(time)
            self.omegas.append(omega)
        return True

    def time_of(self, energy: float) -> float:
        """Return the time at which E falls below a value between its first and its last."""
        after = next(k for k, omega in enumerate(self.omegas) if self.energy(omega) < energy)
        times = np.array(self.times[after - 1 : after + 1])
        above, below = (self.energy(omega) for omega in self.omegas[after - 1 : after + 1])
        for _ in range(ROUNDS):
            times = np.linspace(times[0], times[1], POINTS)
            energies = [above, *(self.energy(omega) for omega in self.at(times[1:]))]
            k = max(int(np.argmax(np.array(energies) < energy)), 1)
            times, (above, below) = times[k - 1 : k + 1], energies[k - 1 : k + 1]
        return float(times[0] + (times[1] - times[0]) * (above - energy) / (above - below))


def resolved_law(start: Start, ratio: ArrayLike) -> "Resolved | None":
    """Return the law of integration; None if it takes too long for an estimated L∞/L₀."""
    return None if _Course(start).is_long(ratio) else Resolved()


class Resolved:
    """Integration turn by turn, until averages hold."""

    def end(self, start: Start) -> End | None:
        """Return how a rotation ends; None if that takes too long."""
        course = _Course(start)
        run = course.run()
        first = course.energy(course.omegas[0])
        if _is_residual(run):
            last = course.residual_state(run)
            half = (first + course.energy(last)) / 2
            if not course.follow(lambda omega: course.energy(omega) < half):
                return None
            return _residual(course, run, course.time_of(half) * course.unit)
        if run.outcome != Outcome.STOP or not _follow_stop(course):
            return None
        _, late = course.averaged()
        stops = jnp.asarray(late.probability).at[RESIDUAL_FATES].set(0.0)
        if not bool(jnp.sum(stops) > 0):  # the two laws contradict each other
            return None
        stops = stops / jnp.sum(stops)
        zero = jnp.zeros_like(late.ratio)
        outcome, _ = decided(stops, zero, jnp.asarray(late.error))
        # The late law, with t counted from the start; a rotation that falls at once has no plateau.
        lifetime = late.lifetime - course.times[-1] * course.unit
        return dataclasses.replace(
            late,
            outcome=outcome,
            probability=stops,
            omega_inf=zero,
            ratio=zero,
            ratio_quantiles=jnp.zeros_like(late.ratio_quantiles),
            half_time=jnp.asarray(course.time_of(first / 2) * course.unit),
            radiated_energy=jnp.asarray(first),
            lifetime=jnp.where(lifetime > 0, lifetime, jnp.nan),
            regime=jnp.asarray(Regime.RESOLVED.value),
        )

    def history(self, start: Start, times: Float[Array, "T"]) -> Values:
        """Return the motion, which is averaged only after it was integrated."""
        course = _Course(start)
        run = course.run()
        if residual := _is_residual(run):
            least = course.energy(course.residual_state(run))
            least += SETTLED * course.energy(course.omegas[0])
            reached = course.follow(lambda omega: course.energy(omega) < least)
        else:
            reached = _follow_stop(course)
        scaled, end = np.asarray(times) / course.unit, course.times[-1]
        values = np.full((4, times.size), np.nan)
        early = scaled <= end
        if np.any(early):
            unique, places = np.unique(scaled[early], return_inverse=True)
            states = course.at(unique)[places] / course.unit
            values[:, early] = _of_states(start, states)
        if reached and residual:
            last = course.residual_state(run) / course.unit
            values[:, ~early] = _of_states(start, last[None])
        elif reached and not np.all(early):
            after = jnp.asarray((scaled[~early] - end) * course.unit)
            law, _ = course.averaged()
            values[:, ~early] = np.stack(law.history(course.reached, after))
        return tuple(jnp.asarray(row) for row in values)


def _is_residual(run: Classification) -> bool:
    return bool((run.outcome == Outcome.RESIDUAL) & jnp.isfinite(run.omega_inf))


def _follow_stop(course: _Course) -> bool:
    """Integrate a rotation that stops until averages hold and half of the energy is lost.

    The unfolded system neglects ω₃² beside ω⊥², which may grow later, and takes long to compute. So
    it is the last choice.
    """
    half = course.energy(course.omegas[0]) / 2
    passed = 0  # stretches that other averages do not describe

    def enough(omega: Vector) -> bool:
        nonlocal passed
        if course.energy(omega) >= half:
            return False
        if course.slow_end():
            return True
        passed += 1
        return passed > UNFOLDED_STRETCHES and bool(course.averaged()[1].error < HANDOVER)

    return course.follow(enough)


def _residual(course: _Course, run: Classification, half_time: float) -> End:
    """Return the end of a residual rotation."""
    omega, last = course.omegas[0], course.residual_state(run)
    ratio = jnp.asarray(course.momentum(last) / course.momentum(omega))
    omega_inf = jnp.asarray(run.omega_inf)
    sense = jnp.where(omega_inf > 0, Fate.POSITIVE, Fate.NEGATIVE)
    _, units = scaled_rotation(*course.start)
    return End(
        outcome=jnp.asarray(Outcome.RESIDUAL.value),
        probability=certainty_of(sense),
        omega_inf=omega_inf / course.unit,
        ratio=ratio,
        ratio_quantiles=jnp.full(len(QUANTILES), ratio),
        half_time=jnp.asarray(half_time),
        radiated_energy=jnp.asarray(course.energy(omega) - course.energy(last)),
        lifetime=jnp.asarray(jnp.inf),
        regime=jnp.asarray(Regime.RESOLVED.value),
        # The semi-reduced and the full equation differ at the second order.
        error=jnp.asarray(run.omega_inf_error) / jnp.abs(omega_inf) + units.weakness**2,
    )


@compiled_soon
def _of_states(start: Start, omegas: Float[Array, "T 3"]) -> Float[Array, "4 T"]:
    """Return E, |L|, h and √⟨Ω²⟩ of the free rotations through given states."""

    def values(omega: Vector) -> Float[Array, "4"]:
        variables = jnp.append(start.variables[:12], omega)
        rotation, units = scaled_rotation(variables, start.strength)
        high, z = rotation.place
        x, rest = from_logit(z)
        squared = mean_square_speed(rotation.side(high).moments, x, rest)
        h = rotation.momentum @ (rotation.momentum / rotation.moments)
        return jnp.stack(in_units(units, jnp.zeros_like(h), h, squared))

    return jax.vmap(values)(omegas).T
