"""Tiles of a sweep on disk: how they are laid out, written, and read with every bit checked.

A store is a Zarr group of flat columns, one chunk for each tile, of arrays with the swept values,
and of one record for each finished tile: digests of its inputs and of its columns. Each chunk is
written to a temporary name and renamed. A record is written after its columns, so a tile torn by a
crash is simply not finished, and is computed again to the same bytes.
"""

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..._base.digests import SIZE, array_digest, digest
from ..columns import BasinParts, column_spec
from ..tiling import Tiling
from .arrays import METADATA, StoredArray, write_json
from .errors import StoreDamaged, StoreMismatch
from .folders import absolute_path, exists
from .headers import Header, header_digest, sweep_digest

FORMAT = "dipoletop basin, version 2"
FORMAT_UNCHECKED = "dipoletop basin, version 1"  # no checksums, only a flag for each tile


@contextlib.contextmanager
def _reading(folder: Path, tiles: tuple[int, ...], what: str) -> Iterator[None]:
    """Turns whatever codecs and the library zarr raise at damaged bytes into `StoreDamaged`.

    The types of their errors are not documented. No code of the user runs in here.
    """
    try:
        yield
    except (StoreDamaged, MemoryError):
        raise
    except Exception as error:
        raise _unreadable(folder, tiles, what, error) from None


def _unreadable(folder: Path, tiles: tuple[int, ...], what: str, error: Exception) -> StoreDamaged:
    why = " ".join(f"{type(error).__name__} {error}".split())
    return StoreDamaged(folder, tiles, f"{what} cannot be read ({why})")


def create_arrays(folder: Path, header: Header, values: Mapping[str, np.ndarray]) -> None:
    """An empty store: metadata and the swept values, but no tile."""
    tiling, names = tiling_of(header), header["columns"]
    new: dict[str, StoredArray] = {}
    for name in names:
        dtype = np.dtype(column_spec(name).dtype)
        new[name] = StoredArray(folder / name, (tiling.size,), tiling.tile_size, dtype)
    for name, array in values.items():
        rows = min(len(array), 1 << 20)  # codecs take no more than 2 GiB at once
        new[f"axis_{name}"] = StoredArray(folder / f"axis_{name}", array.shape, rows, array.dtype)
    shape = tiling.count, SIZE * (3 + len(names))
    # Not compressed: a record is its own checksum.
    new["done"] = StoredArray(folder / "done", shape, 1, np.dtype("uint8"), codecs=())
    for array in new.values():
        array.create()
    for name, numbers in values.items():
        array = new[f"axis_{name}"]
        for chunk in range(array.chunks):
            array.write(chunk, numbers[chunk * array.rows :][: array.rows])
    layout = {name: _metadata_digest(folder, name) for name in new}
    full = {"format": FORMAT, "layout": layout, **header}
    attributes = {**full, "digest": header_digest(full)}
    group = {"attributes": attributes, "zarr_format": 3, "node_type": "group"}
    write_json(folder / METADATA, group)


def tiling_of(header: Header) -> Tiling:
    """How the columns of a store are cut into tiles."""
    return Tiling(int(np.prod(header["shape"])), int(header["tile"]))


def _metadata_digest(folder: Path, array: str) -> str:
    return digest((folder / array / "zarr.json").read_bytes()).hex()


class TileRecord:
    """What is kept of a finished tile: digests of its sweep, of its inputs and of its columns."""

    def __init__(self, folder: Path, tile: int) -> None:
        file = folder / "done" / "c" / str(tile) / "0"
        content = file.read_bytes() if file.is_file() else b""
        offsets = range(0, max(len(content), 3 * SIZE), SIZE)
        seal, self.sweep, self.inputs, *self.columns = (
            content[offset : offset + SIZE] for offset in offsets
        )
        self.exists = bool(content)
        self.is_sound = seal == _seal(tile, content[SIZE:])

    @staticmethod
    def encode(tile: int, sweep: bytes, inputs: bytes, columns: list[np.ndarray]) -> bytes:
        """The bytes of the record of a tile."""
        content = b"".join([sweep, inputs, *(array_digest(column) for column in columns)])
        return _seal(tile, content) + content


def _seal(tile: int, content: bytes) -> bytes:
    return digest(str(tile).encode(), content)


@dataclass(frozen=True)
class StoredColumn:
    """A column in a store, read and checked each time it is indexed."""

    tiles: "Tiles"
    name: str

    def __getitem__(self, key: Any) -> np.ndarray:
        return self.tiles.column(self.name)[key]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """All of the column, read anew: without this NumPy would wrap the object itself."""
        return np.asarray(self[...], dtype)


class Tiles:
    """An open store of either version, as `open_tiles` gives it.

    Attributes:
        folder: its folder.
        header: what it says about the sweep; see `headers`.
        checked: whether it has checksums, as version 2 does.
        tiling: how its columns are cut into tiles.
        names: those of its columns.
        swept_names: those of the swept values.
    """

    def __init__(self, folder: Path, header: Header, checked: bool) -> None:
        self.folder, self.header, self.checked = folder, header, checked
        with _reading(folder, (), "its header"):
            self.tiling, self.names = tiling_of(header), list(header["columns"])
            for name, expected in header.get("layout", {}).items():
                if _metadata_digest(folder, name) != expected:
                    raise StoreDamaged(folder, (), f"the metadata of {name} are not as written")
            self.swept_names = list(header["values" if checked else "axes"])
            axes = (f"axis_{name}" for name in self.swept_names)
            names = (*self.names, "done", *axes)
            self._arrays = {name: StoredArray.open(folder / name) for name in names}
        self._sweep = sweep_digest(header) if checked else b""

    def values(self, name: str) -> np.ndarray:
        """What was swept: an axis, or a column of points."""
        what = f"the values of {name}"
        with _reading(self.folder, (), what):
            array = self._arrays[f"axis_{name}"]
            chunks = range(array.chunks)
            if not all(array.file(chunk).is_file() for chunk in chunks):
                raise StoreDamaged(self.folder, (), f"{what} are missing")
            values = np.concatenate([array.read(chunk) for chunk in chunks])
        if self.checked and array_digest(values).hex() != self.header["values"][name]:
            raise StoreDamaged(self.folder, (), f"{what} are not what was written")
        return values

    def write(self, tile: int, columns: dict[str, np.ndarray], inputs: bytes) -> None:
        """Write one tile, then its record; `inputs` is a digest."""
        parts = [columns[name] for name in self.names]
        for name, part in zip(self.names, parts, strict=True):
            self._arrays[name].write(tile, part)
        record = TileRecord.encode(tile, self._sweep, inputs, parts)
        self._arrays["done"].write(tile, np.frombuffer(record, np.uint8)[None])

    def unfinished(self) -> list[int]:
        """The tiles that have to be computed."""
        every = range(self.tiling.count)
        if self.checked:
            return [tile for tile in every if not TileRecord(self.folder, tile).exists]
        with _reading(self.folder, (), "the flags"):
            flags = self._arrays["done"]
            return [t for t in every if not (flags.file(t).is_file() and flags.read(t).any())]

    def record(self, tile: int) -> TileRecord:
        """The record of a finished tile."""
        record = TileRecord(self.folder, tile)
        if not record.exists:
            raise StoreDamaged(self.folder, (tile,), "its record is missing")
        if not record.is_sound or record.sweep != self._sweep:
            raise StoreDamaged(self.folder, (tile,), "its record is not what was written")
        return record

    def read(self, name: str, tile: int) -> np.ndarray:
        """The part of a column in a tile."""
        if not self._arrays[name].file(tile).is_file():
            raise StoreDamaged(self.folder, (tile,), f"its {name} is missing")
        written = self.record(tile).columns[self.names.index(name)] if self.checked else None
        with _reading(self.folder, (tile,), f"its {name}"):
            part = self._arrays[name].read(tile)
        complete = len(part) == self.tiling.length(tile)
        if not complete or (self.checked and array_digest(part) != written):
            raise StoreDamaged(self.folder, (tile,), f"its {name} is not what was written")
        return part

    def column(self, name: str) -> np.ndarray:
        """A column of a finished sweep."""
        return np.concatenate([self.read(name, tile) for tile in range(self.tiling.count)])

    def contents(self) -> BasinParts:
        """The basin in the store; its columns are read from disk when they are used."""
        header = self.header
        coords = {name: self.values(name) for name in header["axes"]}
        columns = {name: StoredColumn(self, name) for name in self.names}
        dims, shape = tuple(header["dims"]), tuple(header["shape"])
        return BasinParts(dims, shape, coords, columns, dict(header["attrs"]))

    def damaged(self, tiles: Iterable[int]) -> dict[int, str]:
        """What is wrong with those of the finished tiles that are damaged, by their numbers."""
        reasons = {}
        for tile in tiles:
            try:
                for name in self.names:
                    self.read(name, tile)
            except StoreDamaged as error:
                reasons[tile] = error.reason
        return reasons

    def refuse_damaged(self, damaged: dict[int, str], way_out: str = "") -> None:
        """Raise what is wrong with them, if there are any."""
        if damaged:
            reason = next(iter(damaged.values())) + way_out
            raise StoreDamaged(self.folder, tuple(damaged), reason)


def open_store(path: Any) -> Tiles:
    """The store at a path, to be read."""
    return open_tiles("path", absolute_path("path", path))


def open_tiles(argument: str, folder: Path) -> Tiles:
    """The store in a folder.

    Raises:
        StoreMismatch: there is none.
        StoreDamaged: its metadata are damaged.
    """
    must = "be a folder with a basin"
    if not exists(argument, folder):
        raise StoreMismatch(argument, folder, must, f"{folder} does not exist")
    was_store = (folder / "done").is_dir()
    try:
        header = dict(json.loads((folder / METADATA).read_bytes())["attributes"])
    except MemoryError:
        raise
    except Exception as error:  # of any type, as in `_reading`
        if was_store:
            raise _unreadable(folder, (), "its header", error) from None
        reason = f"{folder} cannot be read as one ({error})"
        raise StoreMismatch(argument, folder, must, reason) from None
    version, written = header.get("format"), header.pop("digest", None)
    is_known = version in (FORMAT, FORMAT_UNCHECKED)
    checked = written is not None or version != FORMAT_UNCHECKED
    if checked and (is_known or was_store) and written != header_digest(header):
        raise StoreDamaged(folder, (), "its header is not what was written")
    if not is_known:
        reason = f"the format of {folder} is {version!r}"
        raise StoreMismatch(argument, folder, f"be a {FORMAT}", reason)
    return Tiles(folder, header, checked)
