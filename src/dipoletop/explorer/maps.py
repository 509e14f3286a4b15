"""The maps of a page: a Bokeh figure for each level, with the same ranges."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.events import RangesUpdate, Reset, Tap
from bokeh.models import (
    AdaptiveTicker,
    CustomJS,
    CustomJSHover,
    CustomJSTickFormatter,
    FixedTicker,
    HoverTool,
    Range1d,
)

from ..plots.map_layout import CLASSES, classes_of
from .pictures import Picture
from .pieces import pane_of, source, wide_figure
from .views import Range, View

HEIGHT = 440
TOOLS = "pan,wheel_zoom,box_zoom,zoom_in,zoom_out,reset,save"
TICKS = Path(__file__).with_name("ticks.js").read_text(encoding="utf-8")
HOVER = Path(__file__).with_name("hover.js").read_text(encoding="utf-8")
DRAWN = "figure.tags = [cb_obj.data.serial[0]]"
"""The browser reports which picture it has, so that it is sent no more than it can draw."""
PLACE = "x", "y", "dw", "dh"
PICTURE, ENDS = ("image", *PLACE, "serial", "about"), (*PLACE, "classes", "omega_inf")
START = """
const shown = (axis, x) => `${axis.axis_label} = ${Number(x.toPrecision(4))}`.replace("-", "−")
const middle = (at, low, width, count) =>
  low + (Math.floor((at - low)/width*count) + 0.5)*width/count
let [atX, atY] = [special_vars.x, special_vars.y]
if (ends.data.x.length) {  // the start that is told of: the middle of its pixel
  const {x, y, dw, dh, omega_inf} = ends.data, [rows, columns] = omega_inf[0].shape
  atX = middle(atX, x[0], dw[0], columns), atY = middle(atY, y[0], dh[0], rows)
}
return `${shown(across, atX)}, ${shown(up, atY)}`"""
NO_ECHO = """
const manager = Bokeh.Models.get("panel.models.comm_manager.CommManager").prototype
manager.send_change ??= manager._document_changed
manager._document_changed = function (event) { if (event.sync) this.send_change(event) }"""
"""In a notebook Panel's browser side would send back all that it is sent, whole pictures, too."""


class Maps:
    """One map, or two side by side.

    Args:
        symbols: the symbol of each quantity.
        on_ranges: called with the ranges "x" and "y" that the user has chosen, or with None for
            the whole ranges.
        on_start: called with the number of a map and the x and y of a start in it.
        on_drawn: called with the serial number of the newest picture in the browser.
    """

    def __init__(
        self,
        symbols: dict[str, str],
        on_ranges: Callable[[dict[str, Range] | None], None],
        on_start: Callable[[int, float, float], None],
        on_drawn: Callable[[int], None],
    ) -> None:
        self._symbols = symbols
        x, y = Range1d(start=0.0, end=1.0), Range1d(start=0.0, end=1.0)
        self.figures = [_figure(number, x, y) for number in range(2)]
        self._sources = [source(f"picture-{number}", *PICTURE) for number in range(2)]
        self._ends = [source(f"ends-{number}", *ENDS) for number in range(2)]
        """Class and ω∞ of every start of a finished picture."""
        self._chosen, self._path = source("chosen", "x", "y"), source("path", "x", "y")
        for number, plot in enumerate(self.figures):
            image = plot.image_rgba("image", *PLACE, source=self._sources[number])
            plot.add_tools(_hover(plot, image, self._ends[number]))
            for colour, width in (("white", 3), ("black", 1)):
                plot.line("x", "y", source=self._path, line_color=colour, line_width=width)
            for colour, width in (("white", 5), ("black", 2)):
                line = {"line_color": colour, "line_width": width}
                plot.scatter("x", "y", source=self._chosen, marker="cross", size=18, **line)
            plot.on_event(Tap, lambda event, number=number: on_start(number, event.x, event.y))
            plot.on_event(Reset, lambda _: on_ranges(None))
        first = self.figures[0]
        self._sources[0].js_on_change("data", CustomJS(args={"figure": first}, code=DRAWN))
        first.on_change("tags", lambda attr, old, new: on_drawn(int(new[0])) if new else None)
        first.on_event(
            RangesUpdate, lambda at: on_ranges({"x": (at.x0, at.x1), "y": (at.y0, at.y1)})
        )
        self.panes = [pane_of(plot) for plot in self.figures]

    def once_loaded(self, begin: Callable[[], None]) -> None:
        """Call `begin` when the browser of a notebook has laid out the map for the first time."""
        waiting = [begin]

        def laid_out(attr: str, old: Any, new: Any) -> None:
            while waiting:
                waiting.pop()()

        self.figures[0].on_change("inner_width", laid_out)
        self.figures[0].js_on_change("inner_width", CustomJS(code=NO_ECHO))

    def look_at(self, view: View, whole: dict[str, Range]) -> None:
        """Show the ranges of a view; a reset shows their `whole` ranges."""
        first = self.figures[0]
        for name, span in ((view.x, first.x_range), (view.y, first.y_range)):
            (low, high), (reset_low, reset_high) = view.ranges[name], whole[name]
            span.update(start=low, end=high, reset_start=reset_low, reset_end=reset_high)
        self.mark_axes(view)
        self.panes[1].visible = len(view.levels) == 2

    def mark_axes(self, view: View) -> None:
        """Name the axes, with ticks that suit their ranges."""
        for plot in self.figures:
            for name, axis in ((view.x, plot.xaxis[0]), (view.y, plot.yaxis[0])):
                low, high = view.ranges[name]
                _label(axis, name, self._symbols[name], high - low)

    def mark(self, place: tuple[float, float] | None) -> None:
        """Mark a start; remove the mark if `place` is None."""
        self.trace([], [])
        xs, ys = ([], []) if place is None else ([place[0]], [place[1]])
        self._chosen.data = {"x": xs, "y": ys}

    def trace(self, x: Any, y: Any) -> None:
        """Draw the path of a motion, NaN where it leaves one side and enters at the other."""
        self._path.data = {"x": x, "y": y}

    def show(self, picture: Picture, serial: int) -> None:
        """Draw a picture; its axes must be the ones shown."""
        (x0, x1), (y0, y1) = (picture.view.ranges[n] for n in (picture.view.x, picture.view.y))
        place = {"x": [x0], "y": [y0], "dw": [x1 - x0], "dh": [y1 - y0]}
        about = {"fixed": picture.view.fixed, "size": picture.size, "final": picture.is_final}
        about["fine_edges"] = picture.has_fine_edges
        identity = {"serial": [serial], "about": [json.dumps(about)]}  # read in the browser
        sources = self._sources[: len(picture.images)]
        # The first map is sent last: once the browser has it, it has both.
        for of_map, image in reversed(list(zip(sources, picture.images, strict=True))):
            pixels = np.ascontiguousarray(image).view(np.uint32)[..., 0]
            of_map.data = {"image": [pixels], **place, **identity}
        self._tell_ends(picture, place)

    def _tell_ends(self, picture: Picture, place: dict[str, list[float]]) -> None:
        """Give the browser how the starts of a finished picture end; nothing for a coarse one."""
        if picture.has_fine_edges:
            return  # it has been told
        for ends, plane in zip(self._ends, picture.planes, strict=False):
            if picture.is_final:
                omega_inf = np.asarray(plane.columns["omega_inf"], np.float32)
                found = {"classes": [classes_of(plane).view(np.uint8)], "omega_inf": [omega_inf]}
                ends.data = place | found
            elif ends.data["x"]:
                ends.data = {name: [] for name in ends.data}


def _figure(number: int, x: Range1d, y: Range1d) -> Any:
    plot = wide_figure(
        f"map-{number}",
        HEIGHT,
        x_range=x,
        y_range=y,
        tools=TOOLS,
        active_scroll="wheel_zoom",
        background_fill_color="#eeeeee",
    )
    plot.grid.visible = False
    return plot


def _hover(plot: Any, image: Any, ends: Any) -> Any:
    """Return a tool that names the start under the pointer, and tells how it ends."""
    names = [name for name, _ in CLASSES.values()]
    axes = {"across": plot.xaxis[0], "up": plot.yaxis[0], "ends": ends}
    lines: Any = {
        "$x": CustomJSHover(args=axes, code=START),
        "$y": CustomJSHover(args={"ends": ends, "names": names}, code=HOVER),
    }
    text = "<div>$x{custom}</div><div>$y{custom}</div>"
    return HoverTool(renderers=[image], tooltips=text, formatters=lines, visible=False)


def _label(axis: Any, name: str, symbol: str, width: float) -> None:
    of_angle = name in ("phi", "theta")
    if axis.axis_label != symbol:
        axis.axis_label = symbol
        axis.formatter = CustomJSTickFormatter(args={"of_angle": of_angle}, code=TICKS)
    turns = of_angle and width > 2
    if turns != isinstance(axis.ticker, FixedTicker):
        quarters = [k * math.pi / 4 for k in range(-16, 17)]
        axis.ticker = FixedTicker(ticks=quarters) if turns else AdaptiveTicker()
