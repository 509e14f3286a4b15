"""The data of the figures, before they are drawn: shares, motions, eigenvalues, maps."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from .. import planar
from .._base.statistics import wilson
from .._base.types import Equation
from .._maps.basin import Basin
from .._maps.grids import Grid
from .._maps.sweep import sweep
from .._runs.simulate import simulate
from .._runs.trajectory import Trajectory
from ..equations.coordinates import cylindrical
from ..equations.levels import Level
from ..equations.transverse import equation_at
from ..plots.map_layout import CLASSES
from ..stability import spectrum

AMPLITUDE = 0.2
DELTA = -0.2  # of figure 2 and of the map


def even_starts(n: int) -> Float[np.ndarray, "n 3"]:
    """Return starts with |ω| = 0.2, evenly over the half sphere ω₃ > 0, on a Fibonacci spiral.

    The other half follows by symmetry. Shares scatter less than for a random sample.
    """
    i = np.arange(n)
    cos = (i + 0.5) / n
    turn = 2 * np.pi * i / ((1 + math.sqrt(5)) / 2)
    across = np.sqrt(1 - cos**2)
    return AMPLITUDE * np.column_stack([across * np.cos(turn), across * np.sin(turn), cos])


def outcomes_by_shape(
    level: Level,
    deltas: np.ndarray | list[float],
    starts: Float[np.ndarray | Array, "n 3"],
    **settings: Any,
) -> Basin:
    """Return the outcomes of every start at every δ, over the axes (delta, omega)."""

    def problem(delta: Array, omega: Array) -> tuple[Equation, Array]:
        return equation_at(level, delta), omega

    return sweep(problem, Grid(delta=deltas, omega=starts), value=False, **settings)


class ResidualShare(NamedTuple):
    """The share of the starts with one outcome, at every δ, with its 95 % interval."""

    label: str
    colour: str
    share: Float[np.ndarray, "d"]
    low: Float[np.ndarray, "d"]
    high: Float[np.ndarray, "d"]


def shares(basin: Basin) -> list[ResidualShare]:
    """Return the shares of all outcomes that occur, ordered as `CLASSES`, as of random starts."""
    n, occurring = basin.shape[1], []
    for (outcome, stop), (label, colour) in CLASSES.items():
        counts = np.sum((basin.outcome == outcome) & (basin.stop == stop), axis=1)
        if np.any(counts):
            occurring.append(ResidualShare(label, colour, counts / n, *wilson(counts, n)))
    return occurring


def motion(level: Level, phi: float, times: Float[np.ndarray, "T"]) -> Trajectory:
    """Return a motion of figure 2: δ = −1/5, ω⊥ = ω₃ = 1/5, from φ₀ at τ = 0."""
    start = cylindrical(AMPLITUDE, AMPLITUDE, phi)
    return simulate(equation_at(level, DELTA), start, jnp.asarray(times))


def eigenvalues(
    level: Level, deltas: Float[np.ndarray, "d"], w: float
) -> Complex[np.ndarray, "d 2"]:
    """Return λ/w² of perturbations transverse to the dipole at {w, 0, 0}."""

    def slow(delta: Array) -> Array:
        return spectrum(equation_at(level, delta), jnp.array([w, 0.0, 0.0])).slow[1:]

    return np.asarray(jax.vmap(slow)(jnp.asarray(deltas))) / w**2


def small_w(deltas: Float[np.ndarray, "d"]) -> Complex[np.ndarray, "d 2"]:
    """Return lim λ/w² for w → 0 at the consistent levels: [−(2+δ) ± √(δ²+8δ)] / (2(1−δ))."""
    d = np.asarray(deltas)
    root = np.sqrt((d**2 + 8 * d).astype(complex))
    return np.stack([-(2 + d) + root, -(2 + d) - root], axis=1) / (2 * (1 - d[:, None]))


class LevelMaps(NamedTuple):
    """Outcomes over φ and ω₃ at ω⊥ = 0.2, and where other levels give different ones."""

    semi: Basin
    order_1_differs: Bool[np.ndarray, "w3 phi"]
    full_differs: Bool[np.ndarray, "coarse_w3 coarse_phi"]
    """At every `stride`-th start on both axes."""


def level_maps(size: int, stride: int, w3_max: float) -> LevelMaps:
    """Return outcomes of size × size starts in one symmetry cell, at three levels.

    With the full equation only every `stride`-th start on both axes is computed. An even size
    excludes φ = π/2, where ω₁ = 0 is a special case.
    """
    w3, phi = np.linspace(0, w3_max, size), np.linspace(0, np.pi, size)

    def outcomes(level: Level, step: int) -> Basin:
        def problem(w3: Array, phi: Array) -> tuple[Equation, Array]:
            return equation_at(level, DELTA), cylindrical(AMPLITUDE, w3, phi)

        return sweep(problem, Grid(w3=w3[::step], phi=phi[::step]), value=False)

    semi = outcomes(Level.SEMI, 1)
    order_1_differs = outcomes(Level.ORDER_1, 1).outcome != semi.outcome
    full = outcomes(Level.FULL, stride).outcome
    return LevelMaps(semi, order_1_differs, full != semi.outcome[::stride, ::stride])


def small_boundary(corrected: bool, phi: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Return ω₃ on the basin boundary in the limit of small |ω|, z_s(φ)ω⊥²; NaN at its jump."""
    system = planar.Planar(DELTA, corrected=corrected)
    z = np.array(planar.boundary(system, jnp.asarray(phi)))
    z[1:][np.abs(np.diff(z)) > 1] = np.nan
    return z * AMPLITUDE**2
