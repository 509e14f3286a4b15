"""Tiles of a sweep on disk, written, and read with every bit checked.

Each chunk is written to a temporary name and renamed. The record of a tile holds digests of its
inputs and of its columns, and is written after them. So a tile that is incomplete after a crash
counts as unfinished, and is computed again, with the same bytes.
"""

import contextlib
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..._base.digests import SIZE, array_digest, digest
from ..._base.refusals import one_line, printable
from ..columns import MISSING, BasinParts, column_spec
from .arrays import METADATA, StoredArray, content_of, refuse_links
from .claims import Claims
from .errors import StoreDamaged, StoreMismatch
from .folders import absolute_path, exists, remove_left_folders
from .headers import Header, header_digest, sweep_digest
from .layout import CLAIMS, FORMAT, GROUP, RECORDS, STAGING, metadata_digest, tiling_of

MOST_TILES = 1 << 24
"""A store with more tiles is none of a sweep; its list of tiles would fill the memory."""


@contextlib.contextmanager
def _reading(folder: Path, tiles: tuple[int, ...], what: str) -> Iterator[None]:
    """Turn any error of codecs at damaged bytes into `StoreDamaged`.

    The types of their errors are not documented. No user code runs in this context.
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


class TileRecord:
    """The record of a finished tile: digests of its sweep, of its inputs and of its columns."""

    def __init__(self, store: Path, tile: int) -> None:
        file = store / RECORDS / "c" / str(tile) / "0"
        content = file.read_bytes() if file.is_file() else b""
        offsets = range(0, max(len(content), 3 * SIZE), SIZE)
        seal, self.sweep, self.inputs, *self.columns = (
            content[offset : offset + SIZE] for offset in offsets
        )
        self.exists = bool(content)
        self.is_sound = seal == _seal(tile, content[SIZE:])

    @staticmethod
    def encode(tile: int, sweep: bytes, inputs: bytes, columns: list[np.ndarray]) -> bytes:
        """Return the bytes of the record of a tile."""
        content = b"".join([sweep, inputs, *(array_digest(column) for column in columns)])
        return _seal(tile, content) + content


def _seal(tile: int, content: bytes) -> bytes:
    return digest(str(tile).encode(), content)


@dataclass(frozen=True)
class StoredColumn:
    """A flat column in a store, read and checked each time it is indexed.

    Attributes:
        tiles: the store.
        name: the name of the column.
        finished: the tiles to read; numbers in other tiles are `MISSING`. None: all tiles.
        chosen: the flat indices of its entries; None: all entries.
    """

    tiles: "Tiles"
    name: str
    finished: frozenset[int] | None = None
    chosen: np.ndarray | None = None

    def __getitem__(self, key: Any) -> np.ndarray:
        if self.chosen is None:
            return self.tiles.column(self.name, self.finished)[key]
        return self.tiles.entries(self.name, self.chosen, self.finished)[key]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return the whole column, read anew; without this NumPy would wrap the object itself."""
        return np.asarray(self[...], dtype)

    def take(self, flat: np.ndarray, axis: int = 0) -> "StoredColumn":
        """Return the entries with these flat indices; only the tiles that hold them are read."""
        return replace(self, chosen=flat if self.chosen is None else self.chosen[flat])


class Tiles:
    """An open store, from `open_tiles`.

    Attributes:
        folder: its folder.
        header: its header; see `headers`.
        tiling: the division of its columns into tiles.
        names: names of its columns.
    """

    def __init__(self, folder: Path, header: Header) -> None:
        self.folder, self.header = folder, header
        with _reading(folder, (), "its header"):
            self.tiling, self.names = tiling_of(header), list(header["columns"])
            _check_sizes_and_names(folder, header)
            for name, expected in header["layout"].items():
                if metadata_digest(folder, name) != expected:
                    what = f"the metadata of {name}" if name else "its attributes"
                    raise StoreDamaged(folder, (), f"{what} are not as written")
            names, staging = (*self.names, RECORDS, *header["values"]), folder / STAGING
            refuse_links(folder, staging)
            self._arrays = {name: StoredArray.open(folder / name, staging) for name in names}
        self._sweep = sweep_digest(header)

    def values(self, name: str) -> np.ndarray:
        """Return swept values: an axis, or a column of points."""
        what = f"the values of {name}"
        with _reading(self.folder, (), what):
            array = self._arrays[name]
            chunks = range(array.tiling.count)
            if not all(array.file(chunk).is_file() for chunk in chunks):
                raise StoreDamaged(self.folder, (), f"{what} are missing")
            parts = [array.read(chunk) for chunk in chunks]
            values = np.concatenate(parts).reshape(array.shape)
        if array_digest(values).hex() != self.header["values"][name]:
            raise StoreDamaged(self.folder, (), f"{what} are not what was written")
        return values

    def write(self, tile: int, columns: Mapping[str, np.ndarray], inputs: bytes) -> None:
        """Write one tile, then its record; `inputs` is a digest."""
        self._refuse_another()
        kept = {name: np.asarray(columns[name], self._arrays[name].dtype) for name in self.names}
        for name, part in kept.items():
            self._arrays[name].write(tile, part)
        record = TileRecord.encode(tile, self._sweep, inputs, list(kept.values()))
        self._arrays[RECORDS].write(tile, np.frombuffer(record, np.uint8))

    def _refuse_another(self) -> None:
        """Refuse to go on if the folder has been removed, or holds another store now."""
        try:
            header = _header_in(self.folder)
            header.pop("digest")
            is_same = sweep_digest(header) == self._sweep
        except Exception:  # as in `open_tiles`
            is_same = False
        if not is_same:
            reason = f"{self.folder} has been removed, renamed or replaced meanwhile"
            raise StoreMismatch("store", self.folder, "stay in its place", reason)

    def claims(self) -> Claims:
        """Open the claims of this process on tiles."""
        return Claims(self.folder, self.folder / CLAIMS)

    def is_claimed(self) -> bool:
        """Return whether a sweep has claims on tiles at this moment."""
        try:
            claims = self.claims()
        except StoreMismatch:  # a sweep of this process
            return True
        with contextlib.closing(claims), claims.everything() as alone:
            return alone is False

    def written_at(self, tile: int) -> float:
        """Return the time when a finished tile was written, in seconds since the epoch."""
        return self._arrays[RECORDS].file(tile).stat().st_mtime

    def discard_partial_files(self) -> None:
        """Remove what killed processes left behind; no process may be writing."""
        with contextlib.suppress(OSError, ValueError):  # they do no harm
            refuse_links(self.folder, self.folder / STAGING)
            shutil.rmtree(self.folder / STAGING)
        remove_left_folders(self.folder.parent)  # of processes that were about to make this store

    def forget(self, tile: int) -> None:
        """Mark a tile as not computed."""
        record = self._arrays[RECORDS].file(tile)
        refuse_links(self.folder, record.parent)
        record.unlink(missing_ok=True)

    def is_finished(self, tile: int) -> bool:
        """Return whether a tile has been computed."""
        return TileRecord(self.folder, tile).exists

    def unfinished(self) -> list[int]:
        """Return the tiles that have to be computed."""
        return [tile for tile in range(self.tiling.count) if not self.is_finished(tile)]

    def finished(self) -> list[int]:
        """Return the tiles that have been computed."""
        return [tile for tile in range(self.tiling.count) if self.is_finished(tile)]

    def record(self, tile: int) -> TileRecord:
        """Return the record of a finished tile."""
        record = TileRecord(self.folder, tile)
        if not record.exists:
            raise StoreDamaged(self.folder, (tile,), "its record is missing")
        if not record.is_sound or record.sweep != self._sweep:
            raise StoreDamaged(self.folder, (tile,), "its record is not what was written")
        return record

    def read(self, name: str, tile: int) -> np.ndarray:
        """Return the part of a column in a tile, flat except for components."""
        array = self._arrays[name]
        if not array.file(tile).is_file():
            raise StoreDamaged(self.folder, (tile,), f"its {name} is missing")
        written = self.record(tile).columns[self.names.index(name)]
        with _reading(self.folder, (tile,), f"its {name}"):
            part = array.read(tile).reshape(self.tiling.length(tile), *self._components(name))
        if array_digest(part) != written:
            raise StoreDamaged(self.folder, (tile,), f"its {name} is not what was written")
        return part.astype(column_spec(name).dtype, copy=False)

    def _components(self, name: str) -> tuple[int, ...]:
        return self._arrays[name].shape[len(self.tiling.shape) :]

    def column(self, name: str, finished: Set[int] | None = None) -> np.ndarray:
        """Return a column, flat except for components, from all tiles or only from `finished`."""
        every = range(self.tiling.count)
        return np.concatenate([self._part(name, tile, finished) for tile in every])

    def entries(self, name: str, flat: np.ndarray, finished: Set[int] | None = None) -> np.ndarray:
        """Return some entries of a column."""
        found = np.empty((len(flat), *self._components(name)), column_spec(name).dtype)
        of_entry = self.tiling.tiles_with(flat)
        for tile in np.unique(of_entry).tolist():
            here, first = of_entry == tile, self.tiling.span(tile).start
            found[here] = self._part(name, tile, finished)[flat[here] - first]
        return found

    def _part(self, name: str, tile: int, finished: Set[int] | None) -> np.ndarray:
        if finished is None or tile in finished:
            return self.read(name, tile)
        dtype = column_spec(name).dtype
        return np.full((self.tiling.length(tile), *self._components(name)), MISSING[dtype], dtype)

    def contents(self, partial: bool = False) -> BasinParts:
        """Return the basin in the store; its columns are read from disk when they are used.

        With `partial` it contains only the tiles that are finished now.
        """
        header = self.header
        finished = frozenset(self.finished()) if partial else None
        coords = {name: self.values(name) for name in header["axes"]}
        columns = {name: StoredColumn(self, name, finished) for name in self.names}
        dims, shape = tuple(header["dims"]), tuple(header["shape"])
        attrs = {
            name: printable(x) if isinstance(x, str) else x for name, x in header["attrs"].items()
        }
        return BasinParts(dims, shape, coords, columns, attrs)

    def damaged(self, tiles: Iterable[int]) -> dict[int, str]:
        """Return descriptions of the damage of finished tiles, by number of the tile."""
        reasons = {}
        for tile in tiles:
            try:
                for name in self.names:
                    self.read(name, tile)
            except StoreDamaged as error:
                reasons[tile] = error.reason
        return reasons

    def refuse_unfinished(self, what: str) -> None:
        """Raise `StoreMismatch` if the sweep or tally is unfinished."""
        if left := len(self.unfinished()):
            reason = (
                f"{self.folder} is missing {left} of {self.tiling.count} tiles; "
                f"run the {what} again with this store"
            )
            raise StoreMismatch("path", self.folder, f"hold a finished {what}", reason)

    def refuse_damaged(self, damaged: dict[int, str], way_out: str = "") -> None:
        """Raise `StoreDamaged` if there are damaged tiles."""
        if damaged:
            reason = next(iter(damaged.values())) + way_out
            raise StoreDamaged(self.folder, tuple(damaged), reason)


def _header_in(folder: Path) -> Header:
    """Return the header in a folder, with its digest."""
    return dict(json.loads(content_of(folder / GROUP / METADATA))["attributes"])


def _check_sizes_and_names(folder: Path, header: Header) -> None:
    """Refuse a header with sizes that no sweep has, or with names that lead out of the folder."""
    sizes = [*header["shape"], *header["chunk"]]
    count = tiling_of(header).count if all(type(n) is int and n > 0 for n in sizes) else 0
    if not 0 < count <= MOST_TILES:
        shown = f"its shape is {header['shape']}, in tiles of {header['chunk']}"
        raise StoreDamaged(folder, (), one_line(shown))
    for name in (*header["columns"], *header["values"], *header["dims"], *header["axes"]):
        if not name or name in (".", "..") or not name.isprintable() or {"/", "\\"} & {*name}:
            raise StoreDamaged(folder, (), f"it has a column or an axis with the name {name!r}")


def open_store(path: Any) -> Tiles:
    """Open the store at a path for reading."""
    return open_tiles("path", absolute_path("path", path))


def open_tiles(argument: str, folder: Path) -> Tiles:
    """Open the store in a folder.

    Raises:
        StoreMismatch: there is no store.
        StoreDamaged: its metadata are damaged.
    """
    must = "be a folder with a basin"
    if not exists(argument, folder):
        raise StoreMismatch(argument, folder, must, f"{folder} does not exist")
    try:
        header = _header_in(folder)
    except MemoryError:
        raise
    except Exception as error:  # of any type, as in `_reading`
        if (folder / RECORDS).is_dir():
            raise _unreadable(folder, (), "its header", error) from None
        why = error.strerror if isinstance(error, OSError) else one_line(error)
        reason = f"{folder} cannot be read as one ({why})"
        raise StoreMismatch(argument, folder, must, reason) from None
    if header.pop("digest", None) != header_digest(header):
        raise StoreDamaged(folder, (), "its header is not what was written")
    if header["format"] != FORMAT:
        reason = f"{folder} is a {header['format']}"
        raise StoreMismatch(argument, folder, f"be a {FORMAT}", reason)
    return Tiles(folder, header)
