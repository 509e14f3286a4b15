"""A page: the maps of a view, its controls, and the start that was clicked."""

import functools
import time
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qs

import panel as pn

from . import texts
from .chosen_start import ChosenStart, sentence_of
from .controls import Controls
from .curves import CurvePlots
from .downloads import FORMATS, file_of
from .maps import Maps
from .page_thread import Outlet, PageLayout
from .pictures import Picture
from .pieces import WIDE, box, html
from .recipes import code_of
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
from .workshop import Workshop

OTHER_THEME = f"""
const query = new URLSearchParams(window.location.search)
if (query.has("{texts.THEME}")) query.delete("{texts.THEME}")
else query.set("{texts.THEME}", "{texts.DARK}")
window.location.search = query"""
PATIENCE = 5.0
"""Seconds after which a browser that has not confirmed a picture is sent another one."""
AHEAD = 2
"""Number of pictures that may be in progress before the browser has confirmed one."""


class Page:
    """One user's page.

    Args:
        workshop: the objects that it shares with other pages.
        view: the first view.
    """

    def __init__(self, workshop: Workshop, view: View) -> None:
        self._workshop, scene = workshop, workshop.scene
        self.view, self._ended = zoomed(scene, view, view.ranges)
        """The view shown, and the axes on which rounding ends the zoom."""
        self._asked, self._asked_at = 0, 0.0
        """The number of the last picture asked for, and the time when it was."""
        self._has, self._has_changed = 0, False
        """The number of the last picture that the browser has, and whether the view is newer."""
        self._picture: Picture | None = None
        """The last finished picture."""
        self._maps = Maps(scene.symbols, self._zoom, self._inspect, self._drawn)
        self._controls = Controls(scene, self._change, self._refuse)
        self._curves = CurvePlots()
        self._refusal, self._status, self._legend = html(), html(), html()
        self._captions = [html(), html()]
        self._code = html()
        self._outlet = Outlet([*self._maps.panes, *self._curves.panes])
        self._start = ChosenStart(workshop, self._outlet, self._maps, self._curves, self)
        self.layout = self._laid_out()
        self._controls.show(self.view)
        self._show_maps()
        self._location = pn.state.location if self._outlet.is_served else None
        # Changes made while the browser is still loading the page would not reach it.
        if self._outlet.is_served:
            pn.state.onload(self._ask)
            pn.state.on_session_destroyed(lambda _: self._close())
        else:
            self._draw_at_once()
            self._maps.once_loaded(self._ask)

    def _laid_out(self) -> Any:
        whole = pn.widgets.Button(name="Whole range", width=130)
        write = pn.widgets.Button(name="Write code", width=130)
        theme = pn.widgets.Button(name="Dark or light", width=130, visible=self._outlet.is_served)
        theme.js_on_click(code=OTHER_THEME)
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
        examples = pn.widgets.Select(name="Examples", options=["", *EXAMPLES], **WIDE)
        examples.visible = self._workshop.scene.is_top
        examples.param.watch(lambda event: self._open_example(event.new), "value")
        maps = zip(self._maps.panes, self._captions, strict=True)
        boxes = [box(pane, caption, flex="1 1 380px") for pane, caption in maps]
        self._second = boxes[1]
        main = pn.Column(
            self._controls.sliders,
            self._refusal,
            pn.FlexBox(*boxes, **WIDE),
            self._legend,
            self._status,
            styles={"flex": "1 1 320px", "min-width": "300px"},
        )
        side = pn.Column(
            examples,
            self._controls.layout,
            pn.Row(whole, write),
            pn.Row(*files),
            theme,
            width=310,
        )
        layout = PageLayout(
            html(texts.HEAD),
            # On a narrow screen the maps come before the controls.
            pn.FlexBox(side, main, flex_wrap="wrap-reverse", align_items="flex-end", **WIDE),
            self._start.layout,
            self._code,
            **WIDE,
        )
        layout.outlet = self._outlet
        return layout

    def _close(self) -> None:
        """Compute nothing more for this page."""
        self._workshop.turns.drop(self)
        self._start.wait()

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
        self._start.forget()
        self._controls.show(view)
        self._change(replace(view, values=view.values | start))

    def _file(self, suffix: str) -> Any:
        """Return the finished picture as a file."""
        if self._picture is None:
            return None
        view = self._picture.view
        folded = cells_of(self._workshop.scene, view, view.size).folded
        return file_of(self._picture, folded, suffix)

    def _inspect(self, number: int, x: float, y: float) -> None:
        """Choose a start that was clicked."""
        view = self.view
        (low, high), (bottom, top) = view.ranges[view.x], view.ranges[view.y]
        if low <= x <= high and bottom <= y <= top:
            self._start.choose(view, view.values | {view.x: x, view.y: y}, number)

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
        self._start.wait()  # until the picture is there
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
        if picture.has_fine_edges:
            return  # everything else is known
        self._legend.object = texts.legend(picture)
        self._status.object = texts.status(self._workshop.scene, picture, self._ended)
        for k, caption in enumerate(self._captions[: len(picture.basins)]):
            caption.object = texts.caption(picture, k)
        if picture.is_final:
            self._picture = self._workshop.picture = picture
            self._start.follow(view)
            if self._location is not None:
                dark = f"&{texts.THEME}={texts.DARK}" if pn.config.theme == texts.DARK else ""
                self._location.search = address_of(view) + dark

    def _draw_at_once(self) -> None:
        """Draw a first picture here and now, which a notebook also keeps without its kernel."""
        drawing = self._workshop.drawing
        next(drawing.pictures(self.view, lambda found: self._show(found, 0), self._fail), None)

    def _fail(self, error: Exception) -> None:
        self._refuse(sentence_of(error))
        self._drawn(self._asked)

    def _drawn(self, number: int) -> None:
        """Note that the browser has a picture, and ask for the next one if the view has changed."""
        self._has = number
        if self._has_changed:
            self._ask()


def refusal_page(sentence: str) -> Any:
    """Return the page shown for an address that is refused."""
    return html(f'{texts.refused(sentence)}<p><a href="?">Open the page without it</a></p>')
