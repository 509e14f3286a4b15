"""Addresses of a page: the query of a URL that holds a view."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from urllib.parse import urlencode

from .._base.checks import refuse
from .._base.numerals import number_in
from ..equations.levels import Level
from .scenes import Scene
from .views import SIZES, Range, View, check_axes, checked_view, in_system

RANGE = ".."
"""The separator between the ends of a range."""


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
    rtol = _number("rtol", single.pop("rtol", view.rtol))
    size = _size(single.pop("size", str(view.size)))
    check_axes(scene, named)
    moved = in_system(scene, view, scene.system_of(*named.values(), *single), **named)
    ranges, values = dict(moved.ranges), dict(moved.values)
    for name, text in single.items():
        if name in ranges:
            ranges[name] = _range(name, text)
        else:
            values[name] = _number(name, text)
    changed = replace(moved, ranges=ranges, values=values, levels=levels, rtol=rtol, size=size)
    return checked_view(scene, changed)


def _number(name: str, text: Any) -> float:
    try:
        return number_in(str(text))
    except ValueError:
        return refuse(name, "be a finite number", f"is {text!r}")


def _size(text: str) -> int:
    sizes = {str(size): size for size in SIZES}
    if text not in sizes:
        refuse("size", f"be one of {', '.join(sizes)}", f"is {text!r}")
    return sizes[text]


def _range(name: str, text: str) -> Range:
    low, found, high = text.partition(RANGE)
    if not found:
        refuse(name, f"be a range such as 0{RANGE}0.5, since it is an axis", f"is {text!r}")
    return _number(name, low), _number(name, high)
