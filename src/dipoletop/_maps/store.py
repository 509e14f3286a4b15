"""Basins on disk: made, gone on with, mended, saved, loaded, and verified."""

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import refuse
from .._base.digests import SIZE, array_digest
from .basin import Basin
from .places import absolute, there, whole
from .tiles import (
    FORMAT,
    UNCHECKED,
    Record,
    StoreDamaged,
    Tiles,
    header_digest,
    identity,
    lasting,
    lay_out,
)


@dataclass(frozen=True)
class Column:
    """A column in a store, read and checked whenever it is asked for."""

    tiles: Tiles
    name: str

    def __getitem__(self, key: Any) -> np.ndarray:
        return self.tiles.column(self.name)[key]


class Report(NamedTuple):
    """What `verify` found."""

    tiles: int
    """How many there are."""
    unfinished: list[int]
    damaged: dict[int, str]
    """What is wrong with a tile, by its number."""
    checksums: bool
    """Whether the store has any; else only what is missing or cannot be read was found."""


def create(
    path: Any, header: dict[str, Any], values: Mapping[str, np.ndarray], repair: bool = False
) -> Tiles:
    """A new store, or the one at `path` if it belongs to the same sweep.

    Args:
        path: a folder.
        header: dims, shape, tile (starts in a chunk), columns (their names), axes (theirs), attrs,
            and what tells the problem.
        values: what is swept, by name.
        repair: whether to write damaged metadata anew.

    Raises:
        ValueError: it holds something else.
        StoreDamaged: its metadata are damaged, and not to be repaired.
    """
    place = absolute("store", path)
    digests = {name: array_digest(x).hex() for name, x in values.items()}
    header = json.loads(json.dumps({**header, "values": digests}))
    if not there("store", place):
        with whole("store", place) as fresh:
            lay_out(fresh, header, values)
        return _open("store", place, "r+")
    try:
        tiles = _open("store", place, "r+")
        if not tiles.checked:
            must = f"be new or a {FORMAT}, to go on with it"
            refuse("store", must, f"{place} is a {UNCHECKED} (`Basin.load` reads it)")
        different = list(_differences(tiles, header, values))
        for name in tiles.header["values"]:
            tiles.values(name)
    except StoreDamaged:
        if not repair:
            raise
        return _renewed(place, header, values)
    if different:
        was = f"{place} holds another sweep: {', '.join(different)}{_jax(tiles, header)}"
        refuse("store", "be new or hold this very sweep", was)
    return tiles


def _differences(
    tiles: Tiles, header: dict[str, Any], values: Mapping[str, np.ndarray]
) -> Iterator[str]:
    """Each setting that differs, with both values."""
    there, here = (dict(_flat(lasting(h))) for h in (tiles.header, header))
    for key in {**there, **here}:
        old, new = there.get(key), here.get(key)
        if old == new or key[0] in ("format", "layout"):
            continue
        *group, name = key
        if group == ["values"] and old and new:
            yield _first_difference(name, tiles.values(name), values[name])
        elif group == ["programs"]:
            yield f"the program of `{name}` is {str(old)[:8]} there and {str(new)[:8]} here"
        else:
            yield f"{name} is {old} there and {new} here"


def _flat(header: dict[str, Any], group: tuple[str, ...] = ()) -> Iterator[tuple[Any, Any]]:
    for key, value in header.items():
        if isinstance(value, dict):
            yield from _flat(value, (*group, key))
        else:
            yield (*group, key), value


def _first_difference(name: str, there: np.ndarray, here: np.ndarray) -> str:
    if there.shape != here.shape or there.dtype != here.dtype:
        kinds = [f"{x.dtype} of shape {x.shape}" for x in (there, here)]
        return f"{name} is {kinds[0]} there and {kinds[1]} here"
    bits = [np.ascontiguousarray(x).view(f"u{x.itemsize}") for x in (there, here)]
    other = np.any((bits[0] != bits[1]).reshape(len(there), -1), axis=1)
    first = int(np.argmax(other))
    values = f"is {there[first].tolist()} there and {here[first].tolist()} here"
    return f"{name}[{first}] {values} ({np.sum(other)} of {len(other)} differ)"


def _jax(tiles: Tiles, header: dict[str, Any]) -> str:
    """Of programs that differ: that another JAX may have traced the same."""
    old, new = (h["attrs"].get("version_jax") for h in (tiles.header, header))
    if old == new or tiles.header.get("programs") == header.get("programs"):
        return ""
    return f" (JAX {old} traced it there and JAX {new} here, which may differ by that alone)"


def _renewed(place: Path, header: dict[str, Any], values: Mapping[str, np.ndarray]) -> Tiles:
    """The store with new metadata, if its records say that it belongs to this sweep."""
    tiles = -(-int(np.prod(header["shape"])) // header["tile"])
    records = [record for tile in range(tiles) if (record := Record(place, tile)).sound]
    if not records or any(record.sweep != identity(header) for record in records):
        was = f"the metadata of {place} are damaged, and its tiles are of another one, or none"
        refuse("store", "be new or hold this very sweep", was)
    with tempfile.TemporaryDirectory(prefix=".dipoletop-", dir=place.parent) as folder:
        fresh = Path(folder)
        lay_out(fresh, header, values)
        # The header last: until then the store is known to be damaged.
        for file in sorted(fresh.rglob("*"), key=lambda file: file == fresh / "zarr.json"):
            if file.is_file():
                target = place / file.relative_to(fresh)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, target)
    return _open("store", place, "r+")


def save(basin: Basin, path: Any) -> None:
    """Write a basin as one tile."""
    place = absolute("path", path)
    if there("path", place):
        refuse("path", "not exist yet", f"{place} does")
    header = {
        "dims": list(basin.dims),
        "shape": list(basin.shape),
        "tile": int(np.prod(basin.shape)),
        "columns": list(basin.columns),
        "attrs": basin.attrs,
        "axes": list(basin.coords),
        "values": {name: array_digest(x).hex() for name, x in basin.coords.items()},
    }
    columns = {name: basin.column(name).reshape(-1) for name in basin.columns}
    with whole("path", place) as fresh:
        lay_out(fresh, json.loads(json.dumps(header)), basin.coords)
        _open("path", fresh, "r+").write(0, columns, bytes(SIZE))


def load(path: Any) -> Basin:
    """The basin at `path`; see `Basin.load`."""
    tiles = opened(path)
    basin = view(tiles)
    if left := len(tiles.unfinished()):
        refuse(
            "path",
            "hold a finished sweep",
            f"{tiles.place} lacks {left} of {tiles.count} tiles; "
            "run the sweep again with this store",
        )
    tiles.refuse_damaged(tiles.damaged(list(range(tiles.count))))
    return basin


def view(tiles: Tiles, seconds: float = np.nan) -> Basin:
    """The basin in a store, read from disk column by column when asked."""
    header = tiles.header
    coords = {name: tiles.values(name) for name in header["axes"]}
    columns = {name: Column(tiles, name) for name in tiles.names}
    dims, shape = tuple(header["dims"]), tuple(header["shape"])
    return Basin(dims, shape, coords, columns, dict(header["attrs"]), seconds)


def verify(path: Any) -> Report:
    """Read everything in a store, finished or not.

    Raises:
        ValueError: it is no store.
        StoreDamaged: its metadata are damaged.
    """
    tiles = opened(path)
    for name in tiles.header["values"] if tiles.checked else tiles.header["axes"]:
        tiles.values(name)
    left = tiles.unfinished()
    damaged = tiles.damaged([tile for tile in range(tiles.count) if tile not in set(left)])
    return Report(tiles.count, left, damaged, tiles.checked)


def finished(path: Any, repair: bool = False) -> int:
    """How many starts a sweep need not compute; 0 for what is no store."""
    try:
        tiles = opened(path)
        left = tiles.unfinished()
        if repair:
            left += tiles.damaged(sorted(set(range(tiles.count)) - set(left)))
    except ValueError:  # which is said when the sweep begins
        return 0
    return tiles.size - sum(tiles.length(tile) for tile in left)


def opened(path: Any) -> Tiles:
    """The store at a path, to be read."""
    return _open("path", absolute("path", path), "r")


def _open(argument: str, place: Path, mode: Any) -> Tiles:
    import zarr

    if not there(argument, place):
        refuse(argument, "be a folder with a basin", f"{place} does not exist")
    try:
        group = zarr.open_group(place, mode=mode)
        header = dict(group.attrs)
    except Exception as error:
        if (place / "done").is_dir():
            why = " ".join(f"{type(error).__name__} {error}".split())
            raise StoreDamaged(place, (), f"its header cannot be read ({why})") from None
        refuse(argument, "be a folder with a basin", f"{place} cannot be read as one ({error})")
    found, written = header.get("format"), header.pop("digest", None)
    if found in (FORMAT, UNCHECKED):
        return Tiles(place, group)
    if (place / "done").is_dir() and written != header_digest(header):
        raise StoreDamaged(place, (), "its header is not what was written")
    refuse(argument, f"be a {FORMAT}", f"the format of {place} is {found!r}")
