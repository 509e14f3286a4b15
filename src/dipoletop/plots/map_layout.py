"""The content of a map of outcomes, before it is drawn: two axes, classes, colours, title."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib import colormaps
from matplotlib.colors import Colormap, to_rgb

from .._base.checks import instance
from .._base.numerals import as_text
from .._base.refusals import refuse
from .._base.types import Outcome, Stop
from .._maps.basin import Basin
from .._maps.columns import MISSING
from .._maps.unfolded_basins import unfold
from .column_shading import UNKNOWN, Shade, check_shade, shades_by
from .style import capitalised, percent, symbol

Colour = str | tuple[float, float, float, float]
"""A hexadecimal colour, or RGBA."""

CLASSES: dict[tuple[Outcome, Stop], tuple[str, str]] = {
    (Outcome.RESIDUAL, Stop.NONE): ("residual rotation", "#0072b2"),
    (Outcome.STOP, Stop.ROTATING): ("stop, rotating", "#202020"),
    (Outcome.STOP, Stop.WOBBLING): ("stop, wobbling", "#9f9f9f"),
    (Outcome.STOP, Stop.TUMBLING): ("stop, tumbling", "#9f6040"),
    (Outcome.STOP, Stop.AXIS): ("stop, fixed axis", "#4000ff"),
    (Outcome.STOP, Stop.NONE): ("stop", "#606060"),
    (Outcome.UNDECIDED, Stop.NONE): ("undecided", "#66ff33"),
    (Outcome.FAILED, Stop.NONE): ("failed", "#df20ff"),
}
"""Name and flat colour of every class of starts. The colours are distinct from each other and from
the shades of ω∞, for normal and colour-blind eyes."""
NOT_COMPUTED, BLANK = "not computed yet", "#ffffff"
"""Name and colour of starts that a sweep has not computed yet; they are also hatched."""
CHANCE = "undecided, a matter of chance"
"""Name of undecided starts if all their probabilities are known."""


class Plane(NamedTuple):
    """A basin over two increasing axes; arrays have shape (Y, X), with rows along y."""

    x: str
    y: str
    xs: Float[np.ndarray, "X"]
    ys: Float[np.ndarray, "Y"]
    columns: dict[str, np.ndarray]
    """`outcome`, `stop`, `probability` if the basin has it, and the column that shades outcomes."""
    title: str


def plane_of(
    basin: Basin, shading: str | None, extend: bool, axes: tuple[str | None, str | None]
) -> Plane:
    """Return two axes of a basin with the columns over them; axes of length 1 go into the title.

    Args:
        basin: a basin over a grid with two axes longer than 1.
        shading: the column that shades the outcomes, or None.
        extend: whether to unfold a symmetry cell to the whole plane.
        axes: the names along x and y; None means the usual one.
    """
    if any(name not in basin.coords for name in basin.dims):
        must = "be over a grid (`plots.starts` draws single starts)"
        refuse("basin", must, "is over single starts, which have no axes to map")
    long = [name for name, n in zip(basin.dims, basin.shape, strict=True) if n > 1]
    if len(long) != 2 or any(basin.coords[name].ndim > 1 for name in long):
        refuse(
            "basin",
            "have exactly two axes of numbers that are longer than 1 (`at` fixes others, `panels` "
            "draws one as panels, `plots.shares` averages; `plots.line` draws a single axis)",
            f"has {axis_lengths(basin)}",
        )
    check_shade(shading, basin.columns)
    x, y = _choose(long, *axes)
    shown = [name for name in ("outcome", "stop", "probability") if name in basin.columns]
    shown += [shading] if shading else []
    cell = dataclasses.replace(basin, columns={name: basin.columns[name] for name in shown})
    whole = unfold(cell) if extend else cell
    x_order, y_order = np.argsort(whole.coords[x]), np.argsort(whole.coords[y])
    columns = {}
    for name in shown:
        column = whole.column(name).squeeze()
        columns[name] = (column if long == [y, x] else column.T)[np.ix_(y_order, x_order)]
    xs = np.asarray(whole.coords[x][x_order], float)
    ys = np.asarray(whole.coords[y][y_order], float)
    return Plane(x, y, xs, ys, columns, title_of(basin))


def part_at(basin: Basin, at: Mapping[str, Any] | None) -> Basin:
    """Return the part of a basin nearest to these values on its axes, after checking both."""
    instance("basin", basin, Basin)
    if at is None:
        return basin
    instance("at", at, Mapping, "be a dict from axes to their values, or None")
    return basin.sel(method="nearest", **at)


def check_axis(basin: Basin, argument: str, name: str) -> None:
    """Refuse a name that is not an axis of the basin."""
    if name not in basin.dims or name not in basin.coords:
        refuse(argument, f"be an axis of this basin ({axis_lengths(basin)})", f"is {name!r}")


def axis_lengths(basin: Basin) -> str:
    """Return the axes of a basin and their lengths, in words."""
    return ", ".join(f"{name} ({n})" for name, n in zip(basin.dims, basin.shape, strict=True))


def _choose(long: list[str], x: str | None, y: str | None) -> tuple[str, str]:
    """Return the names of the horizontal and the vertical axis."""
    for argument, name in (("x", x), ("y", y)):
        if name is not None and name not in long:
            refuse(argument, f"be {long[0]!r} or {long[1]!r}", f"is {name!r}")
    if x is not None and x == y:
        refuse("y", "be the other axis than `x`", f"is {y!r} too")
    if x is None:
        free = [name for name in long if name != y]
        x = "phi" if "phi" in free else free[-1]
    return x, next(name for name in long if name != x)


def title_of(basin: Basin) -> str:
    """Return the title: the level, the fixed values, the certified share of the outcomes."""
    computed = basin.outcome != MISSING["int8"]
    share = float(np.mean(basin.certified[computed])) if computed.any() else 0.0
    words = {0.0: "no outcome", 1.0: "all outcomes"}
    which = words.get(share, f"{percent(share)} of the outcomes")
    certified = f"{which} certified for this level"
    return f"{capitalised(basin.level)}\n{', '.join([*fixed_values(basin), certified])}"


def fixed_values(basin: Basin) -> list[str]:
    """Return the quantities with the same value for all starts, as text with these values."""
    of_points = any(name not in basin.coords for name in basin.dims)
    fixed = {
        name: values
        for name, values in basin.coords.items()
        if (len(values) == 1 if name in basin.dims else not of_points)
    }
    return [
        f"{symbol(name)} = {', '.join(map(as_text, np.ravel(values).tolist())).replace('-', '−')}"
        for name, values in fixed.items()
    ]


def shades_of(
    planes: list[Plane], shading: str | None, cmap: str | Colormap | None = None
) -> list[Shade]:
    """Return the shading of every outcome that occurs, with colour scales common to all planes.

    `cmap` replaces the colours of the first one.
    """
    if shading is None:
        return []
    found, columns = {}, [plane.columns for plane in planes]
    for outcome in (Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED):
        values = np.concatenate([c[shading][c["outcome"] == outcome] for c in columns])
        found[outcome] = values[np.isfinite(values)].astype(float)
    shades = shades_by(shading, found)
    if cmap is None:
        return shades
    instance("cmap", cmap, str | Colormap, "be a colour map of matplotlib, its name, or None")
    if isinstance(cmap, str) and cmap not in colormaps:
        refuse("cmap", "be the name of a colour map of matplotlib", f"is {cmap!r}")
    colours = colormaps[cmap] if isinstance(cmap, str) else cmap
    return [shade._replace(colours=colours) for shade in shades[:1]] + shades[1:]


def classes_of(plane: Plane) -> Int[np.ndarray, "Y X"]:
    """Return the index of every start's class in `CLASSES`; its `Stop` counts only if it stops.

    Starts that are not computed yet have the index after the last class.
    """
    outcome, stop = plane.columns["outcome"], plane.columns["stop"]
    classes = np.full(outcome.shape, len(CLASSES), np.int8)
    for number_of_class, (class_outcome, class_stop) in enumerate(CLASSES):
        members = outcome == class_outcome
        if class_outcome == Outcome.STOP:
            members &= stop == class_stop
        classes[members] = number_of_class
    return classes


def coloured(
    plane: Plane, classes: Int[np.ndarray, "Y X"], shades: list[Shade]
) -> UInt8[np.ndarray, "Y X 4"]:
    """Return the colour of every start, RGBA."""
    colours = [*(colour for _, colour in CLASSES.values()), BLANK]
    flat = np.array([(*to_rgb(colour), 1.0) for colour in colours])
    image = np.round(255 * flat).astype(np.uint8)[classes]
    for shade in shades:
        unknown = _unknown(plane, shade)
        if shade.unknown:
            image[unknown] = np.append(np.round(255 * np.array(to_rgb(UNKNOWN))), 255)
        members = (plane.columns["outcome"] == shade.outcome) & ~unknown
        values = np.asarray(plane.columns[shade.column][members])
        image[members] = shade.colours(shade.norm(values), bytes=True)
    return image


def _unknown(plane: Plane, shade: Shade) -> Bool[np.ndarray, "Y X"]:
    """Return the mask of starts of an outcome without a value in the column that shades it."""
    return (plane.columns["outcome"] == shade.outcome) & ~np.isfinite(plane.columns[shade.column])


def legend_colours(
    planes: list[Plane], classes: list[Int[np.ndarray, "Y X"]], shades: list[Shade]
) -> dict[str, Colour]:
    """Return the colour of every class that occurs, by its name, in the order of `CLASSES`."""
    every = np.concatenate([each.ravel() for each in classes])
    counts = np.bincount(every, minlength=len(CLASSES))[: len(CLASSES)].tolist()
    shaded = {shade.outcome: shade for shade in shades}
    colours: dict[str, Colour] = {}
    for count, ((outcome, _), (label, colour)) in zip(counts, CLASSES.items(), strict=True):
        if count == 0:
            continue
        if outcome == Outcome.UNDECIDED and all(map(_is_chance, planes)):
            label = CHANCE
        if outcome in shaded:
            shade = shaded[outcome]
            colours |= {name: shade.colours(place) for name, place in shade.legend.items()}
            if shade.unknown and any(np.any(_unknown(plane, shade)) for plane in planes):
                colours[shade.unknown] = UNKNOWN
        elif count < every.size / 1000:  # too few to be seen in the picture
            colours[f"{label} ({count} start{'s' if count > 1 else ''})"] = colour
        else:
            colours[label] = colour
    return colours


def _is_chance(plane: Plane) -> bool:
    """Return whether the probabilities of all undecided starts are known."""
    undecided = plane.columns["outcome"] == Outcome.UNDECIDED
    return "probability" in plane.columns and bool(
        np.all(np.isfinite(plane.columns["probability"][undecided]))
    )
