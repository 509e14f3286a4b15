"""The controls of a page: axes and their ranges, sliders, levels, tolerance, size."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import panel as pn

from .._base.numerals import as_text, number_in
from .._maps.top_parameters import Quantity
from . import texts
from .pictures import rounded_up
from .pieces import WIDE, html
from .scenes import Scene, checked_range
from .views import SIZES, View, checked_view, in_system, number_of, zoomed

STEPS = 240
"""Steps of a slider."""
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
NONE, NUMBER = "none", "be a finite number such as 0.2, 1e-3 or pi/30"
WIDTH = 300
FULL = ".bk-input { font-size: 11px; padding: 0 5px; }"
"""Numbers of 17 digits are not cut."""
PLAY = Path(__file__).with_name("play.js").read_text(encoding="utf-8")
HELP = {
    "axes": "Every point of the map is a start; the two axes are the quantities that vary.",
    "system": "The quantities that give ω at the start: its components, or |ω| and its direction.",
    "level": "How radiation is treated: the paper's equation is order 1; semi-reduced is the most "
    "accurate one without runaways.",
    "compare": "A second map at another level; starts that end differently are hatched in both.",
    "rtol": "The relative error of every step. Only starts next to a boundary depend on it.",
    "size": "Starts along each axis; up to 256, the edges of regions are three times finer.",
}
"""What each control is for."""


class Controls:
    """Widgets that show a view, and make a new one when they are changed.

    Args:
        scene: the problem that is explored.
        on_view: called with every new view.
        on_refusal: called with the message that refuses a value, or with "" if all are accepted.
    """

    def __init__(
        self, scene: Scene, on_view: Callable[[View], None], on_refusal: Callable[[str], None]
    ) -> None:
        self._scene, self._on_view, self._on_refusal = scene, on_view, on_refusal
        self._view: View | None = None
        self._is_showing = False
        axes = {scene.symbols[name]: name for name in scene.free}
        words = "Horizontal", "Vertical"
        self._axes = [_select(f"{word} axis", axes, "axes") for word in words]
        systems = {", ".join(scene.symbols[name] for name in s): s for s in scene.systems}
        self._system = _select("Starts are given by", systems, "system")
        self._ends = {name: _Ends(name, self._set_range) for name in ("x", "y")}
        self._values = {
            name: _Value(name, scene.quantities[name], self._set_value) for name in scene.free
        }
        levels = {level.label: level for level in scene.levels}
        self._levels = [
            _select("Level of the equation", levels, "level"),
            _select("Compare with the level", {NONE: NONE} | levels, "compare"),
        ]
        self._rtol = _select("Tolerance rtol", _named(TOLERANCES), "rtol")
        self._size = _select("Starts on an axis", {str(size): size for size in SIZES}, "size")
        for widget in (*self._axes, *self._levels, self._system, self._rtol, self._size):
            widget.param.watch(self._chosen, "value")
        self.layout = self._laid_out()

    def _laid_out(self) -> Any:
        scene = self._scene
        self._system.visible = len(scene.systems) > 1
        for widget in self._levels:
            widget.visible = len(scene.levels) > 1
        self.sliders = pn.FlexBox(*(value.layout for value in self._values.values()), **WIDE)
        """The sliders of the quantities that are not axes."""
        return pn.Column(
            pn.Row(*self._axes),
            *(ends.layout for ends in self._ends.values()),
            self._system,
            *self._levels,
            pn.Row(self._rtol, self._size),
            width=WIDTH,
        )

    def show(self, view: View) -> None:
        """Show a view in the widgets, without calling `on_view`."""
        self._is_showing, self._view = True, view
        try:
            self._axes[0].value, self._axes[1].value = view.x, view.y
            self._system.value = self._scene.system_of(*view.values)
            for name, value in self._values.items():
                value.layout.visible = name in view.fixed
                if name in view.fixed:
                    value.show(view.values[name])
            for name, axis in (("x", view.x), ("y", view.y)):
                self._ends[name].show(self._scene.symbols[axis], view.ranges[axis])
            for widget, level in zip(self._levels, (*view.levels, NONE), strict=False):
                if level in widget.values:  # the list is empty if the equation is given
                    widget.value = level
            if view.rtol not in self._rtol.values:
                self._rtol.options = _named(sorted({*TOLERANCES, view.rtol}, reverse=True))
            self._rtol.value, self._size.value = view.rtol, view.size
        finally:
            self._is_showing = False

    def _change(self, make: Callable[[View], View]) -> None:
        """Make a new view; if it is refused, show the old values again and report why."""
        if self._is_showing or self._view is None:
            return
        try:
            view = make(self._view)
        except ValueError as error:
            self.show(self._view)  # before the message: who reads it may type at once
            self._on_refusal(str(error))
            return
        self._on_refusal("")
        self.show(view)
        self._on_view(view)

    def _set_value(self, name: str, value: Any) -> None:
        def changed(view: View) -> View:
            values = view.values | {name: number_of(name, value, NUMBER)}
            return checked_view(self._scene, replace(view, values=values))

        self._change(changed)

    def _set_range(self, axis: str, low: str, high: str) -> None:
        def changed(view: View) -> View:
            name = getattr(view, axis)
            ends = [number_of(name, text, NUMBER) for text in (low, high)]
            span = checked_range(name, ends, self._scene.quantities[name])
            return zoomed(self._scene, view, view.ranges | {name: span})[0]

        self._change(changed)

    def _chosen(self, event: Any) -> None:
        """Make the view that the lists and the other widgets now select."""

        def changed(view: View) -> View:
            x, y = (widget.value for widget in self._axes)
            if event.obj is self._system:
                return in_system(self._scene, view, self._system.value)
            if x == y:
                x, y = view.y, view.x  # one axis was set to the other: swap them
            if (x, y) != (view.x, view.y):
                return _with_either_axis(self._scene, view, x, y)
            levels = tuple(w.value for w in self._levels if w.value not in (NONE, None))
            if len(set(levels)) < len(levels):
                levels = levels[:1]
            rtol, size = self._rtol.value, self._size.value
            return checked_view(self._scene, replace(view, levels=levels, rtol=rtol, size=size))

        self._change(changed)


def _with_either_axis(scene: Scene, view: View, x: str, y: str) -> View:
    """Return the view with these axes; if no system has both, the axis just changed wins."""
    if any({x, y} <= set(system) for system in scene.systems):
        return in_system(scene, view, scene.system_of(x, y), x, y)
    return in_system(scene, view, scene.system_of(x if x != view.x else y), x, y)


def _select(name: str, options: dict[str, Any], about: str) -> Any:
    return pn.widgets.Select(name=name, options=options, description=HELP[about], **WIDE)


def _named(tolerances: Iterable[float]) -> dict[str, float]:
    return {f"{rtol:.3g}": rtol for rtol in tolerances}


class _Slider(pn.widgets.FloatSlider):
    """A slider that reports its moves without delay."""

    _debounce: ClassVar[int] = 0
    """Milliseconds until Panel reports a move; its default is 50."""


class _Value:
    """A slider of a quantity with its ends, its exact value as text, and a button to play it."""

    def __init__(self, name: str, quantity: Quantity, on_value: Callable[[str, Any], None]) -> None:
        symbol, low, high = quantity.symbol, quantity.low, quantity.high
        self._name = name
        self._step = rounded_up((high - low) / STEPS, (1, 2, 5, 10))
        self._slider = _Slider(
            name=symbol,
            start=low,
            end=high,
            step=self._step,
            value=quantity.default,
            show_value=False,
            css_classes=[f"dt-slider-{name}"],
            **WIDE,
        )
        self._text = pn.widgets.TextInput(
            name=" ", css_classes=[f"dt-value-{name}"], width=90, description=quantity.meaning
        )
        self._play = pn.widgets.Toggle(
            name="▶", css_classes=[f"dt-play-{name}"], width=38, margin=(21, 0, 0, 5)
        )
        self._play.jscallback(args={"slider": self._slider, "play": self._play}, value=PLAY)
        self._scale = html(texts.scale(name, low, high), margin=(-8, 10, 0, 10))
        self._slider.param.watch(lambda event: on_value(name, self._rounded(event.new)), "value")
        self._text.param.watch(lambda event: on_value(name, event.new), "value")
        slider = pn.Column(self._slider, self._scale, **WIDE)
        self.layout = pn.Row(self._play, slider, self._text, styles={"flex": "1 1 290px"})

    def _rounded(self, value: float) -> float:
        """Return a multiple of the step, without the rounding errors of the browser's sum."""
        slider = self._slider
        if value in (slider.start, slider.end):
            return value
        return float(f"{round(value / self._step) * self._step:.12g}")

    def show(self, value: float) -> None:
        slider = self._slider
        ends = {"start": min(slider.start, value), "end": max(slider.end, value)}
        # A value that the browser has is not sent back: meanwhile the user has moved on.
        is_known = abs(slider.value - value) < 1e-6 * self._step
        slider.param.update(**ends, value=slider.value if is_known else value)
        self._text.value = as_text(value).replace("π", "pi")
        self._scale.object = texts.scale(self._name, slider.start, slider.end)


class _Ends:
    """Text fields for the ends of an axis."""

    def __init__(self, axis: str, on_range: Callable[[str, str, str], None]) -> None:
        self._texts = [pn.widgets.TextInput(stylesheets=[FULL], **WIDE) for _ in range(2)]
        for text in self._texts:
            text.param.watch(
                lambda _: on_range(axis, self._texts[0].value, self._texts[1].value), "value"
            )
        self.layout = pn.Row(*self._texts)

    def show(self, symbol: str, span: tuple[float, float]) -> None:
        for text, word, end in zip(self._texts, ("from", "to"), span, strict=True):
            text.param.update(name=f"{symbol} {word}", value=_exact(end))


def _exact(value: float) -> str:
    """Return a number with all its digits, or as a multiple of π."""
    text = as_text(value).replace("π", "pi")
    return text if number_in(text) == value else repr(value)
