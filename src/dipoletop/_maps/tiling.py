"""Tiles: boxes of a sweep's grid, each computed and stored as one."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from .._engines.interface import power_of_two
from .._runs.memory_limits import TILE

MANY = 65536  # tiles; to avoid more of them, a tile may have up to `LARGEST` starts
LARGEST = 1 << 20


@dataclass(frozen=True)
class Tiling:
    """The division of a grid of this shape into boxes, its tiles.

    A box has one index on the first axes, a range of the next axis, and the full range of all later
    axes. So the flat indices of a tile (C order) are consecutive, and tiles follow one another.

    Attributes:
        shape: lengths of the axes.
        chunk: lengths of a box; the last box on an axis may be shorter.
    """

    shape: tuple[int, ...]
    chunk: tuple[int, ...]

    @classmethod
    def of(cls, shape: tuple[int, ...], most: int) -> "Tiling":
        """Return the tiling with at most `most` starts in each tile."""
        chunk = list(shape)
        for axis, length in enumerate(shape):
            behind = math.prod(shape[axis + 1 :])
            chunk[axis] = min(length, max(most // behind, 1))
            if behind <= most:
                break
        return cls(tuple(shape), tuple(chunk))

    @classmethod
    def of_sweep(cls, shape: tuple[int, ...]) -> "Tiling":
        """Return a tiling with enough tiles for all cores; the same on every machine."""
        size = math.prod(shape)
        few, usual = power_of_two(-(-size // 8)), power_of_two(-(-size // MANY))
        return cls.of(shape, min(few, max(TILE, min(usual, LARGEST))))

    @property
    def size(self) -> int:
        """Number of starts."""
        return math.prod(self.shape)

    @property
    def tile_size(self) -> int:
        """Number of starts in a tile that is not shortened."""
        return math.prod(self.chunk)

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of tiles along every axis."""
        return tuple(-(-n // k) for n, k in zip(self.shape, self.chunk, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.grid)

    def others(self, tiles: Iterable[int]) -> list[int]:
        """Return all tiles except these."""
        return sorted(set(range(self.count)) - set(tiles))

    def box(self, tile: int) -> tuple[slice, ...]:
        """Return the indices of a tile on every axis."""
        firsts = [k * i for k, i in zip(self.chunk, self.place(tile), strict=True)]
        ends = [min(i + k, n) for i, k, n in zip(firsts, self.chunk, self.shape, strict=True)]
        return tuple(slice(*pair) for pair in zip(firsts, ends, strict=True))

    def place(self, tile: int) -> tuple[int, ...]:
        """Return the indices of a tile in the grid of tiles."""
        return tuple(int(i) for i in np.unravel_index(tile, self.grid)) if self.grid else ()

    def length(self, tile: int) -> int:
        """Return the number of starts in a tile."""
        return math.prod(indices.stop - indices.start for indices in self.box(tile))

    def span(self, tile: int) -> slice:
        """Return the flat indices of a tile."""
        box = self.box(tile)
        corner = tuple(indices.start for indices in box)
        first = int(np.ravel_multi_index(corner, self.shape)) if corner else 0
        return slice(first, first + self.length(tile))

    def padded_indices(self, tile: int, length: int) -> Int[np.ndarray, "length"]:
        """Return the flat indices of a tile, padded to `length` with its last index."""
        span = self.span(tile)
        return np.minimum(np.arange(span.start, span.start + length), span.stop - 1)

    def tiles_with(self, flat: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the tiles to which these flat indices belong."""
        if not self.shape:
            return np.zeros_like(flat)
        index = np.unravel_index(flat, self.shape)
        places = tuple(i // k for i, k in zip(index, self.chunk, strict=True))
        return np.ravel_multi_index(places, self.grid)
