"""Basins on disk: of a sweep, begun or resumed; saved, loaded, verified."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..._base.digests import SIZE
from ..columns import BasinParts, is_result
from ..tiling import TILE, Tiling
from .arrays import METADATA, refuse_links
from .errors import StoreDamaged, StoreMismatch
from .folders import absolute_path, atomic_folder, exists, hidden_folder
from .headers import Header, differences, first_difference, sweep_digest, with_value_digests
from .layout import GROUP, create_arrays, tiling_of, tiling_of_starts
from .tiles import TileRecord, Tiles, open_store, open_tiles

THIS_SWEEP = "be new or hold this very sweep"


class Verification(NamedTuple):
    """The state of a store, from `verify`."""

    tiles: int
    """Number of tiles."""
    unfinished: list[int]
    """Numbers of the tiles that are not computed yet."""
    damaged: dict[int, str]
    """Descriptions of the damage, by number of the tile."""


def begin_or_resume(
    path: Any, header: Header, values: Mapping[str, np.ndarray], repair: bool = False
) -> Tiles:
    """Return a new store at `path`, or the existing one if it belongs to the same sweep.

    Args:
        path: a folder.
        header: the data that identify this sweep; see `headers`.
        values: the swept values by name.
        repair: whether to write damaged metadata again.

    Raises:
        StoreMismatch: the path cannot be used, or holds something else.
        StoreDamaged: its metadata are damaged, and are not to be repaired.
    """
    folder = absolute_path("store", path)
    header = with_value_digests(header, values)
    if not exists("store", folder):
        # Another process may begin the same sweep at this moment.
        with contextlib.suppress(FileExistsError), atomic_folder("store", folder) as fresh:
            create_arrays(fresh, header, values)
    try:
        tiles = open_tiles("store", folder)
        different = differences(
            tiles.header, header, lambda x: first_difference(x, tiles.values(x), values[x])
        )
        for name in tiles.header["values"]:
            tiles.values(name)
    except StoreDamaged:
        if not repair:
            raise
        return _with_new_metadata(folder, header, values)
    if different:
        reason = f"{folder} holds another sweep: {different}"
        raise StoreMismatch("store", folder, THIS_SWEEP, reason)
    return tiles


def _with_new_metadata(folder: Path, header: Header, values: Mapping[str, np.ndarray]) -> Tiles:
    """Write a store's metadata again if its records belong to this sweep; return the store."""
    every = (TileRecord(folder, tile) for tile in range(tiling_of(header).count))
    records = [record for record in every if record.is_sound]
    if not records or any(record.sweep != sweep_digest(header) for record in records):
        reason = f"the metadata of {folder} are damaged, and it has no tiles of this sweep"
        raise StoreMismatch("store", folder, THIS_SWEEP, reason)
    with hidden_folder(folder.parent) as fresh:
        create_arrays(fresh, header, values)
        # The header is written last; until then the store counts as damaged.
        header_file = fresh / GROUP / METADATA
        for file in sorted(fresh.rglob("*"), key=lambda file: file == header_file):
            if file.is_file():
                target = folder / file.relative_to(fresh)
                refuse_links(folder, target.parent)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, target)
    return open_tiles("store", folder)


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
    for name in tiles.header["values"]:
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
