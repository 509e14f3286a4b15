"""The successive pictures of a view: coarse at first, finally at its size and tolerance."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.tolerances import MAX_STEPS
from .._maps.basin import Basin
from .._maps.grids import Grid, Points
from .._maps.sweep import prepared_sweep
from .._runs.classification import UNCHECKED, Value
from .._runs.run_settings import RunSettings
from ..equations.levels import Level
from .edges import FINER, finer_basin, starts_at_edges
from .pictures import Picture, picture_of
from .scenes import Scene
from .views import FINEST, Cells, View, cells_of, finest_step

QUICK = 0.06
"""Seconds that the starts of a first picture may take."""
LONGEST = 1.0
"""Seconds that a picture between the first and the last one may take."""
FEW_STEPS = 2000
"""Largest number of steps of a run in these preliminary pictures."""
LOOSE = 1e-5
"""Relative tolerance of the preliminary pictures."""
OVERHEAD = 0.003
"""Seconds that a sweep takes even with very few starts."""
PIECE = 0.1
"""Seconds of a piece of work, after which other pages have their turn."""
REST = 0.1
"""Seconds without a change after which a picture is refined."""
EPSILON = 2.0**-52
FEWEST = 16
"""Starts on a side of the coarsest picture, and of a first one whose cost is unknown."""
ENOUGH = 256
"""Largest size of a picture whose edges are made finer; larger ones have more than screens show."""
AT_ONCE = 2048
"""Starts at edges in a piece of work: always as many, since every other number is traced anew."""


class Drawing:
    """Sweeps of a scene, prepared once for all pages, with their measured costs."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._prepared: dict[Any, Callable[[Any, float], Basin]] = {}
        self._preparing = threading.Lock()
        self._cost: dict[Any, float] = {}
        """Seconds for each start, by level and by requested value."""

    def sweep(
        self,
        level: Level | None,
        over: Grid | Points,
        rtol: float,
        value: Value,
        max_steps: int = MAX_STEPS,
    ) -> Basin:
        """Return the basin over a grid, or over points, at a level.

        Raises:
            ValueError: as by `sweep`.
        """
        given = over.axes if isinstance(over, Grid) else over.columns
        key = level, type(over), tuple(given), value, max_steps
        with self._preparing:
            if key not in self._prepared:
                settings = RunSettings(value=value, max_steps=max_steps)
                prepared = prepared_sweep(self._scene.problem_at(level), over, settings)
                first = type(over)(**{name: values[:1] for name, values in given.items()})
                prepared(first, rtol)  # compiles, so that later runs show their cost
                self._prepared[key] = prepared
        return self._prepared[key](over, rtol)

    def pictures(
        self, view: View, show: Callable[[Picture], None], fail: Callable[[Exception], None]
    ) -> Iterator[float]:
        """Compute pictures piece by piece, and call `show` with each, or `fail` with an error.

        Yields:
            After each piece, the `time.monotonic()` before which the next one need not begin.
        """
        began = time.monotonic()
        try:
            size, is_new = self._quick_size(view, QUICK), self._quick_cost(view, 2) == math.inf
            show(self._quick(view, size))
            if is_new:  # the first sweep compiled, which does not belong to the cost
                for level in _levels(view):
                    del self._cost[level, UNCHECKED]
                self._quick(view, size)
            yield began + REST
            larger = self._quick_size(view, LONGEST)
            if larger > size:
                show(self._quick(view, larger))
                yield 0.0
            cells, basins = cells_of(self._scene, view, view.size), []
            for level in _levels(view):
                parts, row = [], 0
                while row < cells.rows:
                    rows = slice(row, row + self._rows_of_piece(cells, level))
                    parts.append(self._timed(level, cells.piece(rows), view.rtol, True))
                    row = rows.stop
                    yield 0.0
                basins.append(_joined(parts, cells.grid))
            picture = picture_of(view, basins, cells.folded, view.size, True)
            show(picture)
            if view.size <= ENOUGH and finest_step(view) > FINER * FINEST * EPSILON:
                yield time.monotonic() + REST
                yield from self._finer(picture, cells.folded, show)
        except Exception as error:  # the thread works for other pages, too
            fail(error)

    def _finer(
        self, picture: Picture, folded: bool, show: Callable[[Picture], None]
    ) -> Iterator[float]:
        """Compute the edges of a finished picture finer than its pixels, piece by piece."""
        view, basins = picture.view, []
        finer = cells_of(self._scene, view, FINER * view.size)
        for level, basin in zip(_levels(view), picture.basins, strict=True):
            index, found = starts_at_edges(basin), []
            if index.size > finer.count / 2:  # edges everywhere
                return
            for part in np.resize(index, (-(-index.size // AT_ONCE), AT_ONCE)):
                yield 0.0
                points = Points(**finer.grid.points(part))
                found.append(self.sweep(level, points, view.rtol, UNCHECKED))
            basins.append(finer_basin(basin, finer.grid, index, found))
        fine = picture_of(view, basins, folded, view.size, True)
        show(fine._replace(basins=picture.basins, has_fine_edges=True))

    def _quick(self, view: View, size: int) -> Picture:
        """Return a picture computed with a loose tolerance, without error estimates.

        Labels are wrong only within a small fraction of the tolerance from a boundary; this is
        invisible unless the starts are equally close.
        """
        rtol = max(view.rtol, LOOSE) if finest_step(view) > LOOSE else view.rtol
        cells = cells_of(self._scene, view, size)
        basins = [self._timed(level, cells.grid, rtol, UNCHECKED) for level in _levels(view)]
        return picture_of(view, basins, cells.folded, size, False)

    def _timed(self, level: Level | None, grid: Grid, rtol: float, value: Value) -> Basin:
        basin = self.sweep(level, grid, rtol, value, FEW_STEPS if value == UNCHECKED else MAX_STEPS)
        key, cost = (level, value), max(basin.seconds - OVERHEAD, 0.0) / basin.outcome.size
        self._cost[key] = (self._cost.get(key, cost) + cost) / 2
        return basin

    def _quick_cost(self, view: View, size: int) -> float:
        """Return the seconds that the starts of a quick picture take; infinite if unknown."""
        costs = [self._cost.get((level, UNCHECKED), math.inf) for level in _levels(view)]
        return sum(costs) * cells_of(self._scene, view, size).count

    def _quick_size(self, view: View, seconds: float) -> int:
        """Return the largest size, the view's size over a power of two, that takes no longer."""
        size = view.size
        while size > FEWEST and self._quick_cost(view, size) > seconds:
            size //= 2
        return size

    def _rows_of_piece(self, cells: Cells, level: Level | None) -> int:
        """Return how many rows are expected to take no longer than `PIECE`."""
        quick = self._cost.get((level, UNCHECKED), 0.0)
        row = self._cost.get((level, True), 2 * quick) * cells.count / cells.rows
        rows = max(int(PIECE / row), 1) if row > 0 else cells.rows
        return 1 << (rows.bit_length() - 1)  # few sizes, since each is traced once


def _levels(view: View) -> tuple[Level | None, ...]:
    return view.levels or (None,)


def _joined(parts: list[Basin], grid: Grid) -> Basin:
    """Return the basin over a grid from those over its rows."""
    names = parts[0].columns
    columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in names}
    seconds = sum(part.seconds for part in parts)
    whole = {"shape": grid.shape, "coords": grid.coords, "columns": columns}
    return replace(parts[0], **whole, seconds=seconds)
