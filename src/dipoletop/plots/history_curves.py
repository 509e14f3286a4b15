"""What a picture of a history shows, before it is drawn: times, curves, and their quantiles."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..prediction import Prediction

POINTS = 241
"""Times at which a history is computed."""
BEFORE, AFTER = 1e-3, 1e2
"""The first time over the half time, and the last one over the half time or the lifetime."""
WIDEST = 1e15
"""The last time over the first one, at most."""


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
    """The median of those known."""


def curves_of(predictions: Prediction, times: Float[np.ndarray, "T"] | None) -> Curves:
    """The histories of a batch of predictions of one body, at times that show all of them."""
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
    """Times from long before the first change to long after the last one."""
    half_times, lifetimes = np.asarray(predictions.half_time), np.asarray(predictions.lifetime)
    known = half_times[np.isfinite(half_times) & (half_times > 0)]
    if not known.size:
        # A rotation that never changes, or one whose capture comes first: by its own law.
        scale = _scale(predictions)
        known = np.array([scale])
    first, last = BEFORE * np.min(known), AFTER * np.max(known)
    decays = lifetimes[np.isfinite(lifetimes) & (lifetimes > 0)]
    if decays.size:
        last = max(last, AFTER * np.max(decays))
    return np.geomspace(first, min(last, WIDEST * first), POINTS)


def _scale(predictions: Prediction) -> float:
    """I/(κΩ²), the time scale of braking, with the trace of the inertia tensor for I."""
    given = np.asarray(predictions.variables)[0]
    dipole, omega = given[9:12], given[12:]
    kappa = predictions.strength * (dipole @ dipole)
    return float(np.trace(given[:9].reshape(3, 3)) / kappa / (omega @ omega))
