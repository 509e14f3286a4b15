"""Maps of basins with more than two axes: a panel for each value of one, or shares over others."""

import math

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._base.checks import instance, refuse
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.columns import MISSING
from .axes import check_axes, mark_quarter_turns
from .basins import basin as draw_basin
from .plane import axis_lengths
from .style import capitalised, number, percent, symbol

COLUMNS, MOST = 3, 12


def panels(
    basin: Basin, over: str, *, shade: str | None = "omega_inf", x: str | None = None
) -> Figure:
    """A map of the outcomes for each value on an axis.

    Args:
        basin: a basin over a grid with three axes longer than 1.
        over: the axis with a panel for each value, at most twelve.
        shade: what shades the outcomes; see `plots.basin`.
        x: the horizontal axis; None means φ if there is one, else the last.

    Returns:
        The figure; each panel has its own colour bar and says its value.

    Raises:
        ValueError: there is no such axis, or it has too many values.
    """
    instance("basin", basin, Basin)
    _check_axis(basin, "over", over)
    count = len(basin.coords[over])
    if count > MOST:
        refuse(
            "over", f"be an axis of at most {MOST} values (`Basin.isel` chooses)", f"has {count}"
        )
    columns = min(count, COLUMNS)
    rows = math.ceil(count / columns)
    size = 6.6 * columns, 5.2 * rows
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for k, ax in enumerate(axes.flat):
        if k < count:
            draw_basin(basin.isel(**{over: k}), ax=ax, shade=shade, x=x)
        else:
            ax.axis("off")
    return figure


def shares(basin: Basin, x: str, y: str, *, ax: Axes | None = None) -> Axes:
    """The share of residual rotations among the starts over all axes except two.

    Args:
        basin: a basin over a grid.
        x: the horizontal axis.
        y: the vertical axis.
        ax: where to draw; None makes a figure.

    Returns:
        The axes; the share is of starts whose outcome is known.

    Raises:
        ValueError: there is no such axis.
    """
    instance("basin", basin, Basin)
    for name, value in (("x", x), ("y", y)):
        _check_axis(basin, name, value)
    if x == y:
        refuse("y", "be another axis than `x`", f"is {y!r} too")
    check_axes(ax)
    outcome, others = basin.outcome, tuple(k for k, d in enumerate(basin.dims) if d not in (x, y))
    known = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    counts = np.sum(known, axis=others)
    with np.errstate(invalid="ignore"):
        share = np.sum(outcome == Outcome.RESIDUAL, axis=others) / counts
    if basin.dims.index(x) < basin.dims.index(y):
        share = share.T
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 5.4), layout="constrained")
    picture = ax.pcolormesh(basin.coords[x], basin.coords[y], share, vmin=0, vmax=1, cmap="cividis")
    ax.figure.colorbar(picture, ax=ax, label="share of residual rotations")
    for name, axis in ((x, ax.xaxis), (y, ax.yaxis)):
        axis.set_label_text(symbol(name))
        if name == "phi":
            mark_quarter_turns(axis)
    averaged = [symbol(basin.dims[k]) for k in others if basin.shape[k] > 1]
    fixed = [
        f"{symbol(name)} = {number(float(values.item()))}"
        for name, values in basin.coords.items()
        if values.size == 1
    ]
    missing = np.mean(outcome == MISSING["int8"])
    said = [f"averaged over {', '.join(averaged)}"] * bool(averaged) + fixed
    said += [f"{percent(float(missing))} of the starts not computed yet"] * bool(missing)
    ax.set_title("\n".join([capitalised(basin.level), ", ".join(said)]), fontsize="medium")
    return ax


def _check_axis(basin: Basin, argument: str, name: str) -> None:
    if name not in basin.dims or name not in basin.coords:
        refuse(argument, f"be an axis of this basin ({axis_lengths(basin)})", f"is {name!r}")
