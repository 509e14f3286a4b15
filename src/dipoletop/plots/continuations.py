"""Continuations: shares of residual rotation, and growth rates, against δ or |ω₀|."""

from typing import Any

import matplotlib as mpl
import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.cbook import normalize_kwargs
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .._base.checks import instance
from .._base.types import Outcome
from ..continuation import DEFAULT_W, Continuation, Threshold, follow_spectrum, thresholds
from .axes import axes_or_new, spacing
from .style import HATCH, MM, STYLE, SYMBOLS, WIDE, capitalised, level_line


def continuation(continuation: Continuation, *, ax: Axes | None = None, **line: Any) -> Axes:
    """Plot shares of residual rotation against the parameter, with 95 % bands and thresholds.

    The hatched range, from the share of residual rotation to the share that does not stop, shows
    undecided and failed starts. A curve has a gap where this range is wider than its band.

    Args:
        continuation: a continuation in delta or in amplitude.
        ax: matplotlib axes to draw on; None makes a figure.
        line: keywords of `Axes.plot` for all curves.

    Returns:
        The axes; the title shows the number of starts and the fixed parameter.

    Raises:
        ValueError: an argument that is not a continuation, or not axes.
    """
    instance("continuation", continuation, Continuation)
    return _draw_shares(continuation, axes_or_new(ax), **normalize_kwargs(line, Line2D))


def diagram(continuation: Continuation, w: ArrayLike = DEFAULT_W) -> Figure:
    """Plot shares of residual rotation above growth rates beside it, over a common axis δ.

    Args:
        continuation: a continuation in delta.
        w: the angular velocity along the dipole for the lower panel.

    Returns:
        The figure; `plots.save` writes it.

    Raises:
        ValueError: a continuation in amplitude, or a bad w.
    """
    marks = thresholds(continuation, w)
    fine = np.linspace(continuation.values[0], continuation.values[-1], 200)
    branches = follow_spectrum(fine, w, levels=continuation.levels)
    with mpl.rc_context(STYLE):
        figure = Figure((WIDE, 120 * MM), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.3, 1])
        _draw_shares(continuation, above).set_xlabel("")
        for level, slow in zip(branches.levels, branches.slow, strict=True):
            below.plot(branches.delta, np.real(slow).T / branches.w**2, **level_line(level))
        below.axhspan(0, 1, color="0.93", lw=0, zorder=0)
        below.text(0.99, 0.97, "growing", transform=below.transAxes, ha="right", va="top")
        below.set(ylim=(-4, 1), xlabel=r"$\delta = 1 - I_3/I_1$", ylabel=r"Re $\lambda/w^2$")
        below.set_title(rf"Beside the residual rotation $\{{w, 0, 0\}}$, $w$ = {branches.w:g}")
        _mark(below, marks)
    return figure


def _draw_shares(continuation: Continuation, ax: Axes, **given: Any) -> Axes:
    """Draw the curves, bands, hatching, thresholds, title and legend of `continuation`."""
    x, residual = continuation.values, continuation.fractions(Outcome.RESIDUAL)
    most = 1 - continuation.fractions(Outcome.STOP).share
    for k, (level, basin) in enumerate(zip(continuation.levels, continuation.basins, strict=True)):
        share, low, high = residual.share[k], residual.low[k], residual.high[k]
        line: dict[str, Any] = {"label": capitalised(basin.level)}
        line |= normalize_kwargs(level_line(level), Line2D) | given
        known = most[k] - share <= high - low
        colour = line["color"]
        ax.plot(x, np.where(known, share, np.nan), **line)
        ax.fill_between(x, low, high, where=known, color=colour, alpha=0.3, lw=0)
        ax.fill_between(x, share, most[k], fc="none", ec=colour, hatch=HATCH, lw=0)
    (fixed,) = {"delta", "amplitude"} - {continuation.parameter}
    value = f"{SYMBOLS[fixed]} = ${continuation.basins[0].coords[fixed][0]:g}$"
    ax.set_title(f"{continuation.n} isotropic starts at each value, {value}", fontsize="medium")
    ax.set(xlim=x[[0, -1]], xlabel=SYMBOLS[continuation.parameter])
    ax.set(ylim=(-0.02, 1.02), ylabel="share of residual rotation")
    if continuation.parameter == "delta":
        places = _mark(ax, thresholds(continuation))
        ax.secondary_xaxis("top").set_xticks(places, [f"${delta:.4g}$" for delta in places])
    elif spacing(x) == "log":
        ax.set_xscale("log")
    ax.legend(frameon=True, framealpha=1, edgecolor="none")
    return ax


def _mark(ax: Axes, marks: list[Threshold]) -> list[float]:
    """Draw a vertical line at every δ that is a threshold at any level, and return these δ."""
    places = sorted({round(mark.delta, 9) for mark in marks})
    for delta in places:
        ax.axvline(delta, color="0.4", lw=0.8, ls=(0, (4, 2)), zorder=0)
    return places
