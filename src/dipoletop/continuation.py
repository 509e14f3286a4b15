"""Outcomes and stability as functions of the shape δ, or of the amplitude |ω₀|.

`continuation` computes the share of every outcome at every value of the parameter and at every
level of the equation. It uses the same isotropic starts everywhere (common random numbers), so
that curves differ by physics, not by chance. `follow_spectrum` computes the eigenvalues of the
residual line against δ, and `thresholds` the values of δ at which an outcome appears or disappears.
`plots.continuation` and `plots.diagram` draw the results.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float

from . import planar
from ._base.checks import finite, instance, names_of, positive, where_valid
from ._base.refusals import refuse
from ._base.statistics import wilson
from ._base.types import Equation, Outcome, Stop
from ._maps.basin import Basin
from ._maps.grids import Grid, Sample
from ._maps.sweep import sweep
from .equations._common import shape_parameter
from .equations.levels import Level
from .equations.transverse import equation_at
from .stability import spectrum, threshold

Levels = str | Sequence[str]
Values = ArrayLike | Sequence[ArrayLike]
Parameter = Literal["delta", "amplitude"]

USUAL = (Level.ORDER_1, Level.SEMI)
DEFAULT_W = 0.05
"""Angular velocity w at which stability is computed by default; λ/w² hardly depends on w."""
STEPS = 16
"""Number of steps between neighbouring values of δ, to resolve crossings of eigenvalues."""


class Fractions(NamedTuple):
    """Shares of the starts, with 95 % intervals (Wilson)."""

    share: Float[np.ndarray, "*levels values"]
    low: Float[np.ndarray, "*levels values"]
    high: Float[np.ndarray, "*levels values"]


@dataclass(frozen=True, repr=False)
class Continuation:
    """Outcomes of the same starts at every value of a parameter, level by level.

    Attributes:
        parameter: the parameter that is varied, "delta" or "amplitude".
        levels: the levels of the equation.
        basins: the outcomes at each level, over the axes (delta, amplitude, direction).

    Properties: `values`, the values of the parameter, and `n`, the number of starts at each value.
    """

    parameter: Parameter
    levels: tuple[Level, ...]
    basins: tuple[Basin, ...]

    @property
    def values(self) -> Float[np.ndarray, "values"]:
        """The increasing values of the parameter."""
        return self.basins[0].coords[self.parameter]

    @property
    def n(self) -> int:
        """The number of starts at each value."""
        return self.basins[0].shape[-1]

    def __repr__(self) -> str:
        shares, values = self.fractions(Outcome.RESIDUAL).share, self.values
        head = f"Continuation({self.parameter} from {values[0]:g} to {values[-1]:g}, "
        head += f"{len(values)} values, {self.n} starts at each; share of residual rotation:"
        lines = [
            f"  {level}: from {share[0]:.4g} to {share[-1]:.4g}, at most {max(share):.4g}"
            for level, share in zip(self.levels, shares, strict=True)
        ]
        return "\n".join([head, *lines]) + ")"

    def fractions(self, outcome: Outcome, stop: Stop | None = None) -> Fractions:
        """Return the shares of the starts with an outcome, with 95 % intervals (Wilson).

        Args:
            outcome: any member of `Outcome`, including UNDECIDED and FAILED.
            stop: a member of `Stop`, to count only this way of stopping.

        Returns:
            Arrays of shape (levels, values). An interval holds for a single value; differences
            between values or levels are known much better, since the starts are the same.
        """
        members = [
            (basin.outcome == outcome) & (stop is None or basin.stop == stop)
            for basin in self.basins
        ]
        counts = np.stack([np.sum(each, axis=-1).ravel() for each in members])
        return Fractions(counts / self.n, *wilson(counts, self.n))


def continuation(
    delta: Values,
    amplitude: Values = 0.2,
    *,
    levels: Levels = USUAL,
    n: int = 4000,
    seed: int = 0,
    **settings: Any,
) -> Continuation:
    """Compute the share of every outcome against δ at fixed |ω₀|, or against |ω₀| at fixed δ.

    The starts are |ω₀| times the same n random directions at every value and level, from
    `Sample(n, amplitude, seed=seed)`. The full level is far slower than the others: use n = 50 and
    a few values for it, in a separate call.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1); one, or increasing values of shape (values,).
        amplitude: |ω₀| > 0, dimensionless; one, or increasing values of shape (values,). Exactly
            one of the two must be a list, the parameter that is varied.
        levels: some of order-1 … order-4, semi, full.
        n: number of starts; the half-width of a 95 % interval is then at most 1/√n.
        seed: a whole number.
        settings: settings of `sweep`, such as `rtol` or `max_steps`, except `store`.

    Returns:
        A `Continuation`.

    Raises:
        ValueError: bad arguments.

    Source: section 4.2: at order 1 all stop below δ = −1/2, and none above δ = 0.

    Example:
        >>> from dipoletop import Outcome
        >>> from dipoletop.continuation import continuation
        >>> shapes = continuation([-0.7, -0.2, 0.2], levels="order-1", n=1000)
        >>> residual = shapes.fractions(Outcome.RESIDUAL)
        >>> [share in (0, 1) for share in residual.share[0].tolist()]
        [True, False, True]
        >>> bool(residual.low[0, 1] < 0.52 < residual.high[0, 1])
        True
    """
    chosen = _chosen(levels)
    axes = {"delta": shape_parameter(delta), "amplitude": positive("amplitude", amplitude)}
    varied: list[Any] = [name for name, values in axes.items() if values.ndim]
    if len(varied) != 1:
        was = "both are lists" if varied else "both are single numbers"
        refuse("delta", "be a list of values, or else `amplitude`", was)
    (parameter,) = varied
    _check_rising(parameter, axes[parameter])
    grid = Grid(**axes, direction=Sample(n, 1.0, seed=seed).points(np.arange(n)))

    def outcomes(level: Level) -> Basin:
        def problem(delta: Array, amplitude: Array, direction: Array) -> tuple[Equation, Array]:
            return equation_at(level, delta), amplitude * direction

        return sweep(problem, grid, **{"value": False, **settings})

    return Continuation(parameter, chosen, tuple(outcomes(level) for level in chosen))


class Branches(NamedTuple):
    """Eigenvalues λ(δ) of slow perturbations of the residual line {w, 0, 0}."""

    levels: tuple[Level, ...]
    delta: Float[np.ndarray, "values"]
    w: float
    slow: Complex[np.ndarray, "levels 2 values"]
    """Two continuous branches, in units of 1/τ₀."""
    growth: Float[np.ndarray, "levels values"]
    """The larger real part."""
    stable: Bool[np.ndarray, "levels values"]
    """Whether the line attracts: growth < 0."""

    def __repr__(self) -> str:
        n, first, last = len(self.delta), self.delta[0], self.delta[-1]
        head = f"Branches(delta from {first:g} to {last:g}, {n} values, w = {self.w:g}; "
        lines = [
            f"  {level}: from {min(growth):.4g} to {max(growth):.4g}, stable at {sum(growth < 0)}"
            for level, growth in zip(self.levels, self.growth / self.w**2, strict=True)
        ]
        return "\n".join([f"{head}largest Re λ/w²:", *lines]) + ")"


def follow_spectrum(delta: Values, w: ArrayLike = DEFAULT_W, *, levels: Levels = USUAL) -> Branches:
    """Compute eigenvalues λ(δ) of perturbations of {w, 0, 0} as continuous branches.

    These equilibria, the residual line, exist at every δ and level. A branch goes straight through
    a crossing; where a real pair becomes complex, its signs are assigned arbitrarily.

    Args:
        delta: increasing values of the shape δ in [−1, 1), shape (values,).
        w: the angular velocity along the dipole, dimensionless, not 0.
        levels: some of order-1 … order-4, semi, full.

    Returns:
        The `Branches`.

    Raises:
        ValueError: bad arguments.

    Source: (4.22)–(4.24) at order 1.

    Example:
        At order 1 they are −(1+2δ)/(1−δ) w² and −w², which cross at δ = 0.

        >>> from dipoletop.continuation import follow_spectrum
        >>> branches = follow_spectrum([-0.6, -0.25, 0.5], w=0.1, levels="order-1")
        >>> branches.slow[0].real.round(6).tolist()
        [[0.00125, -0.004, -0.04], [-0.01, -0.01, -0.01]]
        >>> branches.stable.tolist()
        [[False, True, True]]
    """
    chosen = _chosen(levels)
    deltas, w = shape_parameter(delta), finite("w", w, batch=False)
    where_valid("w", w, w != 0, "not be 0")
    _check_rising("delta", deltas)
    places = np.arange(STEPS * (len(deltas) - 1) + 1) / STEPS
    fine = np.interp(places, np.arange(len(deltas)), deltas)
    equilibrium = jnp.stack([w, jnp.zeros_like(w), jnp.zeros_like(w)])
    spectra = [
        jax.vmap(lambda d, level=level: spectrum(equation_at(level, d), equilibrium))(fine)
        for level in chosen
    ]
    slow = np.stack([_continuous(fine, np.asarray(each.slow[:, 1:])) for each in spectra])
    growth = np.stack([each.growth for each in spectra])
    slow, growth = slow[..., ::STEPS], growth[:, ::STEPS]
    return Branches(chosen, np.asarray(deltas), float(w), slow, growth, growth < 0)


def _continuous(
    x: Float[np.ndarray, "d"], pairs: Complex[np.ndarray, "d 2"]
) -> Complex[np.ndarray, "2 d"]:
    """Return the pairs ordered so that each continues the line through the last two values."""
    tracked = np.array(pairs)
    for k in range(2, len(x)):
        slope = (tracked[k - 1] - tracked[k - 2]) / (x[k - 1] - x[k - 2])
        expected = tracked[k - 1] + slope * (x[k] - x[k - 1])
        swapped = pairs[k][::-1]
        if np.sum(np.abs(swapped - expected)) < np.sum(np.abs(pairs[k] - expected)):
            tracked[k] = swapped
    return tracked.T


class Threshold(NamedTuple):
    """A δ at which an outcome appears or disappears, by the theory and by the sample."""

    level: Level
    event: str
    outcome: Outcome
    """The outcome that occurs only on one side of δ."""
    delta: float
    """δ by the theory."""
    bracket: tuple[float, float]
    """Neighbouring values of the sample, one with the outcome and one without; NaN if none."""
    hidden: float
    """Upper 95 % limit of the share of an outcome that no start of the sample has."""

    def __repr__(self) -> str:
        low, high = self.bracket
        return (
            f"Threshold({self.level}: {self.event} at delta = {self.delta:.6g}; "
            f"{self.outcome.name} in the sample changes between {low:g} and {high:g}, "
            f"hidden below a share of {self.hidden:.2g})"
        )


def thresholds(continuation: Continuation, w: ArrayLike = DEFAULT_W) -> list[Threshold]:
    """Return the δ at which an outcome appears or disappears, by the theory and by the sample.

    | event | δ |
    |---|---|
    | line changes stability | order 1: −1/2; orders 2–4: where w ≪ 1 − δ fails; others: none |
    | stops end | 0, where precession changes its sense |
    | wobbling stops begin | δ_c2 = 0.7532… (`planar.critical_delta`); order 1: none |

    The line is the residual line {w, 0, 0}. A share that grows continuously from 0 is invisible in
    the sample while it is below `hidden`; then both ends of the bracket lie on the side of δ where
    the outcome occurs. At δ_c2 the share jumps, and the bracket contains δ.

    Args:
        continuation: a continuation in delta.
        w: the angular velocity along the dipole at which stability is computed.

    Returns:
        Every `Threshold` inside the range of δ.

    Raises:
        ValueError: a continuation in amplitude, or a bad w.

    Example:
        >>> from dipoletop.continuation import continuation, thresholds
        >>> shapes = continuation([-0.7, -0.55, -0.4, -0.25], levels="order-1", n=1000)
        >>> for t in thresholds(shapes):
        ...     print(f"{t.event}: {t.delta:.6f}; by the sample {t.bracket}, {t.hidden:.4f} hidden")
        line changes stability: -0.500000; by the sample (-0.55, -0.4), 0.0038 hidden
    """
    instance("continuation", continuation, Continuation)
    if continuation.parameter != "delta":
        refuse("continuation", "be a continuation in delta", "is one in amplitude")
    values, levels = continuation.values, continuation.levels
    branches = follow_spectrum(values, w, levels=levels)
    hidden = float(wilson(np.zeros((), int), continuation.n)[1])
    rows = []
    for k, level in enumerate(levels):
        for event, outcome, delta in _events(level, branches, branches.stable[k]):
            if values[0] < delta < values[-1]:
                absent = continuation.fractions(outcome).share[k] == 0
                bracket = _nearest_change(values, absent, delta)
                rows.append(Threshold(level, event, outcome, delta, bracket, hidden))
    return rows


def _events(
    level: Level, branches: Branches, stable: Bool[np.ndarray, "values"]
) -> Iterator[tuple[str, Outcome, float]]:
    """Yield name, outcome and δ of every event at a level, by the theory."""
    yield "stops end", Outcome.STOP, 0.0
    if level.consistent:
        yield "wobbling stops begin", Outcome.STOP, planar.critical_delta()
    for k in np.flatnonzero(np.diff(stable)):
        low, high = branches.delta[k : k + 2]
        # The root may equal a value of the grid up to rounding, so extend the bracket a little.
        margin = (high - low) / 1000
        low, high = np.clip([low - margin, high + margin], *branches.delta[[0, -1]]).tolist()
        delta = threshold(lambda d: equation_at(level, d), branches.w, low, high)
        yield "line changes stability", Outcome.RESIDUAL, delta


def _nearest_change(
    x: Float[np.ndarray, "v"], flags: Bool[np.ndarray, "v"], delta: float
) -> tuple[float, float]:
    """Return the neighbouring values nearest to δ between which the flag changes."""
    changes = np.flatnonzero(np.diff(flags)).tolist()
    if not changes:
        return float("nan"), float("nan")
    k = min(changes, key=lambda k: abs(x[k] + x[k + 1] - 2 * delta))
    return float(x[k]), float(x[k + 1])


def _chosen(levels: Levels) -> tuple[Level, ...]:
    """Return one level or several as a tuple, each once."""
    chosen = names_of("levels", levels)
    if not chosen or len(set(chosen)) < len(chosen) or not set(chosen) <= set(Level):
        refuse("levels", f"name some of {', '.join(Level)}, each once", f"is {levels!r}")
    return tuple(map(Level, chosen))


def _check_rising(name: str, values: Float[Array, "..."]) -> None:
    if values.size < 2 or not np.all(np.diff(values) > 0):
        refuse(name, "hold two or more values that rise", f"is {np.asarray(values).tolist()}")
