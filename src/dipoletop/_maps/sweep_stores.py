"""Where a sweep keeps its columns: in memory, or in a store on disk, which it may resume.

Both offer `unfinished()`, the tiles to compute; `write(tile, columns, block)`; and `contents()`,
the finished basin as plain values.
"""

from typing import Any

import numpy as np

from .._base.parallel import in_parallel
from .columns import BasinParts, column_spec
from .problems import Block, block_digest
from .store.errors import StoreMismatch
from .store.resume import THIS_SWEEP, begin_or_resume
from .sweep_plan import Columns, Plan


class MemoryStore:
    """Columns in memory."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        size, names = plan.tiling.size, plan.column_names
        self._columns = {name: np.empty(size, column_spec(name).dtype) for name in names}

    def unfinished(self) -> list[int]:
        """Every tile."""
        return list(range(self._plan.tiling.count))

    def write(self, tile: int, columns: Columns, block: Block) -> None:
        """Copy the columns of a tile."""
        for name, values in columns.items():
            self._columns[name][self._plan.tiling.span(tile)] = values

    def contents(self) -> BasinParts:
        """The finished basin."""
        over = self._plan.blocks.over
        return BasinParts(over.dims, over.shape, over.coords, self._columns, self._plan.attrs)


class ZarrStore:
    """Columns in a store on disk, which this sweep begins or resumes.

    Raises:
        StoreMismatch: the path cannot be used, or holds another sweep.
        StoreDamaged: the store is not as it was written, and is not to be repaired.
    """

    def __init__(self, path: Any, plan: Plan, repair: bool) -> None:
        self._plan, self._repair = plan, repair
        values = plan.blocks.over.header.values
        self._tiles = begin_or_resume(path, plan.header(), values, repair)

    def unfinished(self) -> list[int]:
        """The tiles to compute. Finished ones are read, and their inputs are compared."""
        tiles = self._tiles
        left = tiles.unfinished()
        finished = tiles.tiling.others(left)
        damaged = tiles.damaged(finished)
        if not self._repair:
            tiles.refuse_damaged(damaged, " (`repair` computes it again)")
        sound = [tile for tile in finished if tile not in damaged]
        plan = self._plan
        digests = in_parallel(lambda tile, _: block_digest(plan.block(tile)), sound, plan.devices)
        for tile, here in digests:
            there = tiles.record(tile).inputs
            if here != there:
                reason = (
                    f"in tile {tile} of {tiles.folder} the equations or starts are others "
                    f"({there.hex()[:8]} there and {here.hex()[:8]} here)"
                )
                raise StoreMismatch("store", tiles.folder, THIS_SWEEP, reason)
        return sorted([*left, *damaged])

    def write(self, tile: int, columns: Columns, block: Block) -> None:
        """Write a tile to disk, with a digest of its inputs."""
        self._tiles.write(tile, columns, block_digest(block))

    def contents(self) -> BasinParts:
        """The finished basin, whose columns are read from disk when they are used."""
        return self._tiles.contents()
