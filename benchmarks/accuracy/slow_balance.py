"""The energy that a slow motion loses, against the power of its spectral lines, over all times.

The prediction integrates mean rates in closed form over h. Here ∫P dt runs over time, and P is the
sum of the powers of the lines of `dipoletop.lines`, which come from Fourier series.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks.problems.slow_rotations import Bodies

AMPLITUDE = 1e-6
SPAN = 100.0  # length of the integration in half times; the history gives E − E∞ after it
GRADES = 20  # panels towards the separatrix, each a tenth of the one before
HARMONICS = 64
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(12)


@partial(jax.jit, static_argnames="n")
def _powers(body: dt.Body, omegas: jax.Array, n: int) -> jax.Array:
    return jax.vmap(lambda omega: jnp.sum(dt.lines(body, omega, n=n).power))(omegas)


def panels(half: float, crossing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights for 0 < t < SPAN·half with a logarithmic singularity of P."""
    steps = 10.0 ** -np.arange(GRADES)
    around = np.concatenate([1 - steps[1:], [1.0], 1 + steps[1:][::-1]]) * crossing
    geometric = np.geomspace(1e-3, SPAN, 40) * half
    edges = np.sort(np.concatenate([[0.0], geometric, around]))
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    nodes = middle[:, None] + width[:, None] * POINTS
    return nodes.ravel(), (width[:, None] * WEIGHTS).ravel()


def crossing_time(prediction: dt.Prediction, middle: float, half: float) -> float:
    """Return the time when h passes 1/J₂, by bisection in ln t; half the half time if never."""
    low, high = np.log(1e-9 * half), np.log(SPAN * half)

    def above(log: float) -> bool:
        return bool(prediction.history(np.exp([log])).shape[0] > middle)

    first = above(low)
    if above(high) == first:
        return half / 2
    for _ in range(52):
        centre = (low + high) / 2
        low, high = (centre, high) if above(centre) == first else (low, centre)
    return float(np.exp((low + high) / 2))


def defect(body: dt.Body, omega: np.ndarray) -> float:
    """Return (emitted energy + remaining E − E∞)/(E₀ − E∞) − 1."""
    prediction = dt.predict(body, omega)
    half = float(prediction.half_time)
    first, middle, last = 1 / np.diag(body.inertia)  # of principal moments, ascending
    times, weights = panels(half, crossing_time(prediction, middle, half))
    kept = times < SPAN * half
    history = prediction.history(np.where(kept, times, half))
    share = np.clip((np.asarray(history.shape) - last) / (first - last), 0, 1)
    momentum = np.asarray(history.momentum)[:, None] * np.sqrt(
        np.stack([share, 0 * share, 1 - share], axis=1)
    )
    power = np.asarray(_powers(body, jnp.asarray(momentum / np.diag(body.inertia)), HARMONICS))
    emitted = np.sum(np.where(kept, weights * power, 0.0))
    energy = float(omega @ body.inertia @ omega) / 2
    left = prediction.history(np.array([SPAN * half])).energy[0] - (
        energy - prediction.radiated_energy
    )
    return float((emitted + left) / prediction.radiated_energy - 1)


def defects(bodies: Bodies, ways: np.ndarray) -> list[tuple[str, float]]:
    """Return the largest defect of each family over some starts."""
    worst: dict[str, float] = {}
    for family, inertia, dipole in zip(*bodies, strict=True):
        moments = np.sort(np.diag(inertia))
        if family == "needle, transverse" or not np.array_equal(moments, np.diag(inertia)):
            continue  # captures have no history; other moments are not in ascending order
        body = dt.Body(inertia, dipole)
        found = max(abs(defect(body, AMPLITUDE * way)) for way in ways)
        worst[family] = max(worst.get(family, 0.0), found)
    return list(worst.items())
