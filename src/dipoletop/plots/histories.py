"""The history of a prediction: E, L and the shape of the rotation against time."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._base.checks import ArrayLike, finite, instance
from .._base.refusals import refuse
from .._base.types import Outcome
from ..prediction import Prediction
from .axes import several_axes
from .style import BLACK, BLUE, GREEN, MM, ORANGE, STYLE, percent

YEAR = 365.25 * 24 * 3600
"""Length of a year in seconds."""
WIDTH, HEIGHT = 120 * MM, 125 * MM
FLOOR = 1e-9
"""Least relative E and L shown."""
KNOWN = 0.95
"""Least share of starts with a known value at the times where quantiles are drawn."""
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The quantiles over many starts: two bands and the median."""
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
    ones = (jax.tree.map(lambda leaf, k=k: leaf[k], predictions) for k in range(len(given)))
    histories = [one.history(jnp.asarray(times)) for one in ones]
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


def times_for(predictions: Prediction) -> Float[np.ndarray, "T"]:
    """Return times from long before the first change to long after the last one."""
    half_times, lifetimes = np.asarray(predictions.half_time), np.asarray(predictions.lifetime)
    known = half_times[np.isfinite(half_times) & (half_times > 0)]
    if not known.size:
        # For a rotation that never changes, or is captured first, use the time scale of braking,
        # I/(κΩ²), with the trace of the inertia tensor for I.
        given = np.asarray(predictions.variables)[0]
        dipole, omega = given[9:12], given[12:]
        kappa = predictions.strength * (dipole @ dipole)
        known = np.array([np.trace(given[:9].reshape(3, 3)) / kappa / (omega @ omega)])
    first, last = BEFORE * np.min(known), AFTER * np.max(known)
    decays = lifetimes[np.isfinite(lifetimes) & (lifetimes > 0)]
    if decays.size:
        last = max(last, AFTER * np.max(decays))
    return np.geomspace(first, min(last, WIDEST * first), POINTS)


def history(
    prediction: Prediction,
    *,
    times: ArrayLike | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Plot predicted E/E₀, |L|/L₀ and hJ₃ = 2EJ₃/L² against time, on logarithmic scales.

    One rotation is drawn as a curve. A batch, for example over directions of L, is drawn as the
    median and the bands from 5 to 95 % and from 25 to 75 % at each time. The dotted line marks the
    (median) half time. A curve ends where an exactly axisymmetric needle is captured by chance; the
    curves of a batch end where this has happened to 5 % of it.

    Args:
        prediction: the result of `predict`, or a batch of results for one body, such as from
            `jax.vmap(predict, (None, 0))`.
        times: positive times, shape (T,), in seconds for a `Particle`; None chooses them.
        axes: three axes to draw on, for E, L and h; None makes a figure.

    Returns:
        The figure; `plots.save` writes it.

    Raises:
        ValueError: an argument that is not a prediction, or one that failed; bad times; not three
            axes.

    Example:
        >>> import dipoletop as dt
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [0, 0, 1])
        >>> figure = history(dt.predict(body, [1e-20, 2e-20, 3e-20]))
        >>> figure.axes[0].get_ylabel()
        '$E/E_0$'
    """
    instance("prediction", prediction, Prediction)
    if prediction.outcome.ndim > 1:
        refuse("prediction", "have one batch axis at most", f"has {prediction.outcome.ndim}")
    batch = prediction
    if prediction.outcome.ndim == 0:
        batch = jax.tree.map(lambda leaf: leaf[None], prediction)
    if np.any(np.asarray(batch.outcome) == Outcome.FAILED):
        refuse("prediction", "not be FAILED", "is")
    given = None
    if times is not None:
        given = np.asarray(finite("times", times, (-1,), batch=False))
        if given.size < 2 or not (np.all(np.diff(given) > 0) and given[0] > 0):
            refuse("times", "be positive and rising", "are not")
    panels = None if axes is None else several_axes(axes, 3, "be three axes, or None")
    curves = curves_of(batch, given)
    with mpl.rc_context(STYLE):
        if panels is None:
            figure = Figure((WIDTH, HEIGHT), layout="constrained")
            panels = list(figure.subplots(3, 1, sharex=True))
        _draw(panels, curves, batch.strength != 1.0)
        panels[0].set_title(_title(batch))
    figure: Any = panels[0].figure
    return figure


def _draw(panels: list[Axes], curves: Curves, in_seconds: bool) -> None:
    """Draw the curves, axes and marks of the three panels."""
    rows = zip(
        panels,
        (curves.energy, curves.momentum, curves.shape),
        (r"$E/E_0$", r"$|L|/L_0$", r"$2EJ_3/L^2$"),
        (ORANGE, BLUE, GREEN),
        strict=True,
    )
    for ax, values, label, colour in rows:
        least = _curve(ax, curves.times, values, colour)
        ax.set(xscale="log", xlim=curves.times[[0, -1]], ylabel=label)
        if np.isfinite(curves.half_time):
            ax.axvline(curves.half_time, color="0.45", lw=0.8, ls=":", zorder=0)
        if ax is not panels[2]:
            _relative_scale(ax, least)
    _mark_axes(panels[2], curves)
    if len(curves.shape) > 1:
        panels[1].legend(loc="lower left")
    if np.isfinite(curves.half_time):
        panels[0].text(
            curves.half_time, 0.04, r" $t_{1/2}$", transform=panels[0].get_xaxis_transform()
        )
    panels[2].set_xlabel("time $t$ (s)" if in_seconds else r"time $\tau = t/\tau_0$")
    if in_seconds:
        in_years: Any = (lambda t: t / YEAR, lambda t: t * YEAR)
        years = panels[0].secondary_xaxis("top", functions=in_years)
        years.set_xlabel("time (years)")


def _curve(
    ax: Axes, times: Float[np.ndarray, "T"], values: Float[np.ndarray, "N T"], colour: str
) -> float:
    """Draw one curve, or the bands and the median of many; return the least value drawn."""
    known = np.mean(np.isfinite(values), axis=0) > KNOWN
    times, values = times[known], values[:, known]
    if not times.size:
        return 1.0
    if len(values) == 1:
        ax.plot(times, values[0], color=colour)
        if not known[-1]:
            ax.plot(times[-1], values[0, -1], ".", color=colour)
        return float(np.min(values))
    low, first, middle, third, high = np.nanquantile(values, LEVELS, axis=0)
    ax.plot(times, middle, color=colour, label="median")
    ax.fill_between(times, first, third, color=colour, alpha=0.35, lw=0, label="25 – 75 %")
    ax.fill_between(times, low, high, color=colour, alpha=0.18, lw=0, label="5 – 95 %")
    return float(np.min(low))


def _relative_scale(ax: Axes, least: float) -> None:
    """Set a logarithmic scale from the least value to 1, with plain numbers if it is short."""
    least = min(max(least, FLOOR), 0.9)
    ax.set(yscale="log", ylim=(least**1.12, least**-0.07))
    if least > 0.05:
        ticks = [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1] if least < 0.6 else [0.6, 0.7, 0.8, 0.9, 1]
        shown = [tick for tick in ticks if tick > least**1.12]
        ax.set_yticks(shown, [f"{tick:g}" for tick in shown])
        ax.minorticks_off()


def _mark_axes(ax: Axes, curves: Curves) -> None:
    """Mark the values of h in rotation about the principal axes, with names at the right."""
    low, middle, high = curves.ratios.tolist()
    if high - low < 1e-12:
        ax.set(ylim=(0.5, 1.5), yticks=[1.0])
        names, gaps, span = {low: "sphere"}, np.zeros(2), 1.0
    else:
        span, margin = np.log(high), 0.06
        if high > 4:
            ax.set(yscale="log", ylim=(high**-margin, high ** (1 + margin)))
        else:
            span = high - low
            ax.set(ylim=(low - margin * span, high + margin * span))
        names = {low: "about $J_3$", high: "about $J_1$"}
        gaps = np.diff(np.log(curves.ratios) if high > 4 else curves.ratios)
        if np.all(gaps > 0.02 * span):
            names[middle] = "separatrix"
    for value in names:
        ax.axhline(value, color=BLACK, lw=0.6, ls=(0, (4, 3)), zorder=0)
    twin = ax.secondary_yaxis("right")
    twin.set_yticks(list(names), list(names.values()))
    twin.minorticks_off()
    # Each name is at its line; those of neighbouring lines are moved apart.
    below, above = gaps < 0.12 * span if len(names) == 3 else (False, False)
    places = {"about $J_3$": "top" if below else "center"}
    places["about $J_1$"] = "bottom" if above else "center"
    places["separatrix"] = "top" if above else "bottom" if below else "center"
    for label in twin.get_yticklabels():
        label.set(va=places.get(label.get_text(), "center"))


def _title(predictions: Prediction) -> str:
    """Return the title: the outcome, or the shares of the outcomes of a batch."""
    outcomes = np.asarray(predictions.outcome)
    residual = float(np.mean(np.sum(np.asarray(predictions.probability)[:, :2], axis=1)))
    shares = [(percent(residual), "residual rotation"), (percent(1 - residual), "stop")]
    text = ", ".join(f"{share} {word}" for share, word in shares if share != "0 %")
    if outcomes.size > 1:
        return f"{outcomes.size} starts: {text}"
    outcome, ratio = Outcome(int(outcomes[0])), float(predictions.ratio[0])
    text = {Outcome.RESIDUAL: "Residual rotation", Outcome.STOP: "Stop"}.get(outcome, text)
    return text + (rf", $L_\infty/L_0 = {_number(ratio)}$" if ratio > 0 else "")


def _number(value: float) -> str:
    """Return a number with three digits, and a power of ten if it is small."""
    if value >= 1e-3:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"{mantissa}\times 10^{{{int(exponent)}}}"
