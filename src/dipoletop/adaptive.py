"""Maps that are integrated only near the basin boundaries, and interpolated elsewhere.

A coarse lattice of cells is laid over the grid. Cells whose corners have different fates are halved
until their corners are neighbours in the grid; all other cells are filled in from their corners.
The neighbours of a halved cell are examined, too, so that a boundary is followed from cell to cell.
"""

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ._base.checks import instance, positive
from ._base.refusals import refuse
from ._base.tolerances import budget, check_settings
from ._base.types import Outcome
from ._maps.basin import Basin
from ._maps.columns import COLUMNS
from ._maps.grids import Grid, Points
from ._maps.problems import Problem
from ._maps.sweep import PointSweeps
from .boundary import fate

Cells = Int[np.ndarray, "_ 2"]
"""Cells of a lattice, by the indices of their first row and column."""
Corners = Int[np.ndarray, "m 2 2"]
"""Flat indices of the points at the corners of every cell."""
Spans = tuple[Int[np.ndarray, "m 2"], Int[np.ndarray, "m 2"]]
"""First and last row, and first and last column, of every cell."""

PARTS = (65536, 8192, 1024)  # points in a sweep, at most; only the last sweep has less than half
PIXELS = 1 << 20  # largest number of points filled in at once, to bound the memory


def refine(
    problem: Problem,
    over: Grid,
    *,
    coarse: int = 64,
    omega_tol: float | None = None,
    **settings: Any,
) -> Basin:
    """Compute the map of `sweep(problem, over)` with far fewer runs, only near the boundaries.

    The corners of about `coarse` × `coarse` cells are integrated. Cells whose corners differ in
    their `fate` are halved, down to the grid itself, and their neighbours of the same size are
    examined, too. Other points are filled in from the corners of their cell: labels are copied, ω∞
    and τ are bilinear, `steps` is 0, `certified` is True if it is at all four corners.

    **Limitation:** the map can miss an island smaller than a coarse cell that contains no corner
    and touches no examined cell, single points such as a start exactly on an axis, and structures
    thinner than the spacing of the grid. A larger `coarse` lowers the risk.

    Args:
        problem: as in `sweep`.
        over: two axes of increasing numbers, and any number of axes of length 1.
        coarse: least number of cells along each axis of the first lattice.
        omega_tol: also halve cells at whose centre the interpolated ω∞ has a larger error than
            this, or the fate is different; None examines no centre.
        settings: rtol, atol, max_steps, devices and engine, as in `sweep`.

    Returns:
        A `Basin` over the grid, in memory, with one more column, `computed`: whether the point was
        integrated. Its results then equal `sweep`'s up to rounding (the last digits of ω∞ and τ can
        depend on the other runs in a block). `attrs` contain the number of these points,
        `computed`, and the size of the first cells in points, `refined_from`.

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
    picture = _Picture(problem, over, settings)
    coarse = budget("coarse", coarse)
    if omega_tol is not None:
        omega_tol = float(positive("omega_tol", omega_tol, batch=False))
    first_sizes = [1 << max(0, ((n - 1) // coarse).bit_length() - 1) for n in picture.shape]
    lattice = _Lattice(picture.shape, first_sizes)
    mixed = _examine(picture, lattice, lattice.all(), omega_tol)
    while max(lattice.sizes) > 1:
        lattice, cells = lattice.halved(mixed)
        mixed = _examine(picture, lattice, cells, omega_tol)
    return picture.basin(first_sizes, time.perf_counter() - began)


def _examine(
    picture: "_Picture", lattice: "_Lattice", cells: Cells, omega_tol: float | None
) -> Cells:
    """Return the cells to halve among these and those that a boundary leads to; fill the others."""
    seen = np.zeros(lattice.shape, bool)
    mixed, uniform = [], []
    while len(cells):
        seen[tuple(cells.T)] = True
        corners = lattice.corners(cells)
        picture.compute(corners)
        differ = picture.differ(corners)
        mixed.append(cells[differ])
        uniform.append(cells[~differ])
        around = lattice.around(cells[differ])
        cells = around[~seen[tuple(around.T)]]
    to_halve, to_fill = np.concatenate(mixed or [cells]), np.concatenate(uniform or [cells])
    if omega_tol is not None and max(lattice.sizes) > 1:
        wrong = picture.wrong_at_centre(lattice, to_fill, omega_tol)
        to_halve, to_fill = np.concatenate([to_halve, to_fill[wrong]]), to_fill[~wrong]
    picture.fill(lattice, to_fill)
    return to_halve


class _Lattice:
    """Every k-th row and column of a grid, and the last ones; cells lie between them."""

    def __init__(self, points: tuple[int, ...], sizes: list[int]) -> None:
        self.points, self.sizes = points, sizes
        self.nodes = [
            np.append(np.arange(0, n - 1, size), n - 1)
            for n, size in zip(points, sizes, strict=True)
        ]
        self.shape = tuple(len(nodes) - 1 for nodes in self.nodes)

    def all(self) -> Cells:
        """Return every cell."""
        return np.argwhere(np.ones(self.shape, bool))

    def halved(self, cells: Cells) -> tuple["_Lattice", Cells]:
        """Return the lattice with half the cell size (at least 1), and the parts of `cells`."""
        parts = [min(2, size) for size in self.sizes]
        finer = _Lattice(self.points, [n // k for n, k in zip(self.sizes, parts, strict=True)])
        offsets = np.argwhere(np.ones(parts, bool))
        return finer, finer._inside(cells[:, None] * parts + offsets)

    def around(self, cells: Cells) -> Cells:
        """Return the cells and their neighbours, including diagonal ones, each once."""
        near = self._inside(cells[:, None] + np.argwhere(np.ones((3, 3), bool)) - 1)
        flat = np.unique(np.ravel_multi_index(tuple(near.T), self.shape))
        return np.stack(np.unravel_index(flat, self.shape), -1)

    def _inside(self, cells: Int[np.ndarray, "m k 2"]) -> Cells:
        """Return the cells that exist: the last cell of an axis may be shorter than the others."""
        flat = cells.reshape(-1, 2)
        return flat[np.all((flat >= 0) & (flat < self.shape), axis=1)]

    def spans(self, cells: Cells) -> Spans:
        """Return the first and last row, and the first and last column, of every cell."""
        firsts = cells[:, :, None] + np.arange(2)
        return self.nodes[0][firsts[:, 0]], self.nodes[1][firsts[:, 1]]

    def corners(self, cells: Cells) -> Corners:
        """Return the flat indices of the corners."""
        rows, columns = self.spans(cells)
        return rows[:, :, None] * self.points[1] + columns[:, None, :]


def _long_axes(grid: Any) -> list[str]:
    """Return the two axes of a map."""
    instance("over", grid, Grid)
    lengths = dict(zip(grid.dims, grid.shape, strict=True))
    names = [name for name, n in lengths.items() if n > 1]
    if len(names) != 2:
        shown = ", ".join(f"{name} ({n})" for name, n in lengths.items())
        refuse("over", "have exactly two axes longer than 1", f"has {shown}")
    for name in names:
        if grid.axes[name].ndim > 1 or np.any(np.diff(grid.axes[name]) <= 0):
            refuse("over", "have axes of increasing numbers", f"its axis {name} is another one")
    return names


class _Picture:
    """The columns of the map, and which points have been integrated so far."""

    def __init__(self, problem: Problem, grid: Grid, settings: Mapping[str, Any]) -> None:
        names = _long_axes(grid)
        self.grid, self.sweeps = grid, PointSweeps(problem, settings)
        self.values = [grid.axes[name] for name in names]
        self.shape = tuple(len(values) for values in self.values)
        self.attrs: dict[str, Any] = {}
        size = int(np.prod(self.shape))
        self.columns = {name: np.zeros(size, spec.dtype) for name, spec in COLUMNS.items()}
        self.fate = np.zeros(size, np.int8)
        self.computed = np.zeros(size, bool)

    def compute(self, points: Int[np.ndarray, "..."]) -> None:
        """Integrate the points that have not been integrated yet."""
        new = np.unique(points[~self.computed[points]])
        for part in _parts(new):
            over = Points(**self.grid.points(part))  # axes of length 1 change no number
            basin = self.sweeps(over)
            for name in self.columns:
                self.columns[name][part] = basin.column(name)
            self.fate[part] = fate(basin)
            self.attrs = basin.attrs
        self.computed[new] = True

    def differ(self, corners: Corners) -> Bool[np.ndarray, "m"]:
        """Return whether the corners have different fates."""
        fates = self.fate[corners]
        return np.any(fates != fates[:, :1, :1], axis=(1, 2))

    def wrong_at_centre(
        self, lattice: _Lattice, cells: Cells, omega_tol: float
    ) -> Bool[np.ndarray, "m"]:
        """Return whether the fate at the centre, or ω∞ there by more than `omega_tol`, is wrong."""
        corners, spans = lattice.corners(cells), lattice.spans(cells)
        row, column = spans[0].sum(-1) // 2, spans[1].sum(-1) // 2
        centres = row * self.shape[1] + column
        self.compute(centres)
        weights = self._weights(spans, (row[:, None], column[:, None]))
        interpolated = _bilinear(self.columns["omega_inf"][corners], weights)[:, 0, 0]
        wrong = np.abs(interpolated - self.columns["omega_inf"][centres]) > omega_tol
        return wrong | (self.fate[centres] != self.fate[corners[:, 0, 0]])

    def fill(self, lattice: _Lattice, cells: Cells) -> None:
        """Fill in the points of uniform cells that have not been integrated from the corners."""
        height, width = lattice.sizes[0] + 1, lattice.sizes[1] + 1
        if height == width == 2:
            return
        at_once = max(1, PIXELS // (height * width))
        for first in range(0, len(cells), at_once):
            part = cells[first : first + at_once]
            spans, corners = lattice.spans(part), lattice.corners(part)
            rows = np.minimum(spans[0][:, :1] + np.arange(height), spans[0][:, 1:])
            columns = np.minimum(spans[1][:, :1] + np.arange(width), spans[1][:, 1:])
            points = rows[:, :, None] * self.shape[1] + columns[:, None, :]
            self._fill(points, corners, self._weights(spans, (rows, columns)))

    def _fill(self, points: Int[np.ndarray, "m h w"], corners: Corners, weights: Any) -> None:
        free = ~self.computed[points]
        same = "outcome", "stop", "regime"
        values = {name: self.columns[name][corners[:, :1, :1]] for name in same}
        residual = values["outcome"] == Outcome.RESIDUAL
        values["omega_inf_error"] = np.where(residual, np.inf, 0.0)  # there is no estimate
        certified = self.columns["certified"][corners]
        values["certified"] = np.all(certified, axis=(1, 2), keepdims=True)
        for name, value in values.items():
            self.columns[name][points[free]] = np.broadcast_to(value, points.shape)[free]
        for name in ("omega_inf", "time", "probability"):
            interpolated = _bilinear(self.columns[name][corners], weights)
            self.columns[name][points[free]] = interpolated[free]

    def _weights(self, spans: Spans, places: Any) -> list[Float[np.ndarray, "m _"]]:
        """Return the relative position, from 0 to 1, of every row and column in its cell."""
        weights = []
        for values, span, place in zip(self.values, spans, places, strict=True):
            low, high = values[span[:, :1]], values[span[:, 1:]]
            weights.append((values[place] - low) / (high - low))
        return weights

    def basin(self, first_sizes: list[int], seconds: float) -> Basin:
        """Return the whole map over the grid."""
        grid, count = self.grid, int(np.sum(self.computed))
        attrs = self.attrs | {"computed": count, "refined_from": first_sizes}
        columns = self.columns | {"computed": self.computed}
        return Basin(grid.dims, grid.shape, grid.coords, columns, attrs, seconds)


def _parts(points: Int[np.ndarray, "n"]) -> Iterator[Int[np.ndarray, "m"]]:
    """Yield parts of a list of points, one for each sweep, with few sizes to compile for."""
    while len(points):
        size = next((n for n in PARTS if len(points) > n // 2), PARTS[-1])
        yield points[:size]
        points = points[size:]


def _bilinear(
    corners: Float[np.ndarray, "m 2 2"], weights: list[Float[np.ndarray, "m _"]]
) -> Float[np.ndarray, "m h w"]:
    """Return the bilinear interpolation within cells."""
    u, v = weights[0][:, :, None], weights[1][:, None, :]
    first = corners[:, :1, 0, None] * (1 - u) + corners[:, 1:, 0, None] * u
    last = corners[:, :1, 1, None] * (1 - u) + corners[:, 1:, 1, None] * u
    return first * (1 - v) + last * v
