"""The store of a sweep: a new one, or an existing one that the same sweep resumes."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import METADATA
from .errors import StoreDamaged, StoreMismatch
from .folders import absolute_path, atomic_folder, exists, hidden_folder
from .headers import Header, differences, first_difference, sweep_digest, with_value_digests
from .layout import GROUP, create_arrays, tiling_of
from .tiles import TileRecord, Tiles, open_tiles

THIS_SWEEP = "be new or hold this very sweep"


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
    with hidden_folder(folder.parent) as hidden:
        fresh = Path(hidden)
        create_arrays(fresh, header, values)
        # The header is written last; until then the store counts as damaged.
        header_file = fresh / GROUP / METADATA
        for file in sorted(fresh.rglob("*"), key=lambda file: file == header_file):
            if file.is_file():
                target = folder / file.relative_to(fresh)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, target)
    return open_tiles("store", folder)
