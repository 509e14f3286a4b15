"""Basins on disk: saved, loaded, verified."""

from typing import Any, NamedTuple

import numpy as np

from ..._base.digests import SIZE
from ..columns import BasinParts, is_result
from ..tiling import TILE, Tiling
from .errors import StoreDamaged, StoreMismatch
from .folders import absolute_path, atomic_folder, exists
from .headers import with_value_digests
from .layout import create_arrays, tiling_of_starts
from .tiles import open_store, open_tiles


class Verification(NamedTuple):
    """The state of a store, from `verify`."""

    tiles: int
    """Number of tiles."""
    unfinished: list[int]
    """Numbers of the tiles that are not computed yet."""
    damaged: dict[int, str]
    """Descriptions of the damage, by number of the tile."""


def save(parts: BasinParts, path: Any) -> None:
    """Write a whole basin."""
    folder = absolute_path("path", path)
    if exists("path", folder):
        raise StoreMismatch("path", folder, "not exist yet", f"{folder} does")
    tiling = Tiling.of(parts.shape, TILE)
    columns = {name: np.asarray(column[:]) for name, column in parts.columns.items()}
    header = {
        "dims": list(parts.dims),
        "shape": list(parts.shape),
        "chunk": list(tiling.chunk),
        "columns": list(columns),
        "drawn": {name: x.shape[1:] for name, x in columns.items() if not is_result(name)},
        "attrs": parts.attrs,
        "axes": list(parts.coords),
    }
    try:
        with atomic_folder("path", folder) as fresh:
            create_arrays(fresh, with_value_digests(header, parts.coords), parts.coords)
            tiles = open_tiles("path", fresh)
            for tile in range(tiling.count):
                span = tiling.span(tile)
                tiles.write(tile, {name: x[span] for name, x in columns.items()}, bytes(SIZE))
    except FileExistsError:
        raise StoreMismatch("path", folder, "not exist yet", f"{folder} does") from None


def load(path: Any, partial: bool = False) -> BasinParts:
    """Return the basin at `path`; its columns are read, and checked, when they are used.

    A finished basin is also verified at once. With `partial` the basin may be unfinished and is not
    verified at once, which would take long for a large store of which little is used.
    """
    tiles = open_store(path)
    if "tally" in tiles.header:
        reason = f"{tiles.folder} is a tally (`Tally.load` reads it)"
        raise StoreMismatch("path", tiles.folder, "be a basin", reason)
    if partial:
        return tiles.contents(partial=True)
    parts = tiles.contents()
    tiles.refuse_unfinished("sweep")
    tiles.refuse_damaged(tiles.damaged(range(tiles.tiling.count)))
    return parts


def verify(path: Any) -> Verification:
    """Read everything in a store, whether its sweep is finished or not.

    Raises:
        StoreMismatch: the path leads to no store.
        StoreDamaged: its metadata are damaged.
    """
    tiles = open_store(path)
    for name in tiles.swept_names:
        tiles.values(name)
    left = tiles.unfinished()
    damaged = tiles.damaged(tiles.tiling.others(left))
    return Verification(tiles.tiling.count, left, damaged)


def starts_done(path: Any, repair: bool = False) -> int:
    """Return the number of starts that this store already holds; 0 if it is not a valid store."""
    try:
        tiles = open_store(path)
        left = tiles.unfinished()
        if repair:
            left += tiles.damaged(tiles.tiling.others(left))
    except (StoreDamaged, StoreMismatch):  # the sweep itself reports it
        return 0
    tiling = tiling_of_starts(tiles.header)
    return tiling.size - sum(tiling.length(tile) for tile in left)
