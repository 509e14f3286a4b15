"""Starts as dots: along the only axis of a grid, or over two quantities of single starts."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cbook import normalize_kwargs
from matplotlib.colors import Colormap
from matplotlib.lines import Line2D

from .._base.checks import instance
from .._base.refusals import refuse
from .._maps.basin import Basin
from .._maps.columns import START, is_result
from .axes import axes_or_new, name_axes, spacing
from .basins import draw_colourbars, put_legend
from .column_shading import CERTIFIED, check_shade, scale_of
from .map_layout import (
    CLASSES,
    Plane,
    classes_of,
    coloured,
    legend_colours,
    part_at,
    shades_of,
    title_of,
)


def line(
    basin: Basin,
    column: str = "omega_inf",
    *,
    ax: Axes | None = None,
    at: Mapping[str, Any] | None = None,
    **dots: Any,
) -> Axes:
    """Plot a column of a sweep against its only axis, in the colours of the outcomes.

    Args:
        basin: a basin over a grid with one axis longer than 1; the others go into the title.
        column: ω∞, or another column of numbers: "time", "steps", "d_omega_inf_d_delta", ….
        ax: matplotlib axes to draw on; None makes a figure.
        at: name = value for axes that are fixed, at the nearest value of the grid.
        dots: keywords of `Axes.plot`, such as `marker`, `markersize` or `alpha`.

    Returns:
        The axes; starts without a known value are short marks on the horizontal axis.

    Raises:
        ValueError: not a basin over a grid; not exactly one axis longer than 1 besides the axes in
            `at`; a column without numbers to draw.
    """
    basin = part_at(basin, at)
    check_shade(column, basin.columns, "column")
    if column in (None, CERTIFIED):
        refuse("column", "name a column of numbers", f"is {column!r}")
    long = [name for name in basin.dims if len(basin.coords.get(name, ())) > 1]
    if len(long) != 1 or basin.coords[long[0]].ndim > 1:
        must = "have one axis of numbers that is longer than 1 (`at` fixes others)"
        refuse("basin", must, f"has {', '.join(basin.dims)} of lengths {basin.shape}")
    (x,) = long
    xs, values = basin.coords[x], np.asarray(basin.column(column), float).ravel()
    is_given, ax = ax is not None, axes_or_new(ax)
    shown = _flat(basin)
    handles = []
    (classes,) = classes_of(shown)
    for k, (label, colour) in enumerate(CLASSES.values()):
        members = classes == k
        if not members.any():
            continue
        known = members & np.isfinite(values)
        style = {"linestyle": "", "marker": "o", "markersize": 3, "color": colour}
        ax.plot(xs[known], values[known], **style | normalize_kwargs(dots, Line2D))
        unknown = members & ~np.isfinite(values)
        marks = {"color": colour, "transform": ax.get_xaxis_transform(), "clip_on": False}
        ax.plot(xs[unknown], np.zeros(unknown.sum()), "|", ms=9, **marks)
        handles.append(Line2D([], [], ls="", marker="o", color=colour, label=label))
    if scale_of(column) == "log" and np.any(values > 0):
        ax.set_yscale("log")
    if spacing(np.sort(xs)) == "log":
        ax.set_xscale("log")
    name_axes(ax, x, column)
    ax.set_title(title_of(basin), fontsize="medium")
    put_legend([ax], handles, is_given)
    return ax


def starts(
    basin: Basin,
    x: str = "phi",
    y: str = "cos_theta",
    *,
    ax: Axes | None = None,
    shade: str | None = "omega_inf",
    cmap: str | Colormap | None = None,
    **dots: Any,
) -> Axes:
    """Draw single starts as dots over two quantities, in the colours of a map.

    The default quantities, φ and cos ϑ = ω₃/|ω₀|, give an equal-area map of directions.

    Args:
        basin: a basin over a `Sample` or `Points`.
        x: the horizontal quantity: "phi", "cos_theta", "amplitude", "w_perp", "w1", "w2", "w3" of
            the start, or any other number of the sample or the points.
        y: the vertical quantity.
        ax: matplotlib axes to draw on; None makes a figure.
        shade: the column that shades the outcomes; see `plots.basin`.
        cmap: the colours of the shading, as in `plots.basin`.
        dots: keywords of `Axes.scatter`, such as `s`, `marker` or `alpha`.

    Returns:
        The axes; the title shows the level of the equation and the certified share.

    Raises:
        ValueError: a basin over a grid, a quantity that it does not have, or an unknown `shade`.
    """
    instance("basin", basin, Basin)
    check_shade(shade, basin.columns)
    if len(basin.dims) != 1 or basin.dims[0] in basin.coords:
        must = "be over a `Sample` or `Points` (`plots.basin` and `plots.line` draw grids)"
        refuse("basin", must, "is over a grid")
    known = _quantities(basin)
    for argument, name in (("x", x), ("y", y)):
        if name not in known:
            refuse(argument, f"be among {', '.join(known)}", f"is {name!r}")
    shown = _flat(basin, shade)
    classes, shades = classes_of(shown), shades_of([shown], shade, cmap)
    colours = coloured(shown, classes, shades)[0] / 255
    is_given, ax = ax is not None, axes_or_new(ax, 5.0)
    faces = colours.copy()
    if shade == CERTIFIED:
        faces[~basin.certified] = 0.0
    style: dict[str, Any] = {"s": np.clip(2e4 / basin.shape[0], 2, 30), "linewidths": 0.8}
    style |= {"facecolors": faces, "edgecolors": colours}
    ax.scatter(known[x], known[y], **style | dots)
    entries = legend_colours([shown], [classes], shades).items()
    handles = [Line2D([], [], ls="", marker="o", color=c, label=name) for name, c in entries]
    if shade == CERTIFIED:
        ring: Any = {"mfc": "none", "mec": "0.3", "ls": ""}
        handles.append(Line2D([], [], marker="o", label="not certified", **ring))
    name_axes(ax, x, y)
    ax.set_title(title_of(basin), fontsize="medium")
    put_legend([ax], handles, is_given)
    draw_colourbars(shades, [ax])
    return ax


def _flat(basin: Basin, shade: str | None = None) -> Plane:
    """Return the columns of a basin as a plane with one row."""
    names = [x for x in ("outcome", "stop", "probability", shade) if x and x in basin.columns]
    columns = {name: basin.column(name).reshape(1, -1) for name in names}
    return Plane("", "", np.zeros(0), np.zeros(0), columns, "")


def _quantities(basin: Basin) -> dict[str, Float[np.ndarray, "N"]]:
    """Return all quantities over which single starts can be drawn, by name."""
    listed = {name: values for name, values in basin.coords.items() if values.ndim == 1}
    drawn = [name for name in basin.columns if not is_result(name) and name != START]
    listed |= {name: x for name in drawn if (x := basin.column(name)).ndim == 1}
    starts = basin.columns.get(START, basin.coords.get(START))
    if starts is None:
        return listed
    w1, w2, w3 = np.asarray(starts if START in basin.coords else basin.omega0).T
    across = np.hypot(w1, w2)
    size = np.hypot(across, w3)
    with np.errstate(invalid="ignore"):
        cosine = w3 / size
    of_start = {"phi": np.arctan2(w2, w1) % (2 * np.pi), "cos_theta": cosine, "amplitude": size}
    return of_start | {"w_perp": across, "w1": w1, "w2": w2, "w3": w3} | listed
