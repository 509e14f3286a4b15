"""Tallies: counts of outcomes, and histograms, without keeping every start."""

import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._base.checks import flag
from .._base.refusals import refuse
from .._base.statistics import wilson
from .._base.types import Outcome
from .columns import column_spec, coordinate_dims, labels, with_level
from .grids import counted, described_axes
from .store.errors import StoreMismatch
from .store.layout import tiling_of_starts
from .store.tiles import Tiles, open_store
from .tally_counts import CERTIFIED, Reduction
from .tiling import Tiling

if TYPE_CHECKING:
    import xarray


class Shares(NamedTuple):
    """Shares of the starts of every cell, with their 95 % intervals (Wilson)."""

    share: Float[np.ndarray, "*cells"]
    low: Float[np.ndarray, "*cells"]
    high: Float[np.ndarray, "*cells"]
    count: Int[np.ndarray, "*cells"]


class Bounds(NamedTuple):
    """The edges of the bin that contains a quantile, for every cell; NaN if nothing was counted."""

    low: Float[np.ndarray, "*cells"]
    high: Float[np.ndarray, "*cells"]


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts of the starts of a sweep, in every cell: a combination of values on the kept axes.

    Attributes:
        dims: names of the kept axes.
        shape: their lengths.
        coords: the values on all axes, kept or not, or of points.
        counts: the numbers of starts, shape (cells, …); use the methods below.
        reduction: the meaning of the counts.
        size: number of starts of the sweep; `starts` is smaller while it is unfinished.
        attrs: level of the equation, settings, versions.
        seconds: wall time of the sweep, compilation included; NaN for a loaded tally.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Float[np.ndarray, "..."]]
    counts: Int[np.ndarray, "..."]
    reduction: Reduction
    size: int
    attrs: dict[str, Any]
    seconds: float = np.nan

    @property
    def starts(self) -> int:
        """Number of starts that are counted."""
        return int(np.sum(self.counts[..., :CERTIFIED]))

    @property
    def level(self) -> str:
        """The level of the equation of motion that was integrated."""
        return self.attrs["level"]

    @property
    def certified(self) -> Int[np.ndarray, "*cells"]:
        """Numbers of starts that ended in a region that is proven to decide."""
        return np.asarray(self.counts[..., CERTIFIED])

    def count(self, outcome: Outcome) -> Int[np.ndarray, "*cells"]:
        """Return how many starts have an outcome."""
        return np.asarray(self.counts[..., int(Outcome(outcome)) - min(Outcome)])

    def fractions(self) -> dict[str, Shares]:
        """Return the share of every outcome that occurs, by cell, with 95 % intervals (Wilson).

        The intervals hold for independent random starts; on a regular grid they overstate the
        error. The shares of an unfinished sweep are among the starts counted so far.
        """
        counts = {outcome: self.count(outcome) for outcome in Outcome}
        sizes = np.asarray(np.sum(self.counts[..., :CERTIFIED], axis=-1))
        with np.errstate(invalid="ignore", divide="ignore"):  # cells not counted yet
            return {
                outcome.name: Shares(np.asarray(count / sizes), *wilson(count, sizes), count)
                for outcome, count in counts.items()
                if np.any(count)
            }

    def edges(self, column: str) -> Float[np.ndarray, "edges"]:
        """Return the edges of the bins of a histogram."""
        self.reduction.place(column)
        return self.reduction.edges[column]

    def histogram(self, column: str) -> Int[np.ndarray, "*cells bins"]:
        """Return how many values of a column lie in each bin; see `outside` for the others.

        Values of `omega_inf`, its error and derivatives count for RESIDUAL starts only; `time` and
        `steps` for RESIDUAL and STOP. Unknown numbers (NaN) are not counted. A bin includes its
        lower edge; the last one includes both.

        Raises:
            ValueError: the column has no histogram.
        """
        return self.counts[..., self.reduction.place(column)][..., 1:-1]

    def outside(self, column: str) -> tuple[Int[np.ndarray, "*cells"], Int[np.ndarray, "*cells"]]:
        """Return how many values of a column lie below the first edge, and above the last one."""
        every = self.counts[..., self.reduction.place(column)]
        return np.asarray(every[..., 0]), np.asarray(every[..., -1])

    def quantile(self, column: str, q: Any) -> Bounds:
        """Return the bin that contains the q-quantile of the values of a column, in every cell.

        The quantile is the smallest value with at least the share q of all values at or below it.
        Beyond the edges the bin is infinite.

        Args:
            column: a column with a histogram.
            q: the share, from 0 to 1.
        """
        if not (isinstance(q, int | float | np.number) and 0 <= q <= 1):
            refuse("q", "be a number from 0 to 1", f"is {q!r}")
        every = self.counts[..., self.reduction.place(column)]
        below = np.cumsum(every, axis=-1)
        total = below[..., -1:]
        place = np.argmax(below >= np.maximum(np.ceil(q * total), 1), axis=-1)
        ends = np.concatenate([[-np.inf], self.edges(column), [np.inf]])
        known = total[..., 0] > 0
        return Bounds(*(np.where(known, ends[place + k], np.nan) for k in (0, 1)))

    def to_xarray(self) -> "xarray.Dataset":
        """Return the counts as an `xarray.Dataset` over the kept axes.

        `starts` has the axis `outcome`; a histogram has an axis of bins, whose edges are the
        coordinates `…_low` and `…_high`. Values outside the edges are in the first and last bin.
        """
        import xarray

        by_outcome = ((*self.dims, "outcome"), self.counts[..., :CERTIFIED])
        variables: dict[str, Any] = {"starts": by_outcome, "certified": (self.dims, self.certified)}
        coords: dict[str, Any] = {"outcome": [outcome.name for outcome in Outcome]}
        for name in self.reduction.edges:
            axis = f"{name}_bin"
            every = self.counts[..., self.reduction.place(name)]
            variables[f"histogram_{name}"] = ((*self.dims, axis), every)
            ends = np.concatenate([[-np.inf], self.edges(name), [np.inf]])
            unit = {"units": column_spec(name).unit}
            coords[f"{axis}_low"] = axis, ends[:-1], unit
            coords[f"{axis}_high"] = axis, ends[1:], unit
        for name in self.dims:
            values = self.coords[name]
            dims = coordinate_dims(name, self.dims, values.ndim)
            coords[name] = (dims, values, labels(name))
        return xarray.Dataset(variables, *with_level(coords, self.attrs))

    def __eq__(self, other: object) -> bool:
        """Return whether cells, bins and all counts are the same."""
        if not isinstance(other, Tally):
            return NotImplemented
        bins, others = self.reduction.edges, other.reduction.edges
        if (self.dims, self.size, bins.keys()) != (other.dims, other.size, others.keys()):
            return False
        pairs = [(self.counts, other.counts), *((x, others[name]) for name, x in bins.items())]
        pairs += [(x, other.coords.get(name, np.nan)) for name, x in self.coords.items()]
        return all(np.array_equal(*pair) for pair in pairs)

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    @staticmethod
    def load(path: str | bytes | PathLike[Any], *, unfinished: bool = False) -> "Tally":
        """Load the tally in the `store` of `tally`.

        Args:
            path: the folder.
            unfinished: whether to load an unfinished tally, too, in its present state.

        Raises:
            StoreMismatch: the store is missing, not a tally, or an unfinished one.
            StoreDamaged: the store differs from what was written.
        """
        tiles = open_store(path)
        if "tally" not in tiles.header:
            must, reason = "be a tally", f"{tiles.folder} is not one (`Basin.load` reads a basin)"
            raise StoreMismatch("path", tiles.folder, must, reason)
        if not flag("unfinished", unfinished):
            tiles.refuse_unfinished("tally")
        return tally_on_disk(tiles, tiles.finished())

    @property
    def merged(self) -> "Tally":
        """The tally with all cells merged into one."""
        counts = np.sum(self.counts, axis=tuple(range(len(self.dims))))
        reduction = replace(self.reduction, keep=())
        return replace(self, dims=(), shape=(), counts=counts, reduction=reduction)

    def __repr__(self) -> str:
        shares = [f"{name} {x.share:.2%}" for name, x in self.merged.fractions().items()]
        if self.starts < self.size:
            shares.append(f"not counted yet {1 - self.starts / self.size:.2%}")
        kept = ", ".join(self.dims) or "no axis"
        lines = [
            f"Tally({self.attrs.get('level', 'level not known')}; rtol {self.attrs.get('rtol')}",
            f"{described_axes(self.coords) or 'a sample'}; {counted((self.size,))}; kept: {kept}",
            ", ".join(shares),
        ]
        if self.reduction.edges:
            lines.append(f"histograms: {', '.join(self.reduction.edges)}")
        return "\n      ".join(lines) + ")"


class Counts:
    """The counts of a sweep, to which tiles are added."""

    def __init__(self, reduction: Reduction, tiling: Tiling) -> None:
        self._reduction, self._tiling, self._adding = reduction, tiling, threading.Lock()
        self._shape = tiling.shape[: len(reduction.keep)]
        self._counts = np.zeros((*self._shape, reduction.width), np.int64)

    def add(self, tile: int, part: Int[np.ndarray, "..."]) -> None:
        """Add the counts of a tile; tiles of other workers may have the same cells."""
        cells = self._tiling.box(tile)[: part.ndim - 1]
        with self._adding:
            self._counts[cells] += part[tuple(slice(cell.stop - cell.start) for cell in cells)]

    def tally(self, coords: dict[str, np.ndarray], attrs: dict[str, Any]) -> Tally:
        """Return the tally of these counts."""
        keep, size = self._reduction.keep, self._tiling.size
        return Tally(keep, self._shape, coords, self._counts, self._reduction, size, attrs)


def tally_on_disk(tiles: Tiles, finished: Iterable[int]) -> Tally:
    """Return the tally of these tiles of a store."""
    header = tiles.header
    edges = {name: np.asarray(values) for name, values in header["tally"]["edges"].items()}
    reduction = Reduction(tuple(header["tally"]["keep"]), edges)
    counts = Counts(reduction, tiling_of_starts(header))
    for tile in finished:
        counts.add(tile, tiles.read("counts", tile)[0])
    coords = {name: tiles.values(name) for name in header["axes"]}
    return counts.tally(coords, dict(header["attrs"]))
