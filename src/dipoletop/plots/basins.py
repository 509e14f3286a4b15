"""Maps of outcomes, alone and compared, in colours that colour-blind people can tell apart."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Bool, Float, Shaped
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from .._base.checks import flag, instance, refuse
from .._maps.basin import Basin
from .axes import check_axes, mark_quarter_turns, show_cells
from .plane import (
    CLASSES,
    NOT_COMPUTED,
    Plane,
    Shade,
    axis_lengths,
    classes_of,
    coloured,
    legend_colours,
    plane_of,
    shades_of,
)
from .style import hatch, percent, symbol


def basin(
    basin: Basin,
    *,
    ax: Axes | None = None,
    shade: str | None = "omega_inf",
    unfold: bool = True,
    x: str | None = None,
    y: str | None = None,
) -> Axes:
    """A map of the outcomes over the two axes of a grid.

    Args:
        basin: a basin over a grid with two axes longer than 1; the others go into the title.
        ax: where to draw; None makes a figure.
        shade: what shades the outcomes. "omega_inf": residual rotation by its signed ω∞;
            "time": residual rotation and stop by the τ at which they were certain; None: nothing.
        unfold: whether to extend a symmetry cell in φ and ω₃ to the whole plane, by the rules of
            `plots.unfold`; not for a dipole off the principal axes.
        x: the horizontal axis; None means φ if there is one, else the last.
        y: the vertical axis; None means the other one.

    Returns:
        The axes; the title says the level of the equation and what share is certified.

    Raises:
        ValueError: no basin over a grid with two axes longer than 1, a name that is not one of
            them, or another `shade`.
    """
    instance("basin", basin, Basin)
    unfold = flag("unfold", unfold)
    check_axes(ax)
    if shade not in ("omega_inf", "time", None):
        refuse("shade", "be 'omega_inf', 'time' or None", f"is {shade!r}")
    plane = plane_of(basin, shade, unfold, (x, y))
    shades = shades_of([plane], shade)
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 5.4), layout="constrained")
    _draw(ax, plane, shades)
    _colourbars(shades, [ax])
    return ax


def compare(
    first: Basin, second: Basin, *, axes: Sequence[Axes] | np.ndarray | None = None
) -> Figure:
    """Two maps side by side in the same colours; hatched where the outcome differs.

    Args:
        first: a basin over a grid with two axes longer than 1.
        second: a basin over the same grid.
        axes: a pair of axes to draw on; None makes a figure.

    Returns:
        The figure; the titles say what share of the starts has another outcome.

    Raises:
        ValueError: the two are not over the same grid, or that is not a plane.
    """
    instance("first", first, Basin)
    instance("second", second, Basin)
    _check_same_grid(first, second)
    pair: list[Any] = [None, None] if axes is None else np.ravel(np.asarray(axes, object)).tolist()
    if len(pair) != 2:
        refuse("axes", "be a pair of axes, or None", f"has {len(pair)}")
    for ax in pair:
        check_axes(ax, "axes")
    outcomes_differ = first.outcome != second.outcome
    line = f"outcome differs for {percent(float(np.mean(outcomes_differ)))} of the starts (hatched)"
    planes = [plane_of(basin, "omega_inf", True, (None, None)) for basin in (first, second)]
    shades = shades_of(planes, "omega_inf")
    if axes is None:
        _, pair = plt.subplots(1, 2, figsize=(12.0, 5.6), layout="constrained", sharey=True)
    differs = planes[0].columns["outcome"] != planes[1].columns["outcome"]
    for ax, plane in zip(pair, planes, strict=True):
        _draw(ax, plane._replace(title=f"{plane.title}\n{line}"), shades, differs)
    pair[1].set_ylabel("")
    _colourbars(shades, list(pair))
    return pair[0].figure


def _check_same_grid(first: Basin, second: Basin) -> None:
    if first.dims != second.dims or first.shape != second.shape:
        was = f"is over {axis_lengths(second)}"
        refuse("second", f"be over the axes of `first`, {axis_lengths(first)}", was)
    for name, values in first.coords.items():
        if not np.allclose(values, second.coords[name], rtol=1e-6, atol=1e-12):
            refuse("second", "be over the same grid as `first`", f"has other values of {name}")


def _draw(
    ax: Axes,
    plane: Plane,
    shades: list[Shade],
    differs: Bool[np.ndarray, "Y X"] | None = None,
) -> None:
    """The coloured cells, the hatching where outcomes differ, the axes, title and legend."""
    classes = classes_of(plane)
    colours = legend_colours(plane, classes, shades)
    handles = [Patch(facecolor=colour, label=label) for label, colour in colours.items()]
    xs, image = _close_circle(plane, coloured(plane, classes, shades))
    show_cells(ax, xs, plane.ys, image)
    hatched = {} if differs is None else {"outcome differs": differs}
    missing = classes == len(CLASSES)
    if missing.any():
        hatched[NOT_COMPUTED] = missing
    for label, cells in hatched.items():
        xs, closed = _close_circle(plane, cells)
        handles.append(hatch(ax, xs, plane.ys, closed, label))
    for name, axis in ((plane.x, ax.xaxis), (plane.y, ax.yaxis)):
        axis.set_label_text(symbol(name))
        if name == "phi":
            mark_quarter_turns(axis)
    ax.set_title(plane.title, fontsize="medium")
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        # Half an inch below the axes, under their label, however large they are.
        bbox_transform=ax.transAxes + ScaledTranslation(0, -0.5, ax.figure.dpi_scale_trans),
        ncols=min(3, len(handles)),
        frameon=False,
        fontsize="small",
    )


def _close_circle(
    plane: Plane, image: Shaped[np.ndarray, "Y X ..."]
) -> tuple[Float[np.ndarray, "n"], Shaped[np.ndarray, "Y n ..."]]:
    """The image with a column for φ = 2π, the same as φ = 0, if φ along x covers a circle."""
    xs = plane.xs
    step = xs[1] - xs[0]
    if plane.x != "phi" or abs(xs[-1] + step - xs[0] - 2 * np.pi) > 1e-3 * step:
        return xs, image
    return np.append(xs, xs[0] + 2 * np.pi), np.concatenate([image, image[:, :1]], axis=1)


def _colourbars(shades: list[Shade], axes: list[Axes]) -> None:
    """A colour bar for each shade; bars of two outcomes stand side by side and share ticks."""
    for k, shade in enumerate(shades):
        colours = ScalarMappable(shade.norm, shade.colours)
        extend = "both" if shade.column == "time" else "neither"
        bar = axes[0].figure.colorbar(colours, ax=axes, label=shade.label, pad=0.02, extend=extend)
        bar.ax.tick_params(which="both", labelright=k == 0)
