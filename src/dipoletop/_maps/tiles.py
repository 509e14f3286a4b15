"""Tiles of a sweep on disk: how they are laid out, written, and read with every bit checked.

A store is a Zarr group of flat columns, one chunk for each tile, of arrays with what was swept,
and of one record for each finished tile: digests of its inputs and of its columns. Zarr writes
each chunk to a temporary name and renames it. A record is written after its columns, so a tile
torn by a crash is simply not finished, and is computed again to the same bytes.
"""

import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._base.digests import SIZE, array_digest, digest
from .basin import kind_of

FORMAT = "dipoletop basin, version 2"
UNCHECKED = "dipoletop basin, version 1"  # which had no checksums, only a flag for each tile


class StoreDamaged(ValueError):
    """A store on disk is not as it was written.

    Attributes:
        path: the store.
        tiles: the numbers of its damaged tiles; none if its metadata are damaged.
        reason: what was found.
    """

    def __init__(self, path: Path, tiles: tuple[int, ...], reason: str) -> None:
        super().__init__(path, tiles, reason)
        self.path, self.tiles, self.reason = path, tiles, reason

    def __str__(self) -> str:
        shown = ", ".join(str(tile) for tile in self.tiles[:8])
        shown += f" and {len(self.tiles) - 8} more" if len(self.tiles) > 8 else ""
        what = f"tile{'s' * (len(self.tiles) > 1)} {shown}" if self.tiles else "metadata"
        return f"The store {self.path} is damaged, {what}: {self.reason}."


@contextlib.contextmanager
def reading(place: Path, tiles: tuple[int, ...], what: str) -> Iterator[None]:
    """Whatever zarr and its codecs raise at damaged bytes says where these are."""
    try:
        yield
    except (StoreDamaged, MemoryError):
        raise
    except Exception as error:
        why = " ".join(f"{type(error).__name__} {error}".split())
        raise StoreDamaged(place, tiles, f"{what} cannot be read ({why})") from None


def lay_out(place: Path, header: dict[str, Any], values: Mapping[str, np.ndarray]) -> None:
    """An empty store: metadata and what is swept, but no tile."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    group = zarr.open_group(place, mode="w")
    packed: Any = {"compressors": [ZstdCodec(level=0), Crc32cCodec()]}
    size, tile, names = int(np.prod(header["shape"])), header["tile"], header["columns"]
    for name in names:
        group.create_array(name, shape=(size,), chunks=(tile,), dtype=kind_of(name)[0], **packed)
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, array in values.items():
            rows = min(len(array), 1 << 20)  # codecs take no more than 2 GiB at once
            chunks = (rows, *array.shape[1:])
            group.create_array(f"axis_{name}", data=array, chunks=chunks, **packed)
    # As plain bytes: a record is its own checksum.
    shape = (-(-size // tile), SIZE * (3 + len(names)))
    group.create_array("done", shape=shape, chunks=(1, shape[1]), dtype="uint8", compressors=None)
    made = (*names, *(f"axis_{name}" for name in values), "done")
    layout = {name: file_digest(place / name / "zarr.json") for name in made}
    full = {"format": FORMAT, "layout": layout, **header}
    group.attrs.update({**full, "digest": header_digest(full)})


def file_digest(path: Path) -> str:
    """That of all bytes of a file."""
    return digest(path.read_bytes()).hex()


def header_digest(header: dict[str, Any]) -> str:
    """That of a header without its own `digest`."""
    return digest(json.dumps(header, sort_keys=True).encode()).hex()


def lasting(header: dict[str, Any]) -> dict[str, Any]:
    """What must agree for a sweep to go on: versions may change."""
    attrs = {key: x for key, x in header["attrs"].items() if not key.startswith("version_")}
    return {**header, "attrs": attrs}


def identity(header: dict[str, Any]) -> bytes:
    """Which sweep a header belongs to."""
    own = {key: x for key, x in lasting(header).items() if key not in ("format", "layout")}
    return bytes.fromhex(header_digest(own))


class Record:
    """What is kept of a finished tile: whose it is, and digests of its inputs and columns."""

    def __init__(self, place: Path, tile: int) -> None:
        file = place / "done" / "c" / str(tile) / "0"
        self.bytes = file.read_bytes() if file.is_file() else b""
        seal, self.sweep, self.inputs, *self.columns = (
            self.bytes[at : at + SIZE] for at in range(0, max(len(self.bytes), 3 * SIZE), SIZE)
        )
        self.sound = seal == _seal(tile, self.bytes[SIZE:])
        self.exists = bool(self.bytes)

    @staticmethod
    def made(tile: int, sweep: bytes, inputs: bytes, columns: list[np.ndarray]) -> bytes:
        """The bytes of the record of a tile."""
        rest = b"".join([sweep, inputs, *(array_digest(column) for column in columns)])
        return _seal(tile, rest) + rest


def _seal(tile: int, rest: bytes) -> bytes:
    return digest(str(tile).encode(), rest)


class Tiles:
    """A store that is there, of either version; its header is checked when it is opened."""

    def __init__(self, place: Path, group: Any) -> None:
        import zarr

        self.place = place
        header = dict(group.attrs)
        written = header.pop("digest", None)
        self.checked = written is not None or header.get("format") != UNCHECKED
        self.header: dict[str, Any] = header
        with reading(place, (), "its header"):
            if self.checked and written != header_digest(header):
                raise StoreDamaged(place, (), "its header is not what was written")
            self.tile, self.names = int(header["tile"]), list(header["columns"])
            self.size = int(np.prod(header["shape"]))
            self.count = -(-self.size // self.tile)
            self._arrays = {}
            for name, expected in header.get("layout", {}).items():
                if file_digest(place / name / "zarr.json") != expected:
                    raise StoreDamaged(place, (), f"the metadata of {name} are not as written")
            swept = header["values"] if self.checked else header["axes"]
            # Chunks of nothing but zeros are written too: one that lacks is a damage.
            with zarr.config.set({"array.write_empty_chunks": True}):
                for name in (*self.names, "done", *(f"axis_{name}" for name in swept)):
                    self._arrays[name] = group[name]
        self._sweep = identity(header) if self.checked else b""

    def values(self, name: str) -> np.ndarray:
        """What was swept: an axis, or a column of points."""
        what = f"the values of {name}"
        with reading(self.place, (), what):
            array = self._arrays[f"axis_{name}"]
            if array.nchunks_initialized != array.nchunks:
                raise StoreDamaged(self.place, (), f"{what} are missing")
            values = np.asarray(array[...])
        if self.checked and array_digest(values).hex() != self.header["values"][name]:
            raise StoreDamaged(self.place, (), f"{what} are not what was written")
        return values

    def length(self, tile: int) -> int:
        """How many starts a tile has."""
        return min(self.tile, self.size - tile * self.tile)

    def write(self, tile: int, columns: dict[str, np.ndarray], inputs: bytes) -> None:
        """Write one tile, then its record; `inputs` is a digest."""
        start = tile * self.tile
        for name in self.names:
            self._arrays[name][start : start + len(columns[name])] = columns[name]
        parts = [columns[name] for name in self.names]
        record = Record.made(tile, self._sweep, inputs, parts)
        self._arrays["done"][tile] = np.frombuffer(record, np.uint8)

    def unfinished(self) -> list[int]:
        """The tiles that have to be computed."""
        if self.checked:
            return [tile for tile in range(self.count) if not Record(self.place, tile).exists]
        with reading(self.place, (), "the flags"):
            flags = np.asarray(self._arrays["done"][:])
        return np.flatnonzero(flags[: self.count] == 0).tolist()

    def record(self, tile: int) -> Record:
        """What is known of a finished tile."""
        record = Record(self.place, tile)
        if not record.exists:
            raise StoreDamaged(self.place, (tile,), "its record is missing")
        if not record.sound or record.sweep != self._sweep:
            raise StoreDamaged(self.place, (tile,), "its record is not what was written")
        return record

    def read(self, name: str, tile: int) -> np.ndarray:
        """A column's part in a tile."""
        if not (self.place / name / "c" / str(tile)).is_file():
            raise StoreDamaged(self.place, (tile,), f"its {name} is missing")
        written = self.record(tile).columns[self.names.index(name)] if self.checked else None
        start = tile * self.tile
        with reading(self.place, (tile,), f"its {name}"):
            part = np.asarray(self._arrays[name][start : start + self.tile])
        if len(part) != self.length(tile) or (self.checked and array_digest(part) != written):
            raise StoreDamaged(self.place, (tile,), f"its {name} is not what was written")
        return part

    def column(self, name: str) -> np.ndarray:
        """A column of a finished sweep."""
        return np.concatenate([self.read(name, tile) for tile in range(self.count)])

    def damaged(self, tiles: list[int]) -> dict[int, str]:
        """Which of the finished tiles are damaged, and what is wrong with them."""
        found = {}
        for tile in tiles:
            try:
                for name in self.names:
                    self.read(name, tile)
            except StoreDamaged as error:
                found[tile] = error.reason
        return found

    def refuse_damaged(self, damaged: dict[int, str], way_out: str = "") -> None:
        """Raise what is wrong with them, if there are any."""
        if damaged:
            reason = next(iter(damaged.values())) + way_out
            raise StoreDamaged(self.place, tuple(damaged), reason)
