"""What several pictures share: colours, line styles, sizes, hatching, labels, and file formats."""

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

from .._base.numerals import as_text
from .._maps.columns import DERIVATIVE_PREFIX
from ..equations.levels import Level

BLUE, ORANGE, GREEN, YELLOW = "#0072b2", "#d55e00", "#009e73", "#f0c419"
BLACK = "#202020"
COMPONENTS = ((r"$\omega_1$", BLUE), (r"$\omega_2$", ORANGE), (r"$\omega_3$", GREEN))
"""Names and colours of the components of ω."""
HATCH = "///"

MM = 1 / 25.4
"""Inches in a millimetre."""
WIDE = 180 * MM
"""Width in inches of two columns of a journal."""
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
"""Settings of matplotlib for figures at the size in which a journal prints them."""
UNDATED: dict[str, dict[str, None]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Metadata by format that leave the date out, so that a figure is the same file each time."""

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
"""Labels of quantities and columns; one of another name is labelled by that name."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure without its date, in the style of the paper's figures.

    Args:
        figure: a figure of `paper.figures`, or of `plots.diagram`.
        path: the file; the suffix of its name is its format: pdf, png or svg.
    """
    suffix = Path(path).suffix[1:]
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=300, metadata=UNDATED.get(suffix))


def level_line(level: Level) -> dict[str, Any]:
    """Colour, width and dashes of the curve of a level, as arguments of `Axes.plot`."""
    colour, width = LEVEL_LINES[level]
    return {"color": colour, "lw": width, "ls": (0, (4, 3)) if level is Level.FULL else "-"}


def hatch(
    ax: Axes,
    xs: Float[np.ndarray, "X"],
    ys: Float[np.ndarray, "Y"],
    inside: Bool[np.ndarray, "Y X"],
    label: str,
) -> Patch:
    """Hatch and outline a region of a grid; its entry for the legend.

    The outline makes a thin band as easy to see as a broad one. Black on white shows on every
    colour, so every line is drawn twice.
    """
    if inside.any():
        height = inside.astype(np.float32)
        areas = ax.contourf(xs, ys, height, levels=[0.5, 1.5], colors="none")
        areas.remove()  # it would keep a copy of the grid; its paths are all that is needed
        for colour, width in (("white", 1.8), ("black", 0.7)):
            with plt.rc_context({"hatch.linewidth": width, "hatch.color": colour}):
                marks = PathCollection(areas.get_paths(), hatch=HATCH, transform=ax.transData)
            marks.set(facecolor="none", edgecolor=colour, linewidth=width, rasterized=True)
            ax.add_collection(marks, autolim=False)
    return Patch(facecolor="white", edgecolor="black", hatch=HATCH, label=label)


def symbol(name: str) -> str:
    """The label of an axis or a column."""
    if name.startswith(DERIVATIVE_PREFIX):
        by = symbol(name.removeprefix(DERIVATIVE_PREFIX)).strip("$")
        return rf"$\partial\omega_\infty/\partial {by}$"
    return SYMBOLS.get(name, name)


def capitalised(text: str) -> str:
    """The text with a capital first letter; the rest stays as it is."""
    return text[:1].upper() + text[1:]


def number(value: float) -> str:
    """Six digits at most, or a multiple of π, with a typographic minus sign."""
    return as_text(value).replace("-", "−")


def percent(share: float) -> str:
    """A share to 0.1 %; it reads "0 %" only if it is 0, and "100 %" only if it is 1."""
    rounded = round(share * 1000) / 10
    if 0 < share < 1 and rounded in (0, 100):
        return "> 99.9 %" if rounded else "< 0.1 %"
    return f"{rounded:g} %"
