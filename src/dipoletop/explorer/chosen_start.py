"""The start that was chosen on a page: how it ends, how it moves, the derivatives of ω∞."""

import time
from collections.abc import Callable, Hashable, Iterator
from typing import NamedTuple

import panel as pn

from .._base.refusals import one_line
from . import texts
from .curves import CurvePlots
from .maps import Maps
from .page_thread import Outlet
from .pieces import WIDE, box, html
from .starts import motion_of, path_of, slopes_of, verdict_of
from .views import View
from .workshop import Workshop

SETTLED = 0.6
"""Seconds without a change of the view after which its start is computed again."""


class ChosenStart:
    """The chosen start of a page, at first that of the defaults; it follows the view.

    Args:
        workshop: the objects that all pages share.
        outlet: the queue of changes of the page.
        maps: the maps, which mark the start and its path.
        curves: the figures of its motion.
        page: the user of the workshop.
    """

    def __init__(
        self, workshop: Workshop, outlet: Outlet, maps: Maps, curves: CurvePlots, page: Hashable
    ) -> None:
        self._workshop, self._outlet, self._page = workshop, outlet, page
        self._maps, self._curves = maps, curves
        self._chosen: _Choice | None = None
        self._number, self._completed = 0, 0
        """The numbers of the last start that was chosen, and of the last that is wholly shown."""
        self._verdict, self._slopes = html(), html()
        shown = pn.FlexBox(
            box(self._verdict, self._slopes, flex="1 1 270px", width=270),
            box(curves.omega, curves.energy, flex="2 1 380px"),
            curves.body,
            **WIDE,
        )
        self.layout = pn.Column(shown, visible=False, **WIDE)

    def wait(self) -> None:
        """Compute nothing further until the start is chosen again, or follows."""
        self._curves.pause()
        self._workshop.starts.drop(self._page)

    def forget(self) -> None:
        """Let the next start that follows be that of the view."""
        self._chosen = None

    def follow(self, view: View) -> None:
        """Show the chosen start at the values of the view."""
        chosen = self._chosen
        # Starts may be given by other quantities now.
        known = chosen is not None and set(chosen.values) == set(view.values)
        values = (chosen.values if chosen and known else view.values) | view.fixed
        inside = all(low <= values[n] <= high for n, (low, high) in view.ranges.items())
        if chosen and known:
            before, is_shown = chosen.view, self._completed == self._number
            same = is_shown and values == chosen.values
            if same and (before.levels, before.rtol) == (view.levels, view.rtol):
                if (before.x, before.y) != (view.x, view.y):
                    self._maps.mark((values[view.x], values[view.y]) if inside else None)
                return
        elif not inside:
            return
        self.choose(view, values, chosen.number if chosen else 0, SETTLED if chosen else 0.0)

    def choose(self, view: View, values: dict[str, float], number: int, delay: float = 0.0) -> None:
        """Show how a start ends, and how it moves at the level of a map, after some seconds."""
        self._number += 1
        self._chosen = _Choice(values, view, number)
        self._maps.mark((values[view.x], values[view.y]))
        self.layout.visible = True
        self._verdict.object = texts.waiting("Verdict")
        self._slopes.object = texts.waiting("Motion and derivatives")
        work = self._computed(self._number, self._chosen, delay)
        self._workshop.starts.put(self._page, work)

    def _computed(self, number: int, choice: "_Choice", delay: float) -> Iterator[float]:
        """Compute verdict, motion and derivatives of a start, piece by piece."""
        values, view, which = choice
        scene, levels = self._workshop.scene, view.levels or (None,)
        which = min(which, len(levels) - 1)

        def show(change: Callable[[], None]) -> None:
            self._outlet.post(lambda: change() if number == self._number else None)

        if delay:
            yield time.monotonic() + delay
        try:
            drawing = self._workshop.drawing
            found = [verdict_of(drawing, level, values, view.rtol) for level in levels]
            verdicts = texts.verdicts(scene, values, found)
            show(lambda: self._verdict.param.update(object=verdicts))
            yield 0.0
            problem, chosen = scene.problem_at(levels[which]), found[which]
            motion = motion_of(problem, values, chosen, min(view.rtol, 1e-8))
            show(lambda: self._curves.show(motion))
            path = path_of(motion, view)
            show(lambda: self._maps.trace(*path))
            note = texts.length_of(motion)
            yield 0.0
            slopes = slopes_of(problem, values, min(view.rtol, 1e-8))
            note += texts.slopes(scene, chosen.level, slopes)
            show(lambda: self._slopes.param.update(object=note))
            show(lambda: setattr(self, "_completed", number))
        except Exception as error:  # the thread works for other pages, too
            refused = texts.refused(sentence_of(error))
            show(lambda: self._slopes.param.update(object=refused))


class _Choice(NamedTuple):
    """A start, with the view and the number of the map in which it was chosen."""

    values: dict[str, float]
    view: View
    number: int


def sentence_of(error: Exception) -> str:
    """Return one line that says what failed."""
    if isinstance(error, ValueError | RuntimeError):
        return one_line(error)
    return f"This failed: {type(error).__name__}: {one_line(error)}"
