"""Maps that integrate next to the basin boundaries only, and fill in the rest."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ._base.checks import finite, refuse
from ._base.tolerances import budget, check_settings
from ._base.types import Outcome
from ._maps.basin import Basin
from ._maps.columns import COLUMNS
from ._maps.grids import Grid, Points
from ._maps.sweep import Problem, sweep
from .boundary import fate

Cells = Int[np.ndarray, "_ 2"]
"""Cells of a lattice by the numbers of their first row and column."""

PARTS = (65536, 8192, 1024)  # points in one sweep, at most; at least half of it but for the last
PIXELS = 1 << 20  # filled in at once, at most: what bounds the memory


def refine(
    problem: Problem, grid: Grid, *, coarse: Any = 64, omega_tol: Any = None, **settings: Any
) -> Basin:
    """The map of `sweep(problem, grid)` from far fewer runs: those next to the boundaries.

    A lattice of about `coarse` × `coarse` cells is integrated; cells whose corners differ in
    their `fate` are halved, down to the grid itself. Whenever such a cell is found, its
    neighbours of the same size are examined too, so that a boundary is followed wherever it
    goes. What is left is filled in from the corners of its cell: labels as they are, ω∞ and τ
    bilinear, `steps` 0, `certified` where all four are.

    **What can be missed:** an island smaller than a coarse cell that no corner falls into and
    that touches nothing that was found; so, too, single points such as a start exactly on an axis,
    or what is thinner than the spacing of the grid. A larger `coarse` lowers the risk.

    Args:
        problem: as in `sweep`.
        grid: two axes of numbers that grow, and any number of axes of length 1.
        coarse: least number of cells along each axis to begin with.
        omega_tol: also halve the cells at whose centre the interpolated ω∞ is off by more than
            this, or where the fate is another one; None means to look at no centre.
        settings: rtol, atol, max_steps, devices and engine, as in `sweep`.

    Returns:
        A `Basin` over `grid` in memory with one more column, `computed`: whether the point was
        integrated. Such points are integrated once, exactly where `sweep` would do it; only
        rounding (the last digits of ω∞ and τ) can depend on which runs share a block. `attrs`
        hold the number of them, `computed`, and the first cells' size in points, `refined_from`.

    Raises:
        ValueError: bad arguments.

    Source: E. L. Allgower and K. Georg, Introduction to Numerical Continuation Methods (SIAM,
    2003): an implicitly defined curve, followed through the cells of a lattice.

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> def problem(w3, phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
        >>> grid = dt.Grid(w3=np.linspace(0.1, 0.4, 128), phi=np.linspace(0.0, 1.5, 128))
        >>> basin = refine(problem, grid, coarse=16)
        >>> basin.shape, bool(basin.column("computed").mean() < 0.2)
        ((128, 128), True)
    """
    began = time.perf_counter()
    check_settings(settings)
    picture = _Picture(problem, grid, settings)
    coarse = budget("coarse", coarse)
    if (
        omega_tol is not None
        and (omega_tol := float(finite("omega_tol", omega_tol, batch=False))) <= 0
    ):
        refuse("omega_tol", "be positive", f"is {omega_tol:g}")

    sizes = [1 << max(0, ((n - 1) // coarse).bit_length() - 1) for n in picture.shape]
    lattice = _Lattice(picture.shape, sizes)
    split = _examine(picture, lattice, lattice.all(), omega_tol)
    while max(lattice.sizes) > 1:
        lattice, cells = lattice.halved(split)
        split = _examine(picture, lattice, cells, omega_tol)
    return picture.basin(sizes, time.perf_counter() - began)


def _examine(
    picture: "_Picture", lattice: "_Lattice", fresh: Cells, omega_tol: float | None
) -> Cells:
    """The cells to halve, among these and all that a boundary goes on to; the others are filled."""
    seen = np.zeros(lattice.shape, bool)
    split, uniform = [], []
    while len(fresh):
        seen[tuple(fresh.T)] = True
        corners = lattice.corners(fresh)
        picture.compute(corners)
        mixed = picture.differ(corners)
        split.append(fresh[mixed])
        uniform.append(fresh[~mixed])
        around = lattice.around(fresh[mixed])
        fresh = around[~seen[tuple(around.T)]]
    found, filled = (np.concatenate(parts or [fresh]) for parts in (split, uniform))
    if omega_tol is not None and max(lattice.sizes) > 1:
        off = picture.off(lattice, filled, omega_tol)
        found, filled = np.concatenate([found, filled[off]]), filled[~off]
    picture.fill(lattice, filled)
    return found


class _Lattice:
    """Every so many rows and columns of a grid, and the last of each; cells lie between them."""

    def __init__(self, points: tuple[int, ...], sizes: list[int]) -> None:
        self.points, self.sizes = points, sizes
        self.nodes = [
            np.append(np.arange(0, n - 1, size), n - 1)
            for n, size in zip(points, sizes, strict=True)
        ]
        self.shape = tuple(len(nodes) - 1 for nodes in self.nodes)

    def all(self) -> Cells:
        """Every cell."""
        return np.argwhere(np.ones(self.shape, bool))

    def halved(self, cells: Cells) -> tuple["_Lattice", Cells]:
        """The lattice of half the size where that is more than 1, and the parts of `cells`."""
        parts = [min(2, size) for size in self.sizes]
        finer = _Lattice(self.points, [n // k for n, k in zip(self.sizes, parts, strict=True)])
        offsets = np.argwhere(np.ones(parts, bool))
        return finer, finer._inside(cells[:, None] * parts + offsets)

    def around(self, cells: Cells) -> Cells:
        """The cells and their neighbours, those across a corner too, each once."""
        near = self._inside(cells[:, None] + np.argwhere(np.ones((3, 3), bool)) - 1)
        flat = np.unique(np.ravel_multi_index(tuple(near.T), self.shape))
        return np.stack(np.unravel_index(flat, self.shape), -1)

    def _inside(self, cells: Int[np.ndarray, "m k 2"]) -> Cells:
        """Those that exist: the last cell of an axis may be shorter than the others."""
        flat = cells.reshape(-1, 2)
        return flat[np.all((flat >= 0) & (flat < self.shape), axis=1)]

    def spans(self, cells: Cells) -> tuple[Int[np.ndarray, "m 2"], ...]:
        """First and last row, and first and last column, of every cell."""
        pairs = zip(self.nodes, cells.T, strict=True)
        return tuple(np.stack([nodes[at], nodes[at + 1]], -1) for nodes, at in pairs)

    def corners(self, cells: Cells) -> Int[np.ndarray, "m 2 2"]:
        """Flat numbers of the corners."""
        rows, columns = self.spans(cells)
        return rows[:, :, None] * self.points[1] + columns[:, None, :]


class _Picture:
    """The columns of the map, and what has been integrated so far."""

    def __init__(self, problem: Problem, grid: Any, settings: dict[str, Any]) -> None:
        if not isinstance(grid, Grid):
            refuse("grid", "be a Grid", f"is {type(grid).__name__}")
        names = [name for name, n in zip(grid.dims, grid.shape, strict=True) if n > 1]
        if len(names) != 2:
            shown = ", ".join(
                f"{name} ({n})" for name, n in zip(grid.dims, grid.shape, strict=True)
            )
            refuse("grid", "have exactly two axes longer than 1", f"has {shown}")
        for name in names:
            if grid.axes[name].ndim > 1 or np.any(np.diff(grid.axes[name]) <= 0):
                refuse("grid", "have axes of numbers that grow", f"its axis {name} is another one")
        self.problem, self.grid, self.settings = problem, grid, settings
        self.values = [grid.axes[name] for name in names]
        self.shape = tuple(len(values) for values in self.values)
        self.attrs: dict[str, Any] = {}
        size = int(np.prod(self.shape))
        self.columns = {name: np.zeros(size, spec.dtype) for name, spec in COLUMNS.items()}
        self.fate = np.zeros(size, np.int8)
        self.computed = np.zeros(size, bool)

    def compute(self, wanted: Int[np.ndarray, "..."]) -> None:
        """Integrate those of the points that are not known yet."""
        new = np.unique(wanted[~self.computed[wanted]])
        for part in _parts(new):
            places = np.unravel_index(part, self.grid.shape)  # axes of length 1 change no number
            points = {
                name: values[place]
                for (name, values), place in zip(self.grid.axes.items(), places, strict=True)
            }
            found = sweep(self.problem, Points(**points), progress=False, **self.settings)
            for name in self.columns:
                self.columns[name][part] = found.column(name)
            self.fate[part] = fate(found)
            self.attrs = found.attrs
        self.computed[new] = True

    def differ(self, corners: Int[np.ndarray, "m 2 2"]) -> Bool[np.ndarray, "m"]:
        """Whether the corners have different fates."""
        fates = self.fate[corners]
        return np.any(fates != fates[:, :1, :1], axis=(1, 2))

    def off(self, lattice: _Lattice, cells: Cells, most: float) -> Bool[np.ndarray, "m"]:
        """Whether the fate at the centre is another one, or the interpolated ω∞ off by `most`."""
        corners = lattice.corners(cells)
        middles = [span.sum(-1) // 2 for span in lattice.spans(cells)]
        centres = middles[0] * self.shape[1] + middles[1]
        self.compute(centres)
        weights = self._weights(lattice.spans(cells), [m[:, None] for m in middles])
        between = _bilinear(self.columns["omega_inf"][corners], weights)[:, 0, 0]
        wrong = np.abs(between - self.columns["omega_inf"][centres]) > most
        return wrong | (self.fate[centres] != self.fate[corners[:, 0, 0]])

    def fill(self, lattice: _Lattice, cells: Cells) -> None:
        """What the corners of uniform cells say about the points within that are not known."""
        heights, widths = (np.arange(size + 1) for size in lattice.sizes)
        if len(heights) == len(widths) == 2:
            return
        at_once = max(1, PIXELS // (len(heights) * len(widths)))
        for first in range(0, len(cells), at_once):
            part = cells[first : first + at_once]
            spans, corners = lattice.spans(part), lattice.corners(part)
            steps = zip(spans, (heights, widths), strict=True)
            inner = [np.minimum(span[:, :1] + step, span[:, 1:]) for span, step in steps]
            points = inner[0][:, :, None] * self.shape[1] + inner[1][:, None, :]
            free, weights = ~self.computed[points], self._weights(spans, inner)
            alike = {name: self.columns[name][corners[:, :1, :1]] for name in ("outcome", "stop")}
            sure = self.columns["certified"][corners].all(axis=(1, 2), keepdims=True)
            error = np.where(alike["outcome"] == Outcome.RESIDUAL, np.inf, 0.0)  # not known
            for name, value in {**alike, "certified": sure, "omega_inf_error": error}.items():
                self.columns[name][points[free]] = np.broadcast_to(value, points.shape)[free]
            for name in ("omega_inf", "time"):
                between = _bilinear(self.columns[name][corners], weights)
                self.columns[name][points[free]] = between[free]

    def _weights(self, spans: Any, places: Any) -> list[Float[np.ndarray, "m _"]]:
        """How far along its cell, from 0 to 1, every row and every column lies."""
        weights = []
        for values, span, place in zip(self.values, spans, places, strict=True):
            low, high = values[span[:, :1]], values[span[:, 1:]]
            weights.append((values[place] - low) / (high - low))
        return weights

    def basin(self, sizes: list[int], seconds: float) -> Basin:
        """All of it, over the grid."""
        grid, count = self.grid, int(np.sum(self.computed))
        attrs = self.attrs | {"computed": count, "refined_from": sizes}
        columns = self.columns | {"computed": self.computed}
        return Basin(grid.dims, grid.shape, grid.coords, columns, attrs, seconds)


def _parts(points: Int[np.ndarray, "n"]) -> Iterator[Int[np.ndarray, "m"]]:
    """Parts of a list for single sweeps, whose tiles then have few sizes to compile for."""
    while len(points):
        most = next((n for n in PARTS if len(points) > n // 2), PARTS[-1])
        yield points[:most]
        points = points[most:]


def _bilinear(
    corners: Float[np.ndarray, "m 2 2"], weights: list[Float[np.ndarray, "m _"]]
) -> Float[np.ndarray, "m h w"]:
    """Values within cells: linear along the columns, then along the rows."""
    u, v = weights[0][:, :, None], weights[1][:, None, :]
    first, last = (corners[:, :1, k, None] * (1 - u) + corners[:, 1:, k, None] * u for k in (0, 1))
    return first * (1 - v) + last * v
