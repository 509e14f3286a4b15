"""Arrays on disk in the format Zarr 3, for any program that reads it.

They are written and read here, not by the library zarr, which takes longer for a chunk than a
thousand runs do, and whose import takes as long as a small map. The bytes are the same.
"""

import json
import math
import os
import secrets
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..tiling import Tiling

METADATA = "zarr.json"
LITTLE = {"name": "bytes", "configuration": {"endian": "little"}}
PACKING = [
    {"name": "zstd", "configuration": {"level": 0, "checksum": False}},
    {"name": "crc32c"},
]
CHECKSUM = 4  # bytes of a crc32c
LARGEST_CHUNK = 1 << 28  # bytes of a chunk that is read
ATTEMPTS = 5  # to write a file


@dataclass(frozen=True)
class StoredArray:
    """An array in a folder of its own, whose chunks are numbered in C order.

    A chunk has one index on the first axes, a range of the next axis, and the full range of all
    later axes. So the numbers of a shortened chunk come first in its file.

    Attributes:
        folder: its folder.
        shape: its shape.
        chunk: the shape of a chunk.
        dtype: the type of its numbers.
        packed: whether chunks are compressed and have a checksum.
        fill: the value of numbers in chunks that are not written.
        dims: names of the axes, if they have any.
        attributes: metadata such as unit and meaning.
        staging: a folder for incomplete chunks; None: the folder of the chunk.
    """

    folder: Path
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    dtype: np.dtype
    packed: bool = True
    fill: Any = 0
    dims: tuple[str, ...] = ()
    attributes: Mapping[str, Any] = field(default_factory=dict)
    staging: Path | None = None

    @classmethod
    def open(cls, folder: Path, staging: Path | None = None) -> "StoredArray":
        """Return the array in a folder.

        Raises:
            ValueError: its format is not the one written here. Other errors if there is no array.
        """
        metadata = json.loads(content_of(folder / METADATA))
        shape, packed = tuple(metadata["shape"]), len(metadata["codecs"]) > 1
        chunk = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
        dtype = np.dtype(metadata["data_type"])
        fill = dtype.type(metadata["fill_value"])
        array = cls(folder, shape, chunk, dtype, packed, fill, staging=staging)
        kind = "codecs", "chunk_key_encoding"
        if any(metadata[name] != array.metadata[name] for name in kind):
            raise ValueError(f"{folder} has chunks of another kind")
        if array.chunk_bytes > LARGEST_CHUNK:
            raise ValueError(f"{folder} has chunks of {array.chunk_bytes} bytes")
        return array

    @property
    def chunk_bytes(self) -> int:
        """The size of a chunk in memory."""
        return math.prod(self.chunk) * self.dtype.itemsize

    def create(self) -> None:
        """Make the folder and write the metadata; there are no chunks yet."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self.folder / METADATA, self.metadata)

    @property
    def metadata(self) -> dict[str, Any]:
        """The metadata that are written beside the chunks."""
        first = LITTLE if self.dtype.itemsize > 1 else {"name": "bytes"}
        fill = self.dtype.type(self.fill).item()
        return {
            "shape": list(self.shape),
            "data_type": self.dtype.name,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(self.chunk)}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": "NaN" if fill != fill else fill,
            "codecs": [first, *(PACKING if self.packed else [])],
            "attributes": dict(self.attributes),
            **({"dimension_names": list(self.dims)} if self.dims else {}),
            "zarr_format": 3,
            "node_type": "array",
            "storage_transformers": [],
        }

    @property
    def tiling(self) -> Tiling:
        """The division of the numbers into chunks."""
        return Tiling(self.shape, self.chunk)

    def file(self, chunk: int) -> Path:
        """Return the path of a chunk."""
        return self.folder.joinpath("c", *(str(i) for i in self.tiling.place(chunk)))

    def write(self, chunk: int, values: np.ndarray) -> None:
        """Write the numbers of a chunk atomically; a shortened chunk is padded."""
        full = np.full(math.prod(self.chunk), self.fill, self.dtype.newbyteorder("<"))
        full[: values.size] = values.ravel()
        content = full.tobytes()
        if self.packed:
            content = _zstd().encode(content)
            content += _crc32c(content).to_bytes(CHECKSUM, "little")
        file = self.file(chunk)
        refuse_links(self.folder.parent, file.parent)
        if not self.staging:
            file.parent.mkdir(parents=True, exist_ok=True)
        write_at_once(file, content, self.staging)

    def write_all(self, values: np.ndarray) -> None:
        """Write every chunk."""
        flat = values.ravel()
        for chunk in range(self.tiling.count):
            self.write(chunk, flat[self.tiling.span(chunk)])

    def read(self, chunk: int) -> np.ndarray:
        """Return the numbers of a chunk, flat.

        Raises:
            ValueError: it is damaged. Other errors if it is missing, or cannot be decompressed.
        """
        content = self.file(chunk).read_bytes()
        if self.packed:
            content, checksum = content[:-CHECKSUM], content[-CHECKSUM:]
            if _crc32c(content).to_bytes(CHECKSUM, "little") != checksum:
                raise ValueError("its checksum is wrong")
            if _content_size(content) != self.chunk_bytes:
                raise ValueError("its length is wrong")
            content = _zstd().decode(content)
        little = np.frombuffer(content, self.dtype.newbyteorder("<"))
        if little.size != math.prod(self.chunk):
            raise ValueError("its length is wrong")
        return little.astype(self.dtype, copy=False)[: self.tiling.length(chunk)]


def write_json(file: Path, content: dict[str, Any]) -> None:
    """Write metadata."""
    write_at_once(file, json.dumps(content, indent=2).encode())


def write_at_once(file: Path, content: bytes, staging: Path | None = None) -> None:
    """Write a file in `staging`, and move it to its place when it is complete.

    A missing folder is made only inside the folder that holds `staging`: a store that somebody has
    removed is not begun again.
    """
    folder = staging or file.parent
    part = folder / f".{file.name}.{secrets.token_hex(8)}.partial"
    try:
        for attempts_left in reversed(range(ATTEMPTS)):
            try:
                part.write_bytes(content)
                os.replace(part, file)
                return
            except FileNotFoundError:
                # A folder is missing. Or, if locks are visible on one machine only, another machine
                # took the partial file for one left by a killed process, and removed it.
                if not attempts_left or staging is None or not staging.parent.is_dir():
                    raise
                staging.mkdir(exist_ok=True)
                file.parent.mkdir(parents=True, exist_ok=True)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def content_of(file: Path) -> bytes:
    """Return the content of a regular file.

    Raises:
        ValueError: the file is of another kind; to read a pipe could take for ever.
    """
    wait_not = getattr(os, "O_NONBLOCK", 0)
    with open(file, "rb", opener=lambda path, flags: os.open(path, flags | wait_not)) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise ValueError(f"{file} is no ordinary file")
        return stream.read()


def refuse_links(folder: Path, inside: Path) -> None:
    """Refuse to write or delete in a folder inside another one if a link leads there.

    Raises:
        ValueError: a part of the path from `folder` to `inside` is a link.
    """
    for part in (inside, *inside.parents):
        if part == folder:
            return
        if part.is_symlink():
            raise ValueError(f"{part} is a link, and nothing is written behind links")


def _content_size(frame: bytes) -> int | None:
    """Return the size of the content that a Zstandard frame states; None if it states none."""
    descriptor = frame[4]
    single = descriptor >> 5 & 1  # then there is no byte for the window
    length = (single, 2, 4, 8)[descriptor >> 6]
    first = 6 - single + (0, 1, 2, 4)[descriptor & 3]
    size = int.from_bytes(frame[first : first + length], "little")
    return size + 256 * (length == 2) if length else None


def _zstd() -> Any:
    from numcodecs.zstd import Zstd

    return Zstd(level=0)


def _crc32c(content: bytes) -> int:
    import google_crc32c

    return google_crc32c.value(content)
