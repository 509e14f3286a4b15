"""Outcomes and stability followed through the shape δ, or through the amplitude |ω₀|.

Which share of the starts comes to a residual rotation, and where does it leave 0 or reach 1? The
same isotropic starts are taken at every value and at every level of the equation (common random
numbers), so that curves differ by physics, not by chance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from . import planar
from ._base.checks import finite, instance, refuse, where_valid
from ._base.statistics import wilson
from ._base.types import Outcome, Stop
from ._maps.basin import Basin
from ._maps.grids import Grid, Sample
from ._maps.sweep import sweep
from .equations._common import shape_parameter
from .equations.levels import Level
from .equations.transverse import equation_at
from .stability import Spectrum, spectrum, threshold

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

COLOURS = ("#d55e00", "#8fd1bb", "#009e73", "#cc79a7", "#0072b2", "#f0c419")
WIDTHS = (1.6, 3.6, 2.4, 1.4, 1.4, 1.4)
USUAL = ("order-1", "semi")
LINE = 0.05  # w at which the stability of the residual line is asked for; λ/w² hardly depends on it
Levels = str | Sequence[str]
STEPS = 16  # between neighbouring values, to tell a crossing of eigenvalues from a repulsion


class Fractions(NamedTuple):
    """Shares of the starts, with 95 % intervals (Wilson)."""

    share: Float[np.ndarray, "*levels values"]
    low: Float[np.ndarray, "*levels values"]
    high: Float[np.ndarray, "*levels values"]


@dataclass(frozen=True)
class Continuation:
    """Outcomes of the same starts at every value of a parameter, level by level.

    Attributes:
        parameter: what is varied, "delta" or "amplitude".
        levels: names of the levels.
        basins: the outcomes at each level, over the axes (delta, amplitude, direction).
    """

    parameter: str
    levels: tuple[str, ...]
    basins: tuple[Basin, ...]

    @property
    def values(self) -> Float[np.ndarray, "values"]:
        """The values of the parameter, rising."""
        return self.basins[0].coords[self.parameter]

    @property
    def n(self) -> int:
        """The number of starts at each value."""
        return self.basins[0].shape[-1]

    def fractions(self, outcome: Outcome, stop: Stop | None = None) -> Fractions:
        """The share of the starts that end so, with 95 % intervals (Wilson).

        Args:
            outcome: a member of `Outcome`; UNDECIDED and FAILED too.
            stop: a member of `Stop`, to count only this way of stopping.

        Returns:
            Arrays of shape (levels, values). The intervals are those of each value by itself;
            differences between values or levels are much more certain, the starts being the same.
        """

        def count(basin: Basin) -> Int[np.ndarray, "values"]:
            here = (basin.outcome == outcome) & (stop is None or basin.stop == stop)
            return np.sum(here, axis=-1).ravel()

        counts = np.stack([count(basin) for basin in self.basins])
        return Fractions(counts / self.n, *wilson(counts, self.n))

    def plot(self, ax: "matplotlib.axes.Axes | None" = None) -> "matplotlib.axes.Axes":
        """Shares of residual rotation, 95 % bands, thresholds; hatched where not decided."""
        import matplotlib.pyplot as plt

        from .plots import basins
        from .plots import plane as _maps

        if ax is None:
            _, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
        x, residual = self.values, self.fractions(Outcome.RESIDUAL)
        most = 1 - self.fractions(Outcome.STOP).share
        for k, basin in enumerate(self.basins):
            style, (share, low, high) = _style(self.levels[k]), (part[k] for part in residual)
            known, colour = most[k] - share <= high - low, style["color"]
            ax.plot(x, np.where(known, share, np.nan), label=_maps.sentence(basin.level), **style)
            ax.fill_between(x, low, high, where=known, color=colour, alpha=0.3, lw=0)
            ax.fill_between(x, share, most[k], fc="none", ec=colour, hatch=basins.HATCH, lw=0)
        (fixed,) = {"delta", "amplitude"} - {self.parameter}
        at = f"{_maps.SYMBOLS[fixed]} = ${self.basins[0].coords[fixed][0]:g}$"
        ax.set_title(f"{self.n} isotropic starts at each value, {at}", fontsize="medium")
        ax.set(xlim=x[[0, -1]], xlabel=_maps.SYMBOLS[self.parameter])
        ax.set(ylim=(-0.02, 1.02), ylabel="share of residual rotation")
        if self.parameter == "delta":
            _mark(ax, thresholds(self))
        elif basins._scale(x) == "log":
            ax.set_xscale("log")
        ax.legend(frameon=True, framealpha=1, edgecolor="none")
        return ax


def continuation(
    delta: Any,
    amplitude: Any = 0.2,
    *,
    levels: Levels = USUAL,
    n: int = 4000,
    seed: int = 0,
    **settings: Any,
) -> Continuation:
    """Share of every outcome against δ at fixed |ω₀|, or against |ω₀| at fixed δ, level by level.

    The starts are |ω₀| times the same n random directions at every value and level: those of
    `Sample(n, amplitude, seed=seed)`. The full level is far slower than the others: take
    n = 50 and a few values there, in a call of its own.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1); rising values of shape (values,), or one.
        amplitude: |ω₀| > 0, dimensionless; one, or rising values of shape (values,). Exactly one
            of the two is a list: it is the parameter that is varied.
        levels: some of order-1 … order-4, semi, full.
        n: how many starts; a 95 % interval then reaches ±1/√n at most.
        seed: a whole number.
        settings: those of `sweep`, such as `rtol` or `max_steps`; but no `store`.

    Returns:
        A `Continuation`.

    Raises:
        ValueError: bad arguments.

    Source: section 4.2: at order 1 all stop below δ = −1/2, and none above δ = 0.

    Example:
        >>> from dipoletop import Outcome
        >>> from dipoletop.continuation import continuation
        >>> found = continuation([-0.7, -0.2, 0.2], levels="order-1", n=1000)
        >>> residual = found.fractions(Outcome.RESIDUAL)
        >>> [share in (0, 1) for share in residual.share[0].tolist()]
        [True, False, True]
        >>> bool(residual.low[0, 1] < 0.52 < residual.high[0, 1])
        True
    """
    chosen = _chosen(levels)
    axes = {"delta": shape_parameter(delta), "amplitude": finite("amplitude", amplitude)}
    where_valid("amplitude", axes["amplitude"], axes["amplitude"] > 0, "be positive")
    lists = [name for name, values in axes.items() if values.ndim]
    if len(lists) != 1:
        was = "both are lists" if lists else "both are single numbers"
        refuse("delta", "be a list of values, or else `amplitude`", was)
    _check_rising(lists[0], axes[lists[0]])
    grid = Grid(**axes, direction=Sample(n, 1.0, seed=seed).points(np.arange(n)))

    def outcomes(level: str) -> Basin:
        def problem(delta: Array, amplitude: Array, direction: Array) -> tuple[Any, Array]:
            return equation_at(level, delta), amplitude * direction

        return sweep(problem, grid, **{"value": False, **settings})

    return Continuation(lists[0], chosen, tuple(outcomes(level) for level in chosen))


class Branches(NamedTuple):
    """Eigenvalues of the slow motions beside the line of residual rotation {w, 0, 0}, against δ."""

    levels: tuple[str, ...]
    delta: Float[np.ndarray, "values"]
    w: float
    slow: Complex[np.ndarray, "levels 2 values"]
    """Two continuous branches, in units of 1/τ₀."""
    growth: Float[np.ndarray, "levels values"]
    """The larger real part."""
    stable: Bool[np.ndarray, "levels values"]
    """Whether the line attracts: growth < 0."""


def follow_spectrum(delta: Any, w: Any = LINE, *, levels: Levels = USUAL) -> Branches:
    """The eigenvalues λ(δ) of motions beside the equilibria {w, 0, 0}, as continuous branches.

    The line itself is there at every δ and level. A branch goes straight through a crossing; where
    a real pair becomes a complex one, either may go on as either.

    Args:
        delta: rising values of the shape δ in [−1, 1), shape (values,).
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
        >>> found = follow_spectrum([-0.6, -0.25, 0.5], w=0.1, levels="order-1")
        >>> found.slow[0].real.round(6).tolist()
        [[0.00125, -0.004, -0.04], [-0.01, -0.01, -0.01]]
        >>> found.stable.tolist()
        [[False, True, True]]
    """
    chosen = _chosen(levels)
    deltas, w = shape_parameter(delta), finite("w", w, batch=False)
    where_valid("w", w, w != 0, "not be 0")
    _check_rising("delta", deltas)
    at = np.arange(STEPS * (len(deltas) - 1) + 1) / STEPS
    fine = np.interp(at, np.arange(len(deltas)), deltas)
    line = jnp.stack([w, jnp.zeros_like(w), jnp.zeros_like(w)])

    def spectra(level: str) -> Spectrum:
        return jax.vmap(lambda d: spectrum(equation_at(level, d), line))(jnp.asarray(fine))

    found = [spectra(level) for level in chosen]
    slow = np.stack([_continuous(fine, np.asarray(one.slow[:, 1:])) for one in found])
    slow, growth = slow[..., ::STEPS], np.stack([one.growth for one in found])[:, ::STEPS]
    return Branches(chosen, np.asarray(deltas), float(w), slow, growth, growth < 0)


def _continuous(x: Float[Any, "d"], pairs: Complex[Any, "d 2"]) -> Complex[np.ndarray, "2 d"]:
    """Each next pair in the order that is nearer to the straight line through the last two."""
    tracked = np.array(pairs)
    for k in range(2, len(x)):
        slope = (tracked[k - 1] - tracked[k - 2]) / (x[k - 1] - x[k - 2])
        ahead = tracked[k - 1] + slope * (x[k] - x[k - 1])
        as_is, swapped = (np.sum(np.abs(pair - ahead)) for pair in (pairs[k], pairs[k][::-1]))
        if swapped < as_is:
            tracked[k] = pairs[k][::-1]
    return tracked.T


class Threshold(NamedTuple):
    """A δ at which an outcome sets in or dies out: by theory, and by the sample."""

    level: str
    event: str
    outcome: Outcome
    """The outcome that occurs on one side only."""
    delta: float
    """The δ of the theory."""
    bracket: tuple[float, float]
    """By the sample: neighbouring values, one with the outcome and one without, or NaN."""
    hidden: float
    """The largest share of the outcome where the sample has none (95 %)."""


def thresholds(found: Continuation, w: Any = LINE) -> list[Threshold]:
    """Where the residual fraction leaves 0 or reaches 1: roots of the theory beside the sample.

    The line {w, 0, 0} changes its stability (order 1: at δ = −1/2; semi-reduced and full: never;
    orders 2–4: where w is no more well below 1 − δ). Stops end at δ = 0, where precession changes
    its sense. Wobbling stops begin at δ_c2 = 0.7532… (`planar.critical_delta`), not at order 1.

    The interval of a fraction excludes 0 as soon as one start has the outcome. One that grows
    continuously from 0 may stay unseen below `hidden`: then the bracket lies beside δ, where the
    outcome occurs. At δ_c2 it jumps, and the bracket holds δ.

    Args:
        found: a continuation in delta.
        w: the angular velocity along the dipole at which the stability is asked for.

    Returns:
        Every `Threshold` inside the range of δ.

    Raises:
        ValueError: a continuation in amplitude, or a bad w.

    Example:
        >>> from dipoletop.continuation import continuation, thresholds
        >>> found = continuation([-0.7, -0.55, -0.4, -0.25], levels="order-1", n=1000)
        >>> for t in thresholds(found):
        ...     print(f"{t.event}: {t.delta:.6f}; by the sample {t.bracket}, {t.hidden:.4f} hidden")
        line changes stability: -0.500000; by the sample (-0.55, -0.4), 0.0038 hidden
    """
    instance("found", found, Continuation)
    if found.parameter != "delta":
        refuse("found", "be a continuation in delta", "is one in amplitude")
    branches, values = follow_spectrum(found.values, w, levels=found.levels), found.values
    hidden = float(wilson(np.zeros((), int), found.n)[1])
    rows = []
    for k, level in enumerate(found.levels):
        for event, outcome, delta in _events(level, branches, k):
            if values[0] < delta < values[-1]:
                bracket = _change(values, found.fractions(outcome).share[k] == 0, delta)
                rows.append(Threshold(level, event, outcome, delta, bracket, hidden))
    return rows


def _events(level: str, branches: Branches, k: int) -> list[tuple[str, Outcome, float]]:
    """What is known to happen at which δ."""
    events = [("stops end", Outcome.STOP, 0.0)]
    if level != "order-1":
        events.append(("wobbling stops begin", Outcome.STOP, planar.critical_delta()))
    for at in np.flatnonzero(np.diff(branches.stable[k])):
        low, high = branches.delta[at : at + 2]
        beyond = (high - low) / 1000  # one of them may be the root, but for rounding
        low, high = np.clip([low - beyond, high + beyond], *branches.delta[[0, -1]]).tolist()
        delta = threshold(lambda d: equation_at(level, d), branches.w, low, high)
        events.append(("line changes stability", Outcome.RESIDUAL, delta))
    return events


def _change(x: Float[Any, "v"], flags: Bool[Any, "v"], delta: float) -> tuple[float, float]:
    """The two neighbouring values, nearest to δ, between which the flag changes."""
    changes = np.flatnonzero(np.diff(flags)).tolist()
    if not changes:
        return float("nan"), float("nan")
    at = min(changes, key=lambda k: abs(x[k] + x[k + 1] - 2 * delta))
    return float(x[at]), float(x[at + 1])


def diagram(found: Continuation, w: Any = LINE) -> "matplotlib.figure.Figure":
    """Shares of residual rotation above, growth rates beside it below, over a common axis δ.

    Args:
        found: a continuation in delta.
        w: the angular velocity along the dipole of the lower panel.

    Returns:
        The figure; `figures.save` writes it.

    Raises:
        ValueError: a continuation in amplitude, or a bad w.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from .paper import figures

    marks, fine = thresholds(found, w), np.linspace(found.values[0], found.values[-1], 200)
    branches = follow_spectrum(fine, w, levels=found.levels)
    with mpl.rc_context(figures.STYLE):
        figure = Figure((figures.WIDE, 120 * figures.MM), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.3, 1])
        found.plot(above).set_xlabel("")
        for level, slow in zip(branches.levels, branches.slow, strict=True):
            below.plot(branches.delta, np.real(slow).T / branches.w**2, **_style(level))
        below.axhspan(0, 1, color="0.93", lw=0, zorder=0)
        below.text(0.99, 0.97, "growing", transform=below.transAxes, ha="right", va="top")
        below.set(ylim=(-4, 1), xlabel=r"$\delta = 1 - I_3/I_1$", ylabel=r"Re $\lambda/w^2$")
        below.set_title(rf"Beside the residual rotation $\{{w, 0, 0\}}$, $w$ = {branches.w:g}")
        _mark(below, marks, label=False)
    return figure


def _style(level: str) -> dict[str, Any]:
    """A curve: where levels coincide, the thin one of a later level lies on the wide one."""
    k, dash = list(Level).index(Level(level)), (0, (4, 3)) if level == "full" else "-"
    return {"color": COLOURS[k], "lw": WIDTHS[k], "ls": dash}


def _mark(ax: "matplotlib.axes.Axes", marks: list[Threshold], label: bool = True) -> None:
    """A line at every δ where something happens at any level."""
    places = sorted({round(mark.delta, 9) for mark in marks})
    for delta in places:
        ax.axvline(delta, color="0.4", lw=0.8, ls=(0, (4, 2)), zorder=0)
    if label:
        ax.secondary_xaxis("top").set_xticks(places, [f"${delta:.4g}$" for delta in places])


def _chosen(levels: Levels) -> tuple[str, ...]:
    several = tuple(levels) if isinstance(levels, Iterable) else ()
    chosen = (levels,) if isinstance(levels, str) else several
    if not chosen or len(set(chosen)) < len(chosen) or not set(chosen) <= set(Level):
        refuse("levels", f"name some of {', '.join(Level)}, each once", f"is {levels!r}")
    return chosen


def _check_rising(name: str, values: Float[Array, "..."]) -> None:
    if values.size < 2 or not np.all(np.diff(values) > 0):
        refuse(name, "hold two or more values that rise", f"is {np.asarray(values).tolist()}")
