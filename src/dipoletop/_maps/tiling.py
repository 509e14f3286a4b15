"""Tiles: consecutive flat indices of a sweep, computed and stored together."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int


class Tiling(NamedTuple):
    """How the flat indices 0, …, size − 1 are cut into tiles; the last one may be shorter."""

    size: int
    tile_size: int

    @property
    def count(self) -> int:
        """Number of tiles."""
        return -(-self.size // self.tile_size)

    def others(self, tiles: Iterable[int]) -> list[int]:
        """All tiles except these."""
        return sorted(set(range(self.count)) - set(tiles))

    def length(self, tile: int) -> int:
        """Number of starts in a tile."""
        return min(self.tile_size, self.size - tile * self.tile_size)

    def span(self, tile: int) -> slice:
        """The flat indices of a tile."""
        first = tile * self.tile_size
        return slice(first, first + self.length(tile))

    def padded_indices(self, tile: int) -> Int[np.ndarray, "tile"]:
        """The flat indices of a tile; the last tile is filled up with the last index."""
        return np.minimum(self._lanes(tile), self.size - 1)

    def is_real(self, tile: int) -> Bool[np.ndarray, "tile"]:
        """Which of the padded indices belong to the tile."""
        return self._lanes(tile) < self.size

    def _lanes(self, tile: int) -> Int[np.ndarray, "tile"]:
        return np.arange(tile * self.tile_size, (tile + 1) * self.tile_size)
