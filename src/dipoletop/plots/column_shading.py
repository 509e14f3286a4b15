"""Shading of the starts of an outcome by a column: colour scales, labels, legend entries."""

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm

from .._base.refusals import refuse
from .._base.types import Outcome
from .._maps.columns import DERIVATIVE_PREFIX
from .style import symbol

SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#8e2f00", "#e8853c", "#f7f3ee", "#5fa2d4", "#08488e"]
)
BLUES = LinearSegmentedColormap.from_list("residual", ["#deebf7", "#6baed6", "#08306b"])
OLIVES = LinearSegmentedColormap.from_list("stop", ["#f6f0c0", "#bda92b", "#332e00"])
GREENS = LinearSegmentedColormap.from_list("chance", ["#e9f7df", "#66c232", "#123d00"])

UNKNOWN = "#5500aa"
"""Colour of starts without a value in the column that shades their outcome. It is distinct from all
others for normal and colour-blind eyes."""
CERTIFIED = "certified"
"""The column that is shown by hatching the starts that are not certified, not by shades."""

OF_RUNS = {"time": r"$\tau$ when {} is certain", "steps": "steps of runs that end with {}"}
"""Labels of the columns that shade both outcomes."""
SHADES = "omega_inf", "omega_inf_error", *OF_RUNS, "probability"
"""The columns that shade starts, beside derivatives."""
Values = Mapping[Outcome, Float[np.ndarray, "n"]]
"""The finite values of a column for the starts with each outcome."""


class Shade(NamedTuple):
    """The shading of the starts of one outcome by a column of the basin."""

    outcome: Outcome
    column: str
    colours: Colormap
    norm: Normalize
    label: str
    legend: dict[str, float]
    """Entries of the legend, each with the position of its colour in `colours`, from 0 to 1."""
    unknown: str | None = None
    """The legend entry of starts without a value; None gives them the colour of their outcome."""


def check_shade(shade: str | None, columns: Iterable[str], argument: str = "shade") -> None:
    """Refuse anything but None or a column of the basin that can shade its starts."""
    can_shade = [x for x in columns if x in SHADES or x.startswith(DERIVATIVE_PREFIX)]
    shown = [*can_shade, CERTIFIED]
    if shade is not None and shade not in shown:
        names = ", ".join(map(repr, shown))
        refuse(argument, f"be a column of this basin ({names}) or None", f"is {shade!r}")


def shades_by(column: str, values: Values) -> list[Shade]:
    """Return the shading by a column of every outcome that has values."""
    if column in OF_RUNS:
        return _both(column, values)
    outcome = Outcome.UNDECIDED if column == "probability" else Outcome.RESIDUAL
    numbers, label, unknown = values[outcome], symbol(column), None
    if column == CERTIFIED or not numbers.size:
        return []
    if column == "probability":
        label, legend = "probability of residual rotation", {"undecided, a matter of chance": 0.6}
        colours, norm = GREENS, Normalize(0, 1)
    elif column == "omega_inf_error":
        legend, unknown = {"residual rotation": 0.6}, "residual, no estimate of the error"
        colours, norm = BLUES, _logarithmic(numbers)
    elif column == "omega_inf":
        legend = {r"residual, $\omega_\infty > 0$": 0.85, r"residual, $\omega_\infty < 0$": 0.15}
        unknown = r"residual, $\omega_\infty$ not known"
        most = float(np.max(np.abs(numbers))) or 1.0
        colours, norm = SIGNED, Normalize(-most, most)
    else:
        legend = {rf"residual, {label} $> 0$": 0.85, rf"residual, {label} $< 0$": 0.15}
        unknown = "residual, no derivative"
        # Next to the boundary derivatives have no bound: linear near 0, logarithmic beyond.
        most = float(np.percentile(np.abs(numbers), 99.5)) or 1.0
        colours, norm = SIGNED, SymLogNorm(most / 100, vmin=-most, vmax=most, clip=True)
    return [Shade(outcome, column, colours, norm, label, legend, unknown)]


def _both(column: str, values: Values) -> list[Shade]:
    """Shade residual rotation and stop on one logarithmic scale."""
    norm = _logarithmic(np.concatenate([values[Outcome.RESIDUAL], values[Outcome.STOP]]))
    kinds = {Outcome.RESIDUAL: (BLUES, "residual rotation"), Outcome.STOP: (OLIVES, "stop")}
    return [
        Shade(outcome, column, colours, norm, OF_RUNS[column].format(name), {name: 0.6})
        for outcome, (colours, name) in kinds.items()
        if values[outcome].size
    ]


def _logarithmic(values: Float[np.ndarray, "n"]) -> LogNorm:
    """Return a logarithmic scale for almost all positive values, open at both ends.

    Some runs have the value 0, and a few next to the boundary have very large ones.
    """
    positive = values[values > 0] if np.any(values > 0) else np.ones(1)
    least, most = np.percentile(positive, [0.5, 99.5])
    return LogNorm(least, max(most, 10 * least), clip=True)


def scale_of(column: str) -> Literal["linear", "log"]:
    """Return the scale on which a column is shown."""
    return "log" if column in ("omega_inf_error", *OF_RUNS) else "linear"
