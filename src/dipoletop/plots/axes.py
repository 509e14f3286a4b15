"""Axes of pictures: spacing of the values of a grid, cells around them, ticks."""

from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MultipleLocator

from .._base.checks import instance
from .._base.refusals import refuse
from .style import symbol

Spacing = Literal["even", "log", "uneven"]

QUARTER = np.pi / 2
QUARTER_LABELS = {
    -2: r"$-\pi$",
    -1: r"$-\pi/2$",
    0: "0",
    1: r"$\pi/2$",
    2: r"$\pi$",
    3: r"$3\pi/2$",
}
"""Labels of the usual multiples of π/2."""


def axes_or_new(ax: Axes | None, height: float = 4.2) -> Axes:
    """Return given axes after checking them, or those of a new figure."""
    if ax is None:
        return plt.subplots(figsize=(7.0, height), layout="constrained")[1]
    return _checked(ax, "ax")


def several_axes(axes: Any, count: int, must: str) -> list[Axes]:
    """Return given axes as a list, after checking that there are so many."""
    given: list[Any] = np.ravel(np.asarray(axes, object)).tolist()
    if len(given) != count:
        refuse("axes", must, f"has {len(given)}")
    return [_checked(ax, "axes") for ax in given]


def _checked(ax: Any, argument: str) -> Axes:
    return instance(argument, ax, Axes, "be axes of matplotlib, or None")


def spacing(values: Float[np.ndarray, "n"]) -> Spacing:
    """Return whether increasing values or their logarithms are evenly spaced, to 0.1 %."""

    def even(points: Float[np.ndarray, "n"]) -> bool:
        steps = np.diff(points)
        return bool(np.ptp(steps) < 1e-3 * np.mean(steps))

    if even(values):
        return "even"
    return "log" if values[0] > 0 and even(np.log(values)) else "uneven"


def cell_edges(values: Float[np.ndarray, "n"], spaced: Spacing) -> Float[np.ndarray, "n+1"]:
    """Return edges of the cells around the values, halfway between neighbours."""
    if spaced == "log":
        return np.exp(cell_edges(np.log(values), "even"))
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def show_cells(
    ax: Axes,
    xs: Float[np.ndarray, "X"],
    ys: Float[np.ndarray, "Y"],
    colours: UInt8[np.ndarray, "Y X 4"],
    **given: Any,
) -> None:
    """Draw coloured cells: an image if both axes are evenly spaced, else a mesh.

    An axis whose logarithms are evenly spaced becomes logarithmic.
    """
    given = {"rasterized": True} | given
    x_spacing, y_spacing = spacing(xs), spacing(ys)
    x_edges, y_edges = cell_edges(xs, x_spacing), cell_edges(ys, y_spacing)
    if x_spacing == y_spacing == "even":
        extent = (*x_edges[[0, -1]].tolist(), *y_edges[[0, -1]].tolist())
        style: dict[str, Any] = {"origin": "lower", "extent": extent, "aspect": "auto"}
        ax.imshow(colours, **style | given)
        return
    ax.pcolormesh(x_edges, y_edges, colours, **given)
    if x_spacing == "log":
        ax.set_xscale("log")
    if y_spacing == "log":
        ax.set_yscale("log")


def name_axes(ax: Axes, x: str, y: str) -> None:
    """Label the axes with the symbols of quantities; put ticks of φ at multiples of π/2."""

    def label(value: float, _: Any) -> str:
        return QUARTER_LABELS.get(round(value / QUARTER), rf"${value / np.pi:g}\pi$")

    for axis, name in ((ax.xaxis, x), (ax.yaxis, y)):
        axis.set_label_text(symbol(name))
        if name == "phi":
            axis.set_major_locator(MultipleLocator(QUARTER))
            axis.set_major_formatter(FuncFormatter(label))
