"""Maps of basins with more than two axes: shares of the starts over all axes except two."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from .._base.checks import instance, refuse
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.columns import MISSING
from .axes import check_axes, name_axis
from .map_layout import check_axis, fixed_values
from .style import capitalised, percent, symbol


def shares(basin: Basin, x: str, y: str, *, ax: Axes | None = None) -> Axes:
    """Draw the share of residual rotations over two axes, averaged over all other axes.

    Args:
        basin: a basin over a grid.
        x: the horizontal axis.
        y: the vertical axis.
        ax: matplotlib axes to draw on; None makes a figure.

    Returns:
        The axes; the share is among the starts whose outcome is known.

    Raises:
        ValueError: there is no such axis.
    """
    instance("basin", basin, Basin)
    for name, value in (("x", x), ("y", y)):
        check_axis(basin, name, value)
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
    name_axis(ax.xaxis, x)
    name_axis(ax.yaxis, y)
    averaged = [symbol(basin.dims[k]) for k in others if basin.shape[k] > 1]
    missing = np.mean(outcome == MISSING["int8"])
    said = [f"averaged over {', '.join(averaged)}"] * bool(averaged)
    said += fixed_values(basin)
    said += [f"{percent(float(missing))} of the starts not computed yet"] * bool(missing)
    ax.set_title("\n".join([capitalised(basin.level), ", ".join(said)]), fontsize="medium")
    return ax
