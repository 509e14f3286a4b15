"""What the figures show, before it is drawn: shares of ends, motions, eigenvalues, maps."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from .. import planar
from .._maps.basin import Basin, wilson
from .._maps.grids import Grid
from .._maps.sweep import sweep
from .._runs.simulate import simulate
from .._runs.trajectory import Trajectory
from ..equations.transverse import TransverseFull, TransverseReduced, TransverseSemi, cylindrical
from ..plots.plane import CLASSES
from ..stability import spectrum

AMPLITUDE = 0.2
DELTA = -0.2  # of figure 2 and of the map
LEVELS: dict[str, Callable[[Any], Any]] = {
    "order 1": TransverseReduced,
    "order 2": lambda delta: TransverseReduced(delta, 2),
    "semi-reduced": TransverseSemi,
    "full": TransverseFull,
}


def even_starts(n: int) -> Float[np.ndarray, "n 3"]:
    """Starts with |ω| = 0.2 spread evenly over the half sphere ω₃ > 0, along a Fibonacci spiral.

    The other half follows by symmetry. Shares come out smoother than from a random sample.
    """
    i = np.arange(n)
    cos = (i + 0.5) / n
    turn = 2 * np.pi * i / ((1 + math.sqrt(5)) / 2)
    across = np.sqrt(1 - cos**2)
    return AMPLITUDE * np.column_stack([across * np.cos(turn), across * np.sin(turn), cos])


def ends(level: str, deltas: Any, starts: Float[Any, "n 3"], **settings: Any) -> Basin:
    """Outcomes of every start at every δ, over the axes (delta, omega)."""

    def problem(delta: Array, omega: Array) -> tuple[Any, Array]:
        return LEVELS[level](delta), omega

    return sweep(problem, Grid(delta=deltas, omega=starts), value=False, **settings)


class Share(NamedTuple):
    """How large a part of the starts ends in one way, at every δ, and its 95 % interval."""

    label: str
    colour: str
    share: Float[np.ndarray, "d"]
    low: Float[np.ndarray, "d"]
    high: Float[np.ndarray, "d"]


def shares(basin: Basin) -> list[Share]:
    """The ends that occur in `ends`, in the order of `CLASSES`; intervals as of random starts."""
    n, found = basin.shape[1], []
    for (outcome, stop), (label, colour) in CLASSES.items():
        counts = np.sum((basin.outcome == outcome) & (basin.stop == stop), axis=1)
        if np.any(counts):
            found.append(Share(label, colour, counts / n, *wilson(counts, n)))
    return found


def motion(level: str, phi: float, times: Float[Any, "T"]) -> Trajectory:
    """Figure 2: δ = −1/5, ω⊥ = ω₃ = 1/5, from φ₀ at τ = 0."""
    start = cylindrical(AMPLITUDE, AMPLITUDE, phi)
    return simulate(LEVELS[level](DELTA), start, jnp.asarray(times))


def eigenvalues(level: str, deltas: Float[Any, "d"], w: float) -> Complex[np.ndarray, "d 2"]:
    """λ/w² of the motions across the dipole at {w, 0, 0}."""

    def slow(delta: Array) -> Array:
        return spectrum(LEVELS[level](delta), jnp.array([w, 0.0, 0.0])).slow[1:]

    found = np.asarray(jax.vmap(slow)(jnp.asarray(deltas)))
    return found / w**2


def small_w(deltas: Float[Any, "d"]) -> Complex[np.ndarray, "d 2"]:
    """Their limit w → 0 at the consistent levels: [−(2+δ) ± √(δ²+8δ)] / (2(1−δ))."""
    d = np.asarray(deltas)
    root = np.sqrt((d**2 + 8 * d).astype(complex))
    return np.stack([-(2 + d) + root, -(2 + d) - root], axis=1) / (2 * (1 - d[:, None]))


class Maps(NamedTuple):
    """Outcomes over φ and ω₃ at ω⊥ = 0.2, and where those of other levels differ."""

    semi: Basin
    order_1: Bool[np.ndarray, "w3 phi"]
    full: Bool[np.ndarray, "coarse_w3 coarse_phi"]
    """Of some of the starts only."""


def maps(size: int, every: int, w3_max: float) -> Maps:
    """One symmetry cell with size × size starts, one in `every` on both axes for the full equation.

    An even size leaves out φ = π/2, where ω₁ = 0 is a case of its own.
    """
    w3, phi = np.linspace(0, w3_max, size), np.linspace(0, np.pi, size)

    def outcomes(level: str, step: int) -> Basin:
        def problem(w3: Array, phi: Array) -> tuple[Any, Array]:
            return LEVELS[level](DELTA), cylindrical(AMPLITUDE, w3, phi)

        return sweep(problem, Grid(w3=w3[::step], phi=phi[::step]), value=False)

    semi = outcomes("semi-reduced", 1)
    order_1 = outcomes("order 1", 1).outcome != semi.outcome
    full = outcomes("full", every).outcome != semi.outcome[::every, ::every]
    return Maps(semi, order_1, full)


def small_boundary(corrected: bool, phi: Float[Any, "n"]) -> Float[np.ndarray, "n"]:
    """ω₃ on the boundary of small amplitudes, z_s(φ)ω⊥², NaN at the jump."""
    system = planar.Planar(DELTA, corrected=corrected)
    z = np.array(planar.boundary(system, jnp.asarray(phi)))
    z[1:][np.abs(np.diff(z)) > 1] = np.nan
    return z * AMPLITUDE**2
