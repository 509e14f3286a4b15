"""A page: the maps of a view, its controls, and the start that was clicked."""

import asyncio
import functools
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import panel as pn

from .._base.refusals import one_line
from . import texts
from .controls import Controls
from .curves import CurvePlots
from .downloads import FORMATS, file_of
from .drawing import Drawing
from .fair_queue import Turns
from .maps import Maps
from .pictures import Picture
from .recipes import code_of
from .scenes import Scene
from .starts import motion_of, path_of, slopes_of, verdict_of
from .views import (
    EXAMPLES,
    Range,
    View,
    address_of,
    cells_of,
    first_view,
    view_at,
    whole_ranges,
    zoomed,
)

CSS = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
PATIENCE = 5.0
"""Seconds after which a browser that has not confirmed a picture is sent another one."""
SETTLED = 0.6
"""Seconds without a change of the view after which its start is computed again."""
AHEAD = 2
"""Number of pictures that may be in progress before the browser has confirmed one."""


@dataclass(frozen=True)
class Workshop:
    """The objects that all pages of an explorer share."""

    scene: Scene
    drawing: Drawing
    turns: Turns = field(default_factory=Turns)
    """The work of pictures."""
    starts: Turns = field(default_factory=Turns)
    """The work of chosen starts."""


class Outlet:
    """A queue of changes of a page, which run in the thread that the page belongs to.

    On a server this is its event loop: changes run at the next opportunity, and no session waits
    for another one's work. In a notebook it is the loop of the kernel: changes run between the
    cells, since the messages of two threads would mix. There, changes of Bokeh's models must be
    sent explicitly.
    """

    def __init__(self, panes: list[Any]) -> None:
        document: Any = pn.state.curdoc
        self.is_served = bool(document and document.session_context)
        """Whether the page is a session of a server."""
        self._loop, self._thread = asyncio.get_running_loop(), threading.get_ident()
        # Called in the loop's thread, too: of what another thread adds to a document, some is lost
        # while Panel changes it.
        self._run = document.add_next_tick_callback if self.is_served else self._changed
        self._panes = panes

    def post(self, change: Callable[[], None]) -> None:
        """Run a change of the page, asked for by any thread."""
        self._loop.call_soon_threadsafe(self._run, change)

    def run(self, change: Callable[[], None]) -> None:
        """Run a change in the thread of the page, and wait for its end."""
        if threading.get_ident() == self._thread:
            change()
            return

        async def changed() -> None:
            change()

        asyncio.run_coroutine_threadsafe(changed(), self._loop).result()

    def _changed(self, change: Callable[[], None]) -> None:
        change()
        pn.io.push_notebook(*self._panes)


class _Layout(pn.Column):
    """A column that takes what a browser sends to a notebook in the thread of the page.

    JupyterLab delivers messages in another thread, and Panel takes what the page changes meanwhile
    for moves of the user. Panel also loses the events of a message that follow the first one to
    change the page; so it is given one event at a time.
    """

    outlet: Outlet

    def _on_msg(self, ref: str, manager: Any, msg: dict[str, Any]) -> None:
        def take() -> None:
            for event in msg["content"]["events"]:
                part = msg | {"content": msg["content"] | {"events": [event]}}
                super(_Layout, self)._on_msg(ref, manager, part)

        self.outlet.run(take)


class Page:
    """One user's page.

    Args:
        workshop: the objects that it shares with other pages.
        view: the first view.
        on_picture: called with every finished picture.
    """

    def __init__(
        self, workshop: Workshop, view: View, on_picture: Callable[[Picture], None]
    ) -> None:
        scene = workshop.scene
        self._workshop, self._on_picture = workshop, on_picture
        self.view, self._ended = zoomed(scene, view, view.ranges)
        """The view shown, and the axes on which rounding ends the zoom."""
        self._asked, self._asked_at = 0, 0.0
        """The number of the last picture asked for, and the time when it was."""
        self._has, self._has_changed = 0, False
        """The number of the last picture that the browser has, and whether the view is newer."""
        self._inspected = 0
        """The number of the last start that was chosen."""
        self._completed = 0
        """The number of the last start of which all is shown."""
        self._chosen: tuple[dict[str, float], View, int] | None = None
        """The last start, with the view and the number of the map in which it was chosen."""
        self._picture: Picture | None = None
        """The last finished picture."""
        symbols = texts.symbols_of(scene)
        self._maps = Maps(symbols, self._zoom, self._inspect, self._drawn)
        self._controls = Controls(scene, self._change, self._refuse)
        self._curves = CurvePlots()
        self._refusal, self._status, self._legend = _html(), _html(), _html()
        self._captions = [_html(), _html()]
        self._verdict, self._slopes, self._code = _html(), _html(), _html()
        self._outlet = Outlet([*self._maps.panes, *self._curves.panes])
        self.layout = self._laid_out()
        self._controls.show(self.view)
        self._show_maps()
        self._location = pn.state.location if self._outlet.is_served else None
        # Changes made while the browser is still loading the page would not reach it.
        if self._outlet.is_served:
            pn.state.onload(self._ask)
        else:
            self._draw_at_once()
            self._maps.once_loaded(self._ask)

    def _laid_out(self) -> Any:
        whole = pn.widgets.Button(name="Whole range", width=130)
        write = pn.widgets.Button(name="Write code", width=130)
        whole.on_click(lambda _: self._zoom(None))
        write.on_click(lambda _: self._write())
        files = [
            pn.widgets.FileDownload(
                callback=functools.partial(self._file, suffix),
                filename=f"dipoletop-map.{suffix}",
                label=suffix.upper(),
                width=85,
            )
            for suffix in FORMATS
        ]
        examples = pn.widgets.Select(
            name="Examples", options=["", *EXAMPLES], sizing_mode="stretch_width"
        )
        examples.visible = self._workshop.scene.is_top
        examples.param.watch(lambda event: self._open_example(event.new), "value")
        wide: Any = {"sizing_mode": "stretch_width"}
        maps = zip(self._maps.panes, self._captions, strict=True)
        boxes = [_box(pane, caption, flex="1 1 380px") for pane, caption in maps]
        self._second = boxes[1]
        start = pn.FlexBox(
            _box(self._verdict, self._slopes, flex="1 1 270px", width=270),
            _box(self._curves.omega, self._curves.energy, flex="2 1 380px"),
            self._curves.body,
            **wide,
        )
        self._start = pn.Column(start, visible=False, **wide)
        main = pn.Column(
            self._controls.sliders,
            self._refusal,
            pn.FlexBox(*boxes, **wide),
            self._legend,
            self._status,
            styles={"flex": "1 1 320px", "min-width": "300px"},
        )
        side = pn.Column(
            examples, self._controls.layout, pn.Row(whole, write), pn.Row(*files), width=310
        )
        layout = _Layout(
            _html(texts.HEAD),
            # On a narrow screen the maps come before the controls.
            pn.FlexBox(side, main, flex_wrap="wrap-reverse", align_items="flex-end", **wide),
            self._start,
            self._code,
            **wide,
        )
        layout.outlet = self._outlet
        return layout

    def close(self) -> None:
        """Compute nothing more for this page."""
        self._workshop.turns.drop(self)
        self._workshop.starts.drop(self)

    # Actions of the user.

    def _change(self, view: View) -> None:
        """Show another view."""
        self.view, self._ended = view, ()
        self._show_maps()
        self._ask()

    def _zoom(self, ranges: dict[str, Range] | None) -> None:
        """Show other ranges of the axes, or the whole ones."""
        scene, before = self._workshop.scene, self.view
        wanted = whole_ranges(scene, before.x, before.y)
        if ranges is not None:
            wanted = {before.x: ranges["x"], before.y: ranges["y"]}
        try:
            self.view, self._ended = zoomed(scene, before, wanted)
        except ValueError as error:
            self._refuse(str(error))
            return
        self._controls.show(self.view)
        self._maps.mark_axes(self.view)
        # The browser already shows the ranges it asked for, and may have moved on since.
        if ranges is None or self.view.ranges != wanted:
            self._show_maps()
        if self.view != before or self._ended:
            self._ask()

    def _open_example(self, name: str) -> None:
        """Show an example, with its start."""
        if not name:
            return
        scene, (query, start) = self._workshop.scene, EXAMPLES[name]
        fresh = first_view(scene, levels=scene.at_first, size=self.view.size)
        view = view_at(scene, fresh, parse_qs(query))
        self._chosen = None
        self._controls.show(view)
        self._change(replace(view, values=view.values | start))

    def _file(self, suffix: str) -> Any:
        """Return the finished picture as a file."""
        if self._picture is None:
            return None
        view = self._picture.view
        folded = cells_of(self._workshop.scene, view, view.size).folded
        return file_of(self._picture, folded, suffix)

    def _write(self) -> None:
        """Show the code of the view."""
        scene, view = self._workshop.scene, self.view
        self._code.object = texts.code(code_of(scene, view), address_of(view))

    def _refuse(self, sentence: str) -> None:
        self._refusal.object = texts.refused(sentence) if sentence else ""

    # Pictures.

    def _show_maps(self) -> None:
        """Show the ranges of the view on the maps."""
        view = self.view
        self._maps.look_at(view, whole_ranges(self._workshop.scene, view.x, view.y))
        self._second.visible = len(view.levels) == 2

    def _ask(self) -> None:
        """Ask for pictures of the view, unless the browser lags behind."""
        lags = self._asked - self._has >= AHEAD
        self._curves.pause()
        self._workshop.starts.drop(self)  # until the picture is there
        self._has_changed = lags and time.monotonic() < self._asked_at + PATIENCE
        if self._has_changed:
            return
        self._code.object = ""  # it belongs to an earlier view
        self._asked += 1
        self._asked_at = time.monotonic()
        number, outlet = self._asked, self._outlet

        def show(picture: Picture) -> None:
            outlet.post(lambda: self._show(picture, number))

        def fail(error: Exception) -> None:
            outlet.post(lambda: self._fail(error))

        work = self._workshop.drawing.pictures(self.view, show, fail)
        self._workshop.turns.put(self, work)

    def _show(self, picture: Picture, number: int) -> None:
        view = self.view
        if (picture.view.x, picture.view.y) != (view.x, view.y):
            self._drawn(number)
            return
        self._maps.show(picture, number)
        self._legend.object = texts.legend(picture)
        self._status.object = texts.status(self._workshop.scene, picture, self._ended)
        for k, caption in enumerate(self._captions[: len(picture.basins)]):
            caption.object = texts.caption(picture, k)
        if picture.is_final:
            self._picture = picture
            self._on_picture(picture)
            self._follow()
            if self._location is not None:
                self._location.search = address_of(view)

    def _draw_at_once(self) -> None:
        """Draw a first picture here and now, which a notebook also keeps without its kernel."""
        drawing = self._workshop.drawing
        next(drawing.pictures(self.view, lambda found: self._show(found, 0), self._fail), None)

    def _fail(self, error: Exception) -> None:
        self._refuse(_sentence(error))
        self._drawn(self._asked)

    def _drawn(self, number: int) -> None:
        """Note that the browser has a picture, and ask for the next one if the view has changed."""
        self._has = number
        if self._has_changed:
            self._ask()

    # The start that was clicked.

    def _inspect(self, number: int, x: float, y: float) -> None:
        """Choose a start that was clicked."""
        view = self.view
        (low, high), (bottom, top) = view.ranges[view.x], view.ranges[view.y]
        if not (low <= x <= high and bottom <= y <= top):
            return
        self._choose(view.values | {view.x: x, view.y: y}, number)

    def _follow(self) -> None:
        """Show the chosen start at the values of the view; at first that of the defaults."""
        view = self.view
        values, before, number = self._chosen or (view.values, None, 0)
        if set(values) != set(view.values):  # starts are given by other quantities now
            values, before = view.values, None
        values = values | view.fixed
        inside = all(low <= values[n] <= high for n, (low, high) in view.ranges.items())
        if before is not None:
            place = (values[view.x], values[view.y]) if inside else None
            same = bool(self._chosen) and values == self._chosen[0]
            same = same and self._completed == self._inspected
            if same and (before.levels, before.rtol) == (view.levels, view.rtol):
                if (before.x, before.y) != (view.x, view.y):
                    self._maps.mark(place)
                return
        elif not inside:
            return
        self._choose(values, number, SETTLED if self._chosen else 0.0)

    def _choose(self, values: dict[str, float], number: int, delay: float = 0.0) -> None:
        """Show how a start ends, and how it moves at the level of a map, after some seconds."""
        view = self.view
        self._inspected += 1
        self._chosen = values, view, number
        self._maps.mark((values[view.x], values[view.y]))
        self._start.visible = True
        self._verdict.object = texts.waiting("Verdict")
        self._slopes.object = texts.waiting("Motion and derivatives")
        work = self._computed(self._inspected, view, values, number, delay)
        self._workshop.starts.put(self, work)

    def _computed(
        self, number: int, view: View, values: dict[str, float], which: int, delay: float
    ) -> Iterator[float]:
        """Compute verdict, motion and derivatives of a start, piece by piece."""
        workshop = self._workshop
        scene, levels = workshop.scene, view.levels or (None,)
        which = min(which, len(levels) - 1)

        def show(change: Callable[[], None]) -> None:
            self._outlet.post(lambda: change() if number == self._inspected else None)

        if delay:
            yield time.monotonic() + delay
        try:
            found = [verdict_of(workshop.drawing, level, values, view.rtol) for level in levels]
            show(lambda: _set(self._verdict, texts.verdicts(scene, values, found)))
            yield 0.0
            problem, chosen = scene.problem_at(levels[which]), found[which]
            motion = motion_of(problem, values, chosen, min(view.rtol, 1e-8))
            show(lambda: self._curves.show(motion))
            path = path_of(motion, view)
            show(lambda: self._maps.trace(*path))
            note = texts.length_of(motion)
            yield 0.0
            slopes = slopes_of(problem, values, min(view.rtol, 1e-8))
            show(lambda: _set(self._slopes, note + texts.slopes(scene, chosen.level, slopes)))
            show(lambda: setattr(self, "_completed", number))
        except Exception as error:  # the thread works for other pages, too
            sentence = _sentence(error)
            show(lambda: _set(self._slopes, texts.refused(sentence)))


def _box(*panes: Any, flex: str, width: int = 290) -> Any:
    return pn.Column(*panes, min_width=width, styles={"flex": flex})


def _html(text: str = "") -> Any:
    return pn.pane.HTML(text, stylesheets=[CSS], sizing_mode="stretch_width", margin=(3, 10))


def _set(pane: Any, text: str) -> None:
    pane.object = text


def _sentence(error: Exception) -> str:
    """Return one line that says what failed."""
    if isinstance(error, ValueError | RuntimeError):
        return one_line(error)
    return f"This failed: {type(error).__name__}: {one_line(error)}"


def refusal_page(sentence: str) -> Any:
    """Return the page shown for an address that is refused."""
    return _html(f'{texts.refused(sentence)}<p><a href="?">Open the page without it</a></p>')
