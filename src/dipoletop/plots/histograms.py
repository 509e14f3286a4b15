"""Histograms of the values of a sweep: from the starts of a basin, or from the bins of a tally."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from .._base.checks import instance
from .._base.refusals import refuse
from .._base.tolerances import budget
from .._base.types import Outcome, Stop
from .._maps.basin import Basin
from .._maps.grids import counted
from .._maps.tally_counts import MOTION
from .._maps.tally_results import Tally
from .axes import axes_or_new
from .column_shading import CERTIFIED, check_shade, scale_of
from .map_layout import CLASSES, fixed_values
from .style import capitalised, percent, symbol

SHOWN = {Outcome.RESIDUAL: "residual rotation", Outcome.STOP: "stop"}
COLOURS = {outcome: CLASSES[outcome, Stop.NONE][1] for outcome in SHOWN}


def histogram(
    found: Basin | Tally,
    column: str = "omega_inf",
    *,
    bins: int = 60,
    ax: Axes | None = None,
    **patch: Any,
) -> Axes:
    """Draw a histogram of ω∞, its error or its derivatives, or of the times or steps of runs.

    ω∞, its error and its derivatives are counted for residual starts only; times and steps for both
    outcomes, stacked.

    Args:
        found: a basin, or a tally with a histogram of this column, whose bins are used.
        column: "omega_inf", "time", "steps", "omega_inf_error", "d_omega_inf_d_delta", ….
        bins: number of bins; of equal width, or equal ratio for errors, times and steps.
        ax: matplotlib axes to draw on; None makes a figure.
        patch: keywords of `Axes.stairs`, such as `color` or `alpha`.

    Returns:
        The axes; the title shows the level and the share of each outcome.

    Raises:
        ValueError: a column without numbers, or without a value for any start.
    """
    instance("found", found, Basin | Tally, "be a Basin or a Tally")
    if isinstance(found, Tally):
        edges, counts = found.edges(column), {"": found.merged.histogram(column).ravel()}
    else:
        check_shade(column, found.columns, "column")
        edges, counts = _counted(found, column, budget("bins", bins))
    ax = axes_or_new(ax)
    below = np.zeros(len(edges) - 1)
    for name, count in counts.items():
        colour = COLOURS[Outcome.STOP] if name == SHOWN[Outcome.STOP] else COLOURS[Outcome.RESIDUAL]
        style: dict[str, Any] = {"baseline": below, "fill": True, "color": colour, "label": name}
        ax.stairs(below + count, edges, **style | patch)
        below = below + count
    if scale_of(column) == "log" and edges[0] > 0:
        ax.set_xscale("log")
    ax.set(xlabel=symbol(column), ylabel="starts", ylim=(0, None))
    if len(counts) > 1:
        ax.legend(frameon=False)
    ax.set_title(_title(found), fontsize="medium")
    return ax


def _counted(
    basin: Basin, column: str, bins: int
) -> tuple[Float[np.ndarray, "edges"], dict[str, np.ndarray]]:
    """Return the edges of the bins, and for each outcome, by its name, the counts in them."""
    if column in (None, CERTIFIED):
        refuse("column", "name a column of numbers", f"is {column!r}")
    outcomes = SHOWN if column in MOTION else {Outcome.RESIDUAL: SHOWN[Outcome.RESIDUAL]}
    column_values = np.asarray(basin.column(column), float)
    values = {name: column_values[basin.outcome == outcome] for outcome, name in outcomes.items()}
    values = {name: x[np.isfinite(x)] for name, x in values.items()}
    every = np.concatenate(list(values.values()))
    logarithmic = scale_of(column) == "log"
    if logarithmic:
        every = every[every > 0]
    if not every.size:
        refuse("column", "have values to count", f"has none in this basin ({column})")
    low, high = every.min(), every.max()
    if low == high:
        low, high = (low / 2, 2 * low) if logarithmic else (low - 0.5, low + 0.5)
    edges = (np.geomspace if logarithmic else np.linspace)(low, high, bins + 1)
    return edges, {name: np.histogram(x, edges)[0] for name, x in values.items()}


def _title(found: Basin | Tally) -> str:
    """Return the title: level, number of starts, share of every outcome, fixed quantities."""
    if isinstance(found, Tally):
        size, fractions, fixed = found.starts, found.merged.fractions(), []
    else:
        size, fractions = found.outcome.size, found.fractions()
        fixed = fixed_values(found)
    shares = [f"{name.lower()} {percent(float(x.share))}" for name, x in fractions.items()]
    return f"{capitalised(found.level)}\n{', '.join([counted((size,)), *shares, *fixed])}"
