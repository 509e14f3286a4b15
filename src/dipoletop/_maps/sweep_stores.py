"""Stores for the columns of a sweep: in memory, or on disk, where it can be resumed."""

import contextlib
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from .._base.parallel import in_parallel
from .columns import BasinParts, column_spec
from .store.errors import StoreMismatch, StoreNotWritable
from .store.saved_basins import THIS_SWEEP, begin_or_resume
from .sweep_plan import ComputedTile, Plan


class MemoryStore:
    """A store in memory; an interruption loses the tiles in progress.

    Args:
        plan: the sweep.
        keep: called with each computed tile.
    """

    patience: ClassVar[float] = 0.0
    """Seconds for which an interrupted sweep waits for the tiles in progress, to keep them."""

    def __init__(self, plan: Plan, keep: Callable[[ComputedTile], None]) -> None:
        self._count, self._keep = plan.tiling.count, keep

    def unfinished(self) -> list[int]:
        """Return every tile."""
        return list(range(self._count))

    def claim(self, tile: int) -> bool:
        """Return whether this process is to compute a tile: always."""
        return True

    def is_finished(self, tile: int) -> bool:
        """Return whether a tile that was to be computed is in place: always."""
        return True

    def write(self, computed: ComputedTile) -> None:
        """Keep the columns of a tile."""
        self._keep(computed)

    def close(self) -> None:
        """Do nothing."""


class ColumnsInMemory:
    """The columns of every start, in memory."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._columns = {
            name: np.empty((plan.tiling.size, *plan.drawn.get(name, ())), column_spec(name).dtype)
            for name in plan.column_names
        }

    def add(self, computed: ComputedTile) -> None:
        """Copy the columns of a tile."""
        for name, values in computed.columns.items():
            self._columns[name][self._plan.tiling.span(computed.tile)] = values

    def contents(self) -> BasinParts:
        """Return the finished basin."""
        over = self._plan.blocks.over
        return BasinParts(over.dims, over.shape, over.coords, self._columns, self._plan.attrs)


class ZarrStore:
    """Columns in a store on disk, which this sweep begins or resumes; other processes may join.

    Raises:
        StoreMismatch: the path cannot be used, or holds another sweep.
        StoreDamaged: the store differs from what was written, and is not to be repaired.
    """

    patience: ClassVar[float] = 10.0

    def __init__(self, path: Any, plan: Plan, repair: bool) -> None:
        self._plan, self._repair = plan, repair
        values = plan.blocks.over.header.values
        self.tiles = begin_or_resume(path, plan.header(), values, repair)
        """The tiles on disk."""
        self._claims = self.tiles.claims()
        self._tidy()

    def _tidy(self) -> None:
        """Remove what killed processes left behind, unless another process may be writing."""
        with self._claims.everything() as alone:
            if alone:
                self.tiles.discard_partial_files()

    def unfinished(self) -> list[int]:
        """Return the tiles to compute, after reading finished ones and comparing their inputs."""
        tiles = self.tiles
        left = tiles.unfinished()
        finished = tiles.tiling.others(left)
        damaged = tiles.damaged(finished)
        if not self._repair:
            tiles.refuse_damaged(damaged, " (`repair` computes it again)")
        sound = [tile for tile in finished if tile not in damaged]
        plan = self._plan
        for tile, here in in_parallel(plan.inputs, sound, plan.devices):
            there = tiles.record(tile).inputs
            if here != there:
                reason = (
                    f"in tile {tile} of {tiles.folder} the equations or starts are others "
                    f"({there.hex()[:8]} there and {here.hex()[:8]} here)"
                )
                raise StoreMismatch("store", tiles.folder, THIS_SWEEP, reason)
        for tile in damaged:
            tiles.forget(tile)
        return sorted([*left, *damaged])

    def claim(self, tile: int) -> bool:
        """Return whether this process is to compute a tile, which no other process does or did."""
        if not self._claims.take(tile):
            return False
        if self.is_finished(tile):
            self._claims.give_back(tile)
            return False
        return True

    def is_finished(self, tile: int) -> bool:
        """Return whether a tile is on disk."""
        return self.tiles.is_finished(tile)

    def progress(self) -> tuple[int, int]:
        """Return the number of finished tiles, and of all tiles."""
        return len(self.tiles.finished()), self.tiles.tiling.count

    def write(self, computed: ComputedTile) -> None:
        """Write a claimed tile to disk, with the digest of its inputs."""
        try:
            self.tiles.write(computed.tile, computed.columns, computed.inputs)
        except OSError as error:
            reason = error.strerror or str(error)
            raise StoreNotWritable(self.tiles.folder, *self.progress(), reason) from error
        self._claims.give_back(computed.tile)

    def give_back(self, tile: int) -> None:
        """Release the claim on a tile that is not written."""
        self._claims.give_back(tile)

    def reopen(self) -> None:
        """Claim tiles again after `close`, unless a sweep of this process has the store."""
        with contextlib.suppress(StoreMismatch):
            self._claims = self.tiles.claims()

    def close(self) -> None:
        """Release the store to other processes."""
        self._tidy()
        self._claims.close()

    def contents(self) -> BasinParts:
        """Return the finished basin, whose columns are read from disk when they are used."""
        return self.tiles.contents()


Store = MemoryStore | ZarrStore
"""A store in which a sweep claims, computes and writes its tiles."""
