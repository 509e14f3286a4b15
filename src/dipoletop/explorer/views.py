"""The view of a page: two axes with their ranges, the other values, levels, tolerance, size."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Float

from .._base.numerals import number_in
from .._base.refusals import refuse
from .._base.tolerances import tolerance
from .._maps.grids import Grid
from ..equations.levels import Level
from .scenes import Scene, checked, checked_range

SIZES = 64, 128, 256, 512, 1024
FINEST = 4
"""Least distance of neighbouring values on an axis, in units of the last place."""
SMALLEST = 1e-290
"""Least distance of neighbouring values near 0, so that they do not become subnormal."""
RANGE = ".."
"""The separator between the ends of a range in an address."""
Range = tuple[float, float]
PHI, W3 = "phi", "w3"
EXAMPLES: dict[str, tuple[str, dict[str, float]]] = {
    "Figure 2a of the paper: it keeps rotating": ("level=order-1", {PHI: math.pi / 30, W3: 0.2}),
    "Figure 2b of the paper: it stops": ("level=order-1", {PHI: math.pi / 3, W3: 0.2}),
    "Where the paper's equation is wrong": (
        "level=order-1&level=semi&delta=-0.7",
        {PHI: 0.3, W3: 0.05},
    ),
    "Needles that stop while they wobble": (
        "delta=0.85&w_perp=0.05&w3=-0.2..0.2",
        {PHI: 1.4, W3: 0.02},
    ),
    "A thin tongue of stops, a million times larger": (
        "phi=1.549997..1.550003&w3=0.00240237..0.00240357&rtol=1e-10",
        {PHI: 1.55, W3: 0.00240297},
    ),
    "As slow as real particles": ("x=phi&y=theta&amplitude=1e-20", {PHI: 0.4, "theta": 1.2}),
}
"""The query of an address and a start, by what there is to see; of the transverse top."""


@dataclass(frozen=True)
class View:
    """One picture, or two at different levels.

    Attributes:
        x: the horizontal axis.
        y: the vertical axis.
        ranges: the range of each axis.
        values: values of all quantities of the problem; values of the axes are not used.
        levels: one level, or two to be compared; () if the equation is given.
        rtol: relative tolerance of every step.
        size: starts on each axis.
    """

    x: str
    y: str
    ranges: dict[str, Range]
    values: dict[str, float]
    levels: tuple[Level, ...]
    rtol: float
    size: int

    @property
    def fixed(self) -> dict[str, float]:
        """The values of the quantities that are not axes."""
        axes = self.x, self.y
        return {name: value for name, value in self.values.items() if name not in axes}


class Cells(NamedTuple):
    """The starts of a picture: a grid, from which symmetries give all of them if `folded`."""

    grid: Grid
    folded: bool

    @property
    def count(self) -> int:
        """The number of starts to compute."""
        return math.prod(self.grid.shape)

    @property
    def rows(self) -> int:
        """The number of rows, along y."""
        return self.grid.shape[-2]

    def piece(self, rows: slice) -> Grid:
        """Return the grid of some rows."""
        axes = dict(self.grid.axes)
        y = self.grid.dims[-2]
        return Grid(**axes | {y: axes[y][rows]})


def first_view(
    scene: Scene,
    x: str | None = None,
    y: str | None = None,
    levels: tuple[Any, ...] = (),
    *,
    rtol: Any = 1e-8,
    size: Any = 256,
) -> View:
    """Return the view that a page begins with.

    Raises:
        ValueError: bad axes, levels, tolerance or size.
    """
    named = {axis: name for axis, name in (("x", x), ("y", y)) if name is not None}
    check_axes(scene, named)
    found = tuple(Level.named(level) for level in levels)
    blank = View("", "", {}, {}, found, rtol, size)
    return in_system(scene, blank, scene.system_of(*named.values()), **named)


def check_axes(scene: Scene, axes: Mapping[str, str]) -> None:
    """Refuse axes, by their arguments, along which nothing may be varied."""
    for argument, name in axes.items():
        if name not in scene.free:
            refuse(argument, f"be one of {', '.join(scene.free)}", f"is {name!r}")


def checked_view(scene: Scene, view: View) -> View:
    """Return the view after checking it against the scene.

    Raises:
        ValueError: it does not fit the scene.
    """
    if view.x == view.y:
        refuse("y", "be another axis than `x`", f"is {view.y!r} too")
    check_axes(scene, {"x": view.x, "y": view.y})
    scene.system_of(*view.values, view.x, view.y)
    values = {name: checked(name, x, scene.quantities[name]) for name, x in view.values.items()}
    ranges = {
        name: checked_range(name, ends, scene.quantities[name])
        for name, ends in view.ranges.items()
    }
    allowed = (1, 2) if scene.levels else (0,)
    for level in view.levels:
        if level not in scene.levels:
            choices = ", ".join(scene.levels) or "left out, since the equation is given"
            refuse("level", f"be one of {choices}", f"is {str(level)!r}")
    if len(set(view.levels)) < len(view.levels) or len(view.levels) not in allowed:
        refuse(
            "level", "be one level, or two different ones", f"is {', '.join(view.levels) or 'none'}"
        )
    if view.size not in SIZES:
        refuse("size", f"be one of {', '.join(map(str, SIZES))}", f"is {view.size!r}")
    rtol = float(tolerance("rtol", view.rtol))
    return replace(view, ranges=ranges, values=values, rtol=rtol, size=int(view.size))


def whole_ranges(scene: Scene, x: str, y: str) -> dict[str, Range]:
    """Return the ranges of axes before any zoom."""
    return {name: scene.quantities[name][3:5] for name in (x, y)}


def in_system(
    scene: Scene,
    view: View,
    system: tuple[str, ...],
    x: str | None = None,
    y: str | None = None,
) -> View:
    """Return the view over other axes, with starts given by a system of quantities.

    An axis that is None stays if it is in the system, or becomes a usual one. New axes have their
    whole range, and new quantities their defaults.
    """
    usual = [n for n in ("phi", "w3", "theta", *system) if n in system and n in scene.free]
    x, y = (name if name in system else "" for name in (x or view.x, y or view.y))
    x = x or next(name for name in usual if name != y)
    y = y or next(name for name in usual if name != x)
    known = {name: view.values.get(name, scene.quantities[name].default) for name in system}
    ranges = {name: view.ranges.get(name, span) for name, span in whole_ranges(scene, x, y).items()}
    return checked_view(scene, replace(view, x=x, y=y, ranges=ranges, values=known))


def cells_of(scene: Scene, view: View, size: int) -> Cells:
    """Return starts at the midpoints of size × size cells; axes in the order: others, y, x."""
    folded = scene.symmetric and _is_foldable(view)
    spans = {}
    for name in (view.y, view.x):
        (low, high), count = view.ranges[name], size
        if folded and name in ("phi", "w3"):  # half of the turn, and the upper hemisphere
            low, high, count = 0.0, high / 2 if name == "phi" else high, size // 2
        spans[name] = middles(low, high, count)
    fixed = {name: [value] for name, value in view.fixed.items()}
    return Cells(Grid(**fixed, **spans), folded)


def _is_foldable(view: View) -> bool:
    """Return whether the picture shows a whole turn of φ, with both hemispheres or at one ω₃."""
    low, high = view.ranges.get("phi", (0.0, 0.0))
    if low != 0 or not math.isclose(high, 2 * math.pi, rel_tol=1e-12):
        return False
    low, high = view.ranges.get("w3", (-1.0, 1.0))
    return low == -high


def middles(low: float, high: float, count: int) -> Float[np.ndarray, "n"]:
    """Return the midpoints of `count` equal cells."""
    half = (high - low) / (2 * count)
    return np.linspace(low + half, high - half, count)


def finest_step(view: View) -> float:
    """Return the least distance of neighbours on an axis, relative to the largest number there."""
    return min(
        (high - low) / (view.size * max(abs(low), abs(high))) for low, high in view.ranges.values()
    )


def zoomed(scene: Scene, view: View, ranges: Mapping[str, Range]) -> tuple[View, tuple[str, ...]]:
    """Return the view at other ranges of its axes, and the axes on which rounding ends the zoom.

    A range that leaves the bounds of its quantity is moved back. A range too narrow for its
    neighbouring values to differ is widened to the least width at which they do.

    Raises:
        ValueError: an end is not a finite number.
    """
    kept, ended = {}, []
    for name in (view.x, view.y):
        low, high = ranges[name]
        if not (math.isfinite(low) and math.isfinite(high)):
            refuse(name, "have a finite range", f"has {low} to {high}")
        low, high = min(low, high), max(low, high)
        rounding = float(np.spacing(max(abs(low), abs(high))))
        least = view.size * max(FINEST * rounding, SMALLEST)
        if high - low < least:
            centre = low + (high - low) / 2
            low, high = centre - least / 2, centre + least / 2
            ended.append(name)
        kept[name] = _inside(low, high, scene.quantities[name].least, scene.quantities[name].most)
    return checked_view(scene, replace(view, ranges=kept)), tuple(ended)


def _inside(low: float, high: float, least: float, most: float) -> Range:
    """Return the range, moved within bounds, and cut if it is wider than they are."""
    if low < least:
        low, high = least, high + (least - low)
    if high > most:
        low, high = low - (high - most), most
    return max(low, least), high


def address_of(view: View) -> str:
    """Return the query that opens a page at this view, "?" included."""
    pairs = [("level", level.value) for level in view.levels]
    pairs += [("x", view.x), ("y", view.y)]
    pairs += [(name, f"{low!r}{RANGE}{high!r}") for name, (low, high) in view.ranges.items()]
    pairs += [(name, repr(value)) for name, value in view.fixed.items()]
    return "?" + urlencode([*pairs, ("rtol", repr(view.rtol)), ("size", str(view.size))])


def view_at(scene: Scene, view: View, query: Mapping[str, Sequence[str]]) -> View:
    """Return the view, changed as the query of an address asks.

    Raises:
        ValueError: a name or a value of the query is not allowed.
    """
    given = {name.replace("-", "_"): list(texts) for name, texts in query.items()}
    known = "x", "y", "level", "rtol", "size", *scene.quantities
    for name, texts in given.items():
        if name not in known:
            refuse("address", f"name only {', '.join(known)}", f"names {name!r}")
        if len(texts) > 1 and name != "level":
            refuse(name, "be given once", f"is given {len(texts)} times")
    levels = tuple(Level.named(text) for text in given.pop("level", view.levels))
    single = {name: texts[0] for name, texts in given.items()}
    named = {name: single.pop(name).replace("-", "_") for name in ("x", "y") if name in single}
    rtol = number_of("rtol", single.pop("rtol", view.rtol))
    size: Any = single.pop("size", str(view.size))
    size = int(size) if size.isdecimal() and len(size) < 10 else size
    check_axes(scene, named)
    moved = in_system(scene, view, scene.system_of(*named.values(), *single), **named)
    ranges, values = dict(moved.ranges), dict(moved.values)
    for name, text in single.items():
        if name in ranges:
            ranges[name] = _range(name, text)
        else:
            values[name] = number_of(name, text)
    changed = replace(moved, ranges=ranges, values=values, levels=levels, rtol=rtol, size=size)
    return checked_view(scene, changed)


def number_of(name: str, text: Any, must: str = "be a finite number") -> float:
    """Return the number in a text; refuse another text as value of a quantity."""
    try:
        return number_in(str(text))
    except ValueError:
        return refuse(name, must, f"is {text!r}")


def _range(name: str, text: str) -> Range:
    low, found, high = text.partition(RANGE)
    if not found:
        refuse(name, f"be a range such as 0{RANGE}0.5, since it is an axis", f"is {text!r}")
    return number_of(name, low), number_of(name, high)
