"""Maps of outcomes: alone, in panels and compared, in colours safe for colour-blind people."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, overload

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Bool, Float, Shaped
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatter
from matplotlib.transforms import ScaledTranslation

from .._base.checks import flag, instance
from .._base.refusals import refuse
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.columns import MISSING
from .axes import axes_or_new, name_axes, several_axes, show_cells
from .column_shading import CERTIFIED, Shade
from .map_layout import (
    CLASSES,
    NOT_COMPUTED,
    Plane,
    axis_lengths,
    check_axis,
    classes_of,
    coloured,
    fixed_values,
    legend_colours,
    part_at,
    plane_of,
    shades_of,
)
from .style import capitalised, hatch, percent, symbol

COLUMNS, MOST = 3, 12
"""Largest numbers of panels in a row, and in a picture."""
DEEP = 0.05
"""Half the width of a region that is marked, over that of the map."""


class _Look(NamedTuple):
    """How starts are coloured."""

    shade: str | None
    cmap: str | Colormap | None
    image: dict[str, Any]
    """Keywords of the image."""


@overload
def basin(
    basin: Basin,
    *,
    ax: Axes | None = ...,
    shade: str | None = ...,
    unfold: bool = ...,
    x: str | None = ...,
    y: str | None = ...,
    at: Mapping[str, Any] | None = ...,
    panels: None = ...,
    cmap: str | Colormap | None = ...,
    **image: Any,
) -> Axes: ...


@overload
def basin(
    basin: Basin,
    *,
    shade: str | None = ...,
    unfold: bool = ...,
    x: str | None = ...,
    y: str | None = ...,
    at: Mapping[str, Any] | None = ...,
    panels: str,
    cmap: str | Colormap | None = ...,
    **image: Any,
) -> np.ndarray: ...


def basin(
    basin: Basin,
    *,
    ax: Axes | None = None,
    shade: str | None = "omega_inf",
    unfold: bool = True,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, Any] | None = None,
    panels: str | None = None,
    cmap: str | Colormap | None = None,
    **image: Any,
) -> Axes | np.ndarray:
    """Draw a map of the outcomes over two axes of a grid.

    | `shade` | starts that are shaded, and by which value |
    |---|---|
    | "omega_inf" | residual rotation by its signed ω∞ |
    | "omega_inf_error" | residual rotation by the estimated error of ω∞ |
    | "d_omega_inf_d_delta", … | residual rotation by that derivative of ω∞ |
    | "time", "steps" | residual rotation and stop by τ, or the steps, until they were certain |
    | "probability" | starts that chance decides, by the probability of residual rotation |
    | "certified" | no starts; outcomes that are not certified are hatched |
    | None | no starts |

    Args:
        basin: a basin over a grid; axes of length 1 go into the title.
        ax: matplotlib axes to draw on; None makes a figure.
        shade: see the table.
        unfold: whether to extend a symmetry cell in φ and ω₃ to the whole plane, by the rules of
            `plots.unfold`; not for a dipole off the principal axes.
        x: the horizontal axis; None means φ if there is one, else the last.
        y: the vertical axis; None means the other one.
        at: name = value for axes that are fixed, at the nearest value of the grid.
        panels: an axis with a panel for each value, at most twelve, in the same colours.
        cmap: the colours of the shading, those of residual rotation if both outcomes are shaded.
        image: keywords of `Axes.imshow` (`Axes.pcolormesh` if an axis is not evenly spaced), such
            as `alpha` or `zorder`.

    Returns:
        The axes; the title shows the level of the equation and the certified share. With
        `panels` an array of axes, one for each value.

    Raises:
        ValueError: not a basin over a grid; not exactly two axes longer than 1 besides the axes in
            `at` and `panels`; a name that is not an axis; an unknown `shade`.
    """
    basin, unfold = part_at(basin, at), flag("unfold", unfold)
    if panels is not None:
        return _panels(basin, panels, _Look(shade, cmap, image), unfold, (x, y), ax)
    given = None if ax is None else axes_or_new(ax)  # checked before all else
    plane = plane_of(basin, shade, unfold, (x, y))
    ax = given or axes_or_new(None, 5.4)
    _draw_all([ax], [plane], _Look(shade, cmap, image), given is not None)
    return ax


def _panels(
    basin: Basin,
    over: str,
    look: _Look,
    unfold: bool,
    axes: tuple[str | None, str | None],
    ax: Axes | None,
) -> np.ndarray:
    """Draw a panel for each value on an axis, and return the matplotlib axes."""
    check_axis(basin, "panels", over)
    if ax is not None:
        refuse("ax", "be None for `panels`, which make a figure", "is given")
    values = basin.coords[over]
    if len(values) > MOST:
        must = f"be an axis of at most {MOST} values (`Basin.isel` chooses)"
        refuse("panels", must, f"has {len(values)}")
    parts = (basin.isel(**{over: k}) for k in range(len(values)))
    planes = [plane_of(part, look.shade, unfold, axes) for part in parts]
    columns = min(len(values), COLUMNS)
    rows = math.ceil(len(values) / columns)
    size = 5.4 * columns + 1, 5.2 * rows
    _, grid = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    drawn, empty = grid.ravel()[: len(values)], grid.ravel()[len(values) :]
    for unused in empty:
        unused.axis("off")
    _draw_all(list(drawn), planes, look)
    return drawn


def compare(
    first: Basin,
    second: Basin,
    *,
    axes: Sequence[Axes] | np.ndarray | None = None,
    shade: str | None = "omega_inf",
    unfold: bool = True,
    x: str | None = None,
    y: str | None = None,
    cmap: str | Colormap | None = None,
    **image: Any,
) -> Figure:
    """Draw two maps side by side in the same colours, hatched where the outcome differs.

    Args:
        first: a basin over a grid with two axes longer than 1.
        second: a basin over the same grid.
        axes: a pair of axes to draw on; None makes a figure.
        shade: the column that shades the outcomes; see `plots.basin`.
        unfold: whether to extend a symmetry cell, as in `plots.basin`.
        x: the horizontal axis; None means φ if there is one, else the last.
        y: the vertical axis; None means the other one.
        cmap: the colours of the shading, as in `plots.basin`.
        image: keywords of `Axes.imshow`, as in `plots.basin`.

    Returns:
        The figure; its title shows the share of the starts with different outcomes.

    Raises:
        ValueError: the basins have different grids, a grid without exactly two axes longer than 1,
            or an unknown `shade`.
    """
    instance("first", first, Basin)
    instance("second", second, Basin)
    unfold = flag("unfold", unfold)
    _check_same_grid(first, second)
    pair: Any = None if axes is None else several_axes(axes, 2, "be a pair of axes, or None")
    known = (first.outcome != MISSING["int8"]) & (second.outcome != MISSING["int8"])
    outcomes_differ = first.outcome[known] != second.outcome[known]
    share = percent(float(np.mean(outcomes_differ))) if known.any() else "none"
    line = f"outcome differs for {share} of the starts (hatched)"
    planes = [plane_of(basin, shade, unfold, (x, y)) for basin in (first, second)]
    planes = [plane._replace(title=f"{plane.title}\n{line}") for plane in planes]
    if pair is None:
        _, pair = plt.subplots(1, 2, figsize=(12.0, 5.6), layout="constrained", sharey=True)
    outcomes = [plane.columns["outcome"] for plane in planes]
    differs = (outcomes[0] != outcomes[1]) & np.all(np.not_equal(outcomes, MISSING["int8"]), axis=0)
    look = _Look(shade, cmap, image)
    _draw_all(list(pair), planes, look, axes is not None, {"outcome differs": differs})
    pair[1].set_ylabel("")
    return pair[0].figure


def _check_same_grid(first: Basin, second: Basin) -> None:
    if first.dims != second.dims or first.shape != second.shape:
        was = f"is over {axis_lengths(second)}"
        refuse("second", f"be over the axes of `first`, {axis_lengths(first)}", was)
    for name, values in first.coords.items():
        if not np.allclose(values, second.coords[name], rtol=1e-6, atol=1e-12):
            refuse("second", "be over the same grid as `first`", f"has other values of {name}")


def shares(basin: Basin, x: str, y: str, *, ax: Axes | None = None, **mesh: Any) -> Axes:
    """Draw the share of residual rotations over two axes, averaged over all other axes.

    Args:
        basin: a basin over a grid.
        x: the horizontal axis.
        y: the vertical axis.
        ax: matplotlib axes to draw on; None makes a figure.
        mesh: keywords of `Axes.pcolormesh`, such as `cmap`.

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
    outcome, others = basin.outcome, tuple(k for k, d in enumerate(basin.dims) if d not in (x, y))
    known = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    counts = np.sum(known, axis=others)
    with np.errstate(invalid="ignore"):
        share = np.sum(outcome == Outcome.RESIDUAL, axis=others) / counts
    if basin.dims.index(x) < basin.dims.index(y):
        share = share.T
    ax = axes_or_new(ax, 5.4)
    style: dict[str, Any] = {"vmin": 0, "vmax": 1, "cmap": "cividis"}
    picture = ax.pcolormesh(basin.coords[x], basin.coords[y], share, **style | mesh)
    ax.figure.colorbar(picture, ax=ax, label="share of residual rotations")
    name_axes(ax, x, y)
    averaged = [symbol(basin.dims[k]) for k in others if basin.shape[k] > 1]
    missing = np.mean(outcome == MISSING["int8"])
    said = [f"averaged over {', '.join(averaged)}"] * bool(averaged)
    said += fixed_values(basin)
    said += [f"{percent(float(missing))} of the starts not computed yet"] * bool(missing)
    ax.set_title("\n".join([capitalised(basin.level), ", ".join(said)]), fontsize="medium")
    return ax


def _draw_all(
    axes: list[Axes],
    planes: list[Plane],
    look: _Look,
    given: bool = False,
    hatched: Mapping[str, Bool[np.ndarray, "Y X"]] | None = None,
) -> None:
    """Draw maps in the same colours, with common colour bars and a legend, as in `put_legend`."""
    shades, classes = shades_of(planes, look.shade, look.cmap), list(map(classes_of, planes))
    colours = legend_colours(planes, classes, shades)
    handles: list[Any] = [Patch(facecolor=colour, label=label) for label, colour in colours.items()]
    marked: dict[str, Any] = {}
    for ax, plane, each in zip(axes, planes, classes, strict=True):
        marks = dict(hatched or {})
        if look.shade == CERTIFIED:
            marks["not certified"] = ~plane.columns[CERTIFIED].astype(bool)
        missing = each == len(CLASSES)
        if missing.any():
            marks = {name: cells & ~missing for name, cells in marks.items()}
            marks[NOT_COMPUTED] = missing
        xs, image = _close_circle(plane, coloured(plane, each, shades))
        show_cells(ax, xs, plane.ys, image, **look.image)
        name_axes(ax, plane.x, plane.y)
        ax.set_title(plane.title, fontsize="medium")
        if any(shade.column == "omega_inf" for shade in shades):
            _mark_signs(ax, plane)
        for label, cells in marks.items():
            closed = _close_circle(plane, cells)[1]
            marked[label] = hatch(ax, xs, plane.ys, closed, label)
    draw_colourbars(shades, axes)
    put_legend(axes, [*handles, *marked.values()], given)


def _mark_signs(ax: Axes, plane: Plane) -> None:
    """Write + and − where the region of either sense is widest, for those who see no colours."""
    from scipy.ndimage import distance_transform_edt

    values = np.where(plane.columns["outcome"] == Outcome.RESIDUAL, plane.columns["omega_inf"], 0.0)
    regions = {"+": values > 0, "−": values < 0}
    if not all(region.any() for region in regions.values()):
        return
    for sign, region in regions.items():
        depth = np.asarray(distance_transform_edt(np.pad(region, 1)))[1:-1, 1:-1]
        if np.max(depth) < DEEP * min(region.shape):
            continue
        row, column = np.unravel_index(np.argmax(depth), depth.shape)
        around = [withStroke(linewidth=2.5, foreground="black")]
        style: dict[str, Any] = {"ha": "center", "va": "center", "path_effects": around}
        style |= {"clip_on": True, "in_layout": False}  # if only a part is shown
        ax.text(plane.xs[column], plane.ys[row], sign, color="white", size=15, **style)


def put_legend(axes: list[Axes], handles: list[Any], given: bool = False) -> None:
    """Put one legend below all axes of a figure, or below each of the `given` axes of a user."""
    style: dict[str, Any] = {"handles": handles, "frameon": False, "ncols": min(3, len(handles))}
    if not given:
        axes[0].figure.legend(loc="outside lower center", **style)
        return
    for ax in axes:  # half an inch below the axes, whatever their size: below their label
        below = ax.transAxes + ScaledTranslation(0, -0.5, ax.figure.dpi_scale_trans)
        place: dict[str, Any] = {"bbox_to_anchor": (0.5, 0.0), "bbox_transform": below}
        ax.legend(loc="upper center", fontsize="small", **place, **style)


def _close_circle(
    plane: Plane, image: Shaped[np.ndarray, "Y X ..."]
) -> tuple[Float[np.ndarray, "n"], Shaped[np.ndarray, "Y n ..."]]:
    """Return the x values and the image, with φ = 2π added if φ along x covers a circle."""
    xs = plane.xs
    step = xs[1] - xs[0]
    if plane.x != "phi" or abs(xs[-1] + step - xs[0] - 2 * np.pi) > 1e-3 * step:
        return xs, image
    return np.append(xs, xs[0] + 2 * np.pi), np.concatenate([image, image[:, :1]], axis=1)


def draw_colourbars(shades: list[Shade], axes: list[Axes]) -> None:
    """Draw a colour bar for each shade."""
    for shade in shades:
        colours = ScalarMappable(shade.norm, shade.colours)
        extend = "neither" if shade.column in ("omega_inf", "probability") else "both"
        bar: dict[str, Any] = {"label": shade.label, "pad": 0.02, "extend": extend}
        drawn = axes[0].figure.colorbar(colours, ax=axes, **bar)
        if shade.column == "steps":  # whole numbers, not powers
            drawn.ax.yaxis.set(major_formatter=LogFormatter(), minor_formatter=LogFormatter())
