"""Predictions of `dipoletop.predict`, and the same motions integrated turn by turn."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.problems.random_bodies import Starts, equations
from dipoletop import Outcome, prediction

RTOL = 1e-10  # of the integration: its error is far below that of the prediction
LATEST = 30.0  # braking times up to which energies are compared
BEFORE_CAPTURE = 0.3  # braking times after which they are, if a needle is captured before
LARGEST_ERROR = 0.5  # of a prediction that is not refused


class Predicted(NamedTuple):
    """Predictions of N motions; NaN where a rotation is too fast for averages."""

    outcome: np.ndarray  # UNDECIDED also for refused predictions
    refused: np.ndarray
    ends: np.ndarray  # (N, 8): probabilities
    omega_inf: np.ndarray
    ratio: np.ndarray
    quantiles: np.ndarray  # (N, 5), of the ratio
    error: np.ndarray
    time: np.ndarray  # at which energies are compared: the half time, if their law holds so long
    energy: np.ndarray  # at that time

    @property
    def residual(self) -> np.ndarray:
        """The probability of residual rotation."""
        return self.ends[:, :2].sum(axis=1)

    @property
    def certain(self) -> np.ndarray:
        """Whether L∞/L₀ does not depend on chance."""
        return self.quantiles[:, 0] == self.quantiles[:, -1]

    @property
    def sign_by_chance(self) -> np.ndarray:
        """Whether residual rotation is certain, but not its sense."""
        return (self.residual == 1) & (self.ends[:, 0] == self.ends[:, 1])


UNKNOWN = Predicted(
    Outcome.UNDECIDED, True, np.full(8, np.nan), np.nan, np.nan, np.full(5, np.nan), *[np.nan] * 3
)


class Resolved(NamedTuple):
    """The motions of `Predicted`, integrated turn by turn."""

    outcome: np.ndarray
    omega_inf: np.ndarray  # NaN where the run is out of steps
    ratio: np.ndarray  # L∞/L₀ of residual rotation
    energy: np.ndarray  # at the time that was asked for; NaN where that was not reached


def momenta(sample: Starts) -> np.ndarray:
    """Return |L₀|, shape (N,)."""
    return np.linalg.norm(np.einsum("nij,nj->ni", sample.inertia, sample.omega), axis=1)


def predicted(sample: Starts) -> Predicted:
    """Predict each motion separately, the intended use of `predict`, but by averages only."""
    rows = []
    prediction.HANDOVER = math.inf  # no prediction is turn by turn itself
    braking_times = np.linalg.eigvalsh(sample.inertia)[:, 2] ** 3 / (2 * momenta(sample) ** 2)
    for unit, inertia, dipole, omega in zip(braking_times, *sample, strict=True):
        one = dt.predict(dt.Body(inertia, dipole), omega)
        if one.error > LARGEST_ERROR:
            rows.append(UNKNOWN)
            continue
        half = float(one.half_time)
        times = np.array([min(half, LATEST * unit) if half > 0 else unit, BEFORE_CAPTURE * unit])
        energies = one.history(times).energy
        time, energy = (x[int(np.isnan(energies[0]))] for x in (times, energies))
        label = one.outcome, False, one.probability, one.omega_inf
        sizes = one.ratio, one.ratio_quantiles, one.error
        rows.append(Predicted(*label, *sizes, time, energy))
    return Predicted(*(np.array(column) for column in zip(*rows, strict=True)))


def resolved(sample: Starts, times: np.ndarray, max_steps: int) -> Resolved:
    """Integrate with the semi-reduced equation, which keeps all orders."""
    every: Any = jax.vmap(lambda inertia, dipole: dt.SemiReduced(dt.Body(inertia, dipole)))(
        jnp.asarray(sample.inertia), jnp.asarray(sample.dipole)
    )
    labels = dt.classify_many(every, sample.omega, max_steps=max_steps, value=False)
    ends = dt.classify_many(every, sample.omega, rtol=RTOL, max_steps=max_steps)
    turns = equations("semi", sample.inertia, sample.dipole)
    known = np.isfinite(times)
    last = jnp.asarray(np.where(known, times, 0.0))
    bounds = engines.limits(RTOL, jnp.zeros(len(times)), max_steps, last)
    states = engines.integrate_by_the_fastest(
        turns, jnp.asarray(sample.omega.T), bounds, until="time"
    )
    reached = known & (np.asarray(states.status) == engines.FINISHED)
    omega = np.asarray(states.y).T
    energy = np.einsum("ni,nij,nj->n", omega, sample.inertia, omega) / 2
    n = sample.dipole / np.linalg.norm(sample.dipole, axis=1)[:, None]
    moment = np.einsum("ni,nij,nj->n", n, sample.inertia, n)
    value = np.where(ends.outcome == Outcome.RESIDUAL, ends.omega_inf, np.nan)
    ratio = np.abs(value) * moment / momenta(sample)
    return Resolved(labels.outcome, value, ratio, np.where(reached, energy, np.nan))


def compared(sample: Starts, max_steps: int) -> tuple[Predicted, Resolved]:
    """The predictions, and the same motions turn by turn."""
    of = predicted(sample)
    return of, resolved(sample, of.time, max_steps)


def differences(of: Predicted, runs: Resolved) -> tuple[np.ndarray, np.ndarray]:
    """Return relative differences of L∞/L₀ and of the energy; NaN where they cannot be compared.

    Where L∞/L₀ depends on chance, its distribution is compared elsewhere.
    """
    alike = (of.residual == 1) & of.certain
    of_ratio = np.where(alike, np.abs(runs.ratio / np.where(alike, of.ratio, 1.0) - 1), np.nan)
    return of_ratio, np.abs(runs.energy / of.energy - 1)
