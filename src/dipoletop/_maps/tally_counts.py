"""The counts of a sweep that does not keep its starts.

A cell is a combination of values on the kept axes; all starts of a cell are counted together. The
counts of a cell are, in this order: the starts with each outcome, the starts with a certified
label, and for each histogram the values below its first edge, in each bin, and above its last edge.
A bin includes its lower edge; the last bin includes both.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .._base.checks import finite, instance, names_of
from .._base.refusals import refuse
from .._base.types import Outcome
from .columns import DERIVATIVE_PREFIX
from .grids import Grid, Points, Sample
from .tiling import Tiling

CERTIFIED = len(Outcome)  # index of the count of certified starts
HEAD = CERTIFIED + 1
ROTATION = "omega_inf", "omega_inf_error"
MOTION = "time", "steps"
LARGEST = 1 << 16  # bins of a histogram


def counted_outcomes(outcomes: Int[np.ndarray, "n"]) -> Int[np.ndarray, "outcomes"]:
    """Return how many starts have each outcome, in the order of `Outcome`."""
    return np.bincount(outcomes.astype(int) - min(Outcome), minlength=len(Outcome))


@dataclass(frozen=True)
class Reduction:
    """The reduction of a sweep to counts: the axes that separate cells, and the bins of histograms.

    Attributes:
        keep: the kept axes; they are the first axes of the grid.
        edges: the edges of the bins, by the column that is counted.
    """

    keep: tuple[str, ...]
    edges: dict[str, Float[np.ndarray, "edges"]]

    @property
    def width(self) -> int:
        """Number of counts of a cell."""
        return HEAD + sum(len(edges) + 1 for edges in self.edges.values())

    def place(self, column: str) -> slice:
        """Return the slice of a cell's counts that holds a histogram."""
        first = HEAD
        for name, edges in self.edges.items():
            if name == column:
                return slice(first, first + len(edges) + 1)
            first += len(edges) + 1
        refuse(
            "column", f"have a histogram ({', '.join(self.edges) or 'none has'})", f"is {column!r}"
        )

    def shape(self, tiling: Tiling) -> tuple[int, ...]:
        """Return the shape of the counts of a tile that is not shortened."""
        return (*tiling.chunk[: len(self.keep)], self.width)

    def counts(
        self, columns: Mapping[str, np.ndarray], tiling: Tiling, tile: int
    ) -> Int[np.ndarray, "..."]:
        """Return the counts of a tile from its columns; 0 for cells missing in a shortened tile."""
        lengths = [indices.stop - indices.start for indices in tiling.box(tile)]
        kept, others = lengths[: len(self.keep)], math.prod(lengths[len(self.keep) :])
        outcome = columns["outcome"]
        cell, cells = np.arange(outcome.size) // others, math.prod(kept)
        result = np.zeros((cells, self.width), np.int64)

        def count(places: np.ndarray, which: np.ndarray, width: int) -> np.ndarray:
            flat = np.bincount(cell[which] * width + places[which], minlength=cells * width)
            return flat.reshape(cells, width)

        every = np.ones(outcome.size, bool)
        result[:, :CERTIFIED] = count(outcome.astype(int) - min(Outcome), every, len(Outcome))
        result[:, CERTIFIED] = np.bincount(cell[columns["certified"]], minlength=cells)
        residual = outcome == Outcome.RESIDUAL
        decided = residual | (outcome == Outcome.STOP)
        for name, edges in self.edges.items():
            values = columns[name]
            bins = np.searchsorted(edges, values, side="right")
            bins[values == edges[-1]] = len(edges) - 1
            counted = (decided if name in MOTION else residual) & ~np.isnan(values)
            result[:, self.place(name)] = count(bins, counted, len(edges) + 1)
        whole = np.zeros(self.shape(tiling), np.int64)
        whole[tuple(slice(n) for n in kept)] = result.reshape(*kept, self.width)
        return whole

    def header(self, plain: Mapping[str, Any], tiling: Tiling) -> dict[str, Any]:
        """Return the header of a tally's store, from the header of the sweep with every start."""
        return {
            **plain,
            "dims": ["tile"],
            "shape": [tiling.count],
            "chunk": [1],
            "columns": ["counts"],
            "drawn": {},
            "components": {"counts": list(self.shape(tiling))},
            "tally": {
                "keep": list(self.keep),
                "edges": {name: edges.tolist() for name, edges in self.edges.items()},
                "dims": plain["dims"],
                "shape": plain["shape"],
                "chunk": plain["chunk"],
            },
        }


def reduction_of(
    over: Grid | Points | Sample,
    keep: str | Sequence[str],
    histograms: Any,
    derivatives: Sequence[str],
) -> Reduction:
    """Return the reduction after checking the arguments.

    Args:
        over: the points of the sweep.
        keep: names of axes of a grid.
        histograms: edges of bins by the names of columns.
        derivatives: the arguments along which ω∞ is differentiated.
    """
    names = names_of("keep", keep)
    known = over.dims if isinstance(over, Grid) else ()
    for name in names:
        if name not in known:
            axes = ", ".join(known) or "none: no grid is swept"
            refuse("keep", f"name axes of the grid ({axes})", f"names {name!r}")
    if len(set(names)) < len(names):
        refuse("keep", "name each axis once", f"is {', '.join(names)}")
    instance("histograms", histograms, Mapping, "be a mapping from columns to edges of bins")
    countable = [*ROTATION, *MOTION, *(DERIVATIVE_PREFIX + name for name in derivatives)]
    for name in histograms:
        if name not in countable:
            must = f"be of columns with numbers ({', '.join(countable)})"
            refuse("histograms", must, f"has {name!r}")
    return Reduction(tuple(names), {name: _edges(name, x) for name, x in histograms.items()})


def _edges(column: str, values: Any) -> Float[np.ndarray, "edges"]:
    argument = f"histograms[{column!r}]"
    edges = np.asarray(finite(argument, values, (-1,)), float)
    if not 2 <= len(edges) <= LARGEST + 1:
        refuse(argument, f"have from 2 to {LARGEST + 1} edges", f"has {len(edges)}")
    if not np.all(np.diff(edges) > 0):
        refuse(argument, "be edges that increase", "does not")
    return edges


def with_kept_first(over: Grid | Points | Sample, keep: Sequence[str]) -> Grid | Points | Sample:
    """Return the points with the kept axes first, so that each tile lies in few cells."""
    if not isinstance(over, Grid) or not keep:
        return over
    others = [name for name in over.dims if name not in keep]
    return Grid(**{name: over.axes[name] for name in (*keep, *others)})
