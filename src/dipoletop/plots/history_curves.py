"""The content of a picture of a history, before it is drawn: times and curves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..prediction import Prediction

POINTS = 241
"""Number of times at which a history is computed."""
BEFORE, AFTER = 1e-3, 1e2
"""The first time over the half time, and the last one over the half time or the lifetime."""
WIDEST = 1e15
"""Largest ratio of the last time to the first one."""


class Curves(NamedTuple):
    """The histories of N rotations, relative to their starts, at T common times."""

    times: Float[np.ndarray, "T"]
    energy: Float[np.ndarray, "N T"]
    """E/E₀."""
    momentum: Float[np.ndarray, "N T"]
    """|L|/L₀."""
    shape: Float[np.ndarray, "N T"]
    """hJ₃ = 2EJ₃/L², between 1 and J₃/J₁."""
    ratios: Float[np.ndarray, "3"]
    """J₃/J₃, J₃/J₂ and J₃/J₁: the values of hJ₃ about the principal axes."""
    half_time: float
    """The median of the known half times."""


def curves_of(predictions: Prediction, times: Float[np.ndarray, "T"] | None) -> Curves:
    """Return the histories of a batch of predictions for one body; None chooses the times."""
    given = np.asarray(predictions.variables)
    inertia = given[0, :9].reshape(3, 3)
    moments = np.linalg.eigvalsh(inertia / np.trace(inertia)) * np.trace(inertia)
    if times is None:
        times = times_for(predictions)
    histories = [_one(predictions, k).history(jnp.asarray(times)) for k in range(len(given))]
    energy, momentum, shape = (
        np.stack([np.asarray(getattr(history, name)) for history in histories])
        for name in ("energy", "momentum", "shape")
    )
    omega = given[:, 12:]
    start = omega @ inertia
    size = np.linalg.norm(start, axis=1, keepdims=True)
    half_times = np.asarray(predictions.half_time)
    known = half_times[half_times > 0]
    return Curves(
        times,
        energy * (2 / np.sum(start * omega, axis=1, keepdims=True)),
        momentum / size,
        shape * moments[2],
        moments[2] / moments[::-1],
        float(np.median(known)) if known.size else np.nan,
    )


def _one(predictions: Prediction, k: int) -> Prediction:
    return jax.tree.map(lambda leaf: leaf[k], predictions)


def times_for(predictions: Prediction) -> Float[np.ndarray, "T"]:
    """Return times from long before the first change to long after the last one."""
    half_times, lifetimes = np.asarray(predictions.half_time), np.asarray(predictions.lifetime)
    known = half_times[np.isfinite(half_times) & (half_times > 0)]
    if not known.size:
        # For a rotation that never changes, or is captured first, use the time scale of braking.
        scale = _scale(predictions)
        known = np.array([scale])
    first, last = BEFORE * np.min(known), AFTER * np.max(known)
    decays = lifetimes[np.isfinite(lifetimes) & (lifetimes > 0)]
    if decays.size:
        last = max(last, AFTER * np.max(decays))
    return np.geomspace(first, min(last, WIDEST * first), POINTS)


def _scale(predictions: Prediction) -> float:
    """Return I/(κΩ²), the time scale of braking, with the trace of the inertia tensor for I."""
    given = np.asarray(predictions.variables)[0]
    dipole, omega = given[9:12], given[12:]
    kappa = predictions.strength * (dipole @ dipole)
    return float(np.trace(given[:9].reshape(3, 3)) / kappa / (omega @ omega))
