"""The common style of pictures: colours, line styles, sizes, hatching, labels, file formats."""

import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .._base.checks import instance
from .._maps.columns import DERIVATIVE_PREFIX
from ..equations.levels import Level

BLUE, ORANGE, GREEN, YELLOW = "#0072b2", "#d55e00", "#009e73", "#f0c419"
BLACK = "#202020"
COMPONENTS = ((r"$\omega_1$", BLUE), (r"$\omega_2$", ORANGE), (r"$\omega_3$", GREEN))
"""Names and colours of the components of ω."""
HATCH = "///"

MM = 1 / 25.4
"""A millimetre in inches."""
WIDE = 180 * MM
"""Width of two columns of a journal in inches."""
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "figure.titlesize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
    "svg.hashsalt": "dipoletop",
}
"""Settings of matplotlib for figures at their printed size in a journal."""
UNDATED: dict[str, dict[str, None]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Metadata by format without the date, so that equal figures give equal files."""

LEVEL_LINES: dict[Level, tuple[str, float]] = {
    Level.ORDER_1: (ORANGE, 1.6),
    Level.ORDER_2: ("#8fd1bb", 3.6),
    Level.ORDER_3: (GREEN, 2.4),
    Level.ORDER_4: ("#cc79a7", 1.4),
    Level.SEMI: (BLUE, 1.4),
    Level.FULL: (YELLOW, 1.4),
}
"""Colour and width of the curve of a level. Orders 2 to 4 nearly coincide: the wide curve of a
lower order shows below the narrower one of the next."""

SYMBOLS = {
    "phi": r"$\varphi$",
    "w3": r"$\omega_3$",
    "w_perp": r"$\omega_\perp$",
    "w1": r"$\omega_1$",
    "w2": r"$\omega_2$",
    "delta": r"$\delta$",
    "amplitude": r"$|\omega_0|$",
    "theta": r"$\vartheta$",
    "cos_theta": r"$\cos\vartheta = \omega_3/|\omega_0|$",
    "omega_inf": r"$\omega_\infty = \tau_0\Omega_\infty$ (dimensionless)",
    "omega_inf_error": r"estimated error of $\omega_\infty$",
    "time": r"$\tau$ when the outcome is decided",
}
"""Labels of quantities and columns; any other one is labelled by its name."""


def save(drawn: Figure | Axes, path: str | Path, *, dpi: int = 300) -> None:
    """Write a figure without its date, so that the same picture is the same file.

    Args:
        drawn: a figure, or axes of it: what the functions of `plots` and `paper.figures` return.
        path: the file; the suffix of its name is its format: pdf, png or svg.
        dpi: pixels per inch of a png.

    Raises:
        ValueError: arguments of other types.
    """
    instance("drawn", drawn, Figure | Axes, "be a figure or axes of matplotlib")
    instance("path", path, str | os.PathLike, "be a path")
    figure: Any = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
    suffix = Path(path).suffix[1:]
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=dpi, metadata=UNDATED.get(suffix))


def level_line(level: Level) -> dict[str, Any]:
    """Return colour, width and dashes of the curve of a level, as arguments of `Axes.plot`."""
    colour, width = LEVEL_LINES[level]
    return {"color": colour, "lw": width, "ls": (0, (4, 3)) if level is Level.FULL else "-"}


def hatch(
    ax: Axes,
    xs: Float[np.ndarray, "X"],
    ys: Float[np.ndarray, "Y"],
    inside: Bool[np.ndarray, "Y X"],
    label: str,
) -> Patch:
    """Hatch and outline a region of a grid, and return its entry for the legend.

    The outline makes a thin band as easy to see as a broad one. Black on white shows on every
    colour, so every line is drawn twice.
    """
    if inside.any():
        height = inside.astype(np.float32)
        areas = ax.contourf(xs, ys, height, levels=[0.5, 1.5], colors="none")
        areas.remove()  # only its paths are needed; it would keep a copy of the grid
        for colour, width in (("white", 1.8), ("black", 0.7)):
            with plt.rc_context({"hatch.linewidth": width, "hatch.color": colour}):
                marks = PathCollection(areas.get_paths(), hatch=HATCH, transform=ax.transData)
            marks.set(facecolor="none", edgecolor=colour, linewidth=width, rasterized=True)
            ax.add_collection(marks, autolim=False)
    return Patch(facecolor="white", edgecolor="black", hatch=HATCH, label=label)


def symbol(name: str) -> str:
    """Return the label of an axis or a column."""
    if name.startswith(DERIVATIVE_PREFIX):
        by = symbol(name.removeprefix(DERIVATIVE_PREFIX)).strip("$")
        return rf"$\partial\omega_\infty/\partial {by}$"
    return SYMBOLS.get(name, name)


def capitalised(text: str) -> str:
    """Return the text with a capital first letter; the rest stays as it is."""
    return text[:1].upper() + text[1:]


def percent(share: float) -> str:
    """Return a share to 0.1 % as text: "0 %" only if it is 0, "100 %" only if it is 1."""
    rounded = round(share * 1000) / 10
    if 0 < share < 1 and rounded in (0, 100):
        return "> 99.9 %" if rounded else "< 0.1 %"
    return f"{rounded:g} %"
