"""Arrays on disk in the format Zarr 3, for any program that reads it; chunks are rows of axis 0.

They are written and read here, not by the library zarr: for each chunk that takes longer than a
thousand runs do, and its import as long as a small map. The bytes are the same.
"""

import json
import os
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

METADATA = "zarr.json"
LITTLE = {"name": "bytes", "configuration": {"endian": "little"}}
CODECS: dict[str, dict[str, Any]] = {
    "zstd": {"name": "zstd", "configuration": {"level": 0, "checksum": False}},
    "crc32c": {"name": "crc32c"},
}
CHECKSUM = 4  # bytes of a crc32c


@dataclass(frozen=True)
class StoredArray:
    """An array in a folder of its own.

    Attributes:
        folder: its folder.
        shape: its shape.
        rows: the number of rows in a chunk.
        dtype: the type of its numbers.
        codecs: what chunks go through: compression, and a checksum, which version 1 lacked.
    """

    folder: Path
    shape: tuple[int, ...]
    rows: int
    dtype: np.dtype
    codecs: tuple[str, ...] = ("zstd", "crc32c")

    @classmethod
    def open(cls, folder: Path) -> "StoredArray":
        """The array in a folder.

        Raises:
            ValueError: it is not of the kind that is written here. Other errors where there is
                none.
        """
        metadata = json.loads((folder / METADATA).read_bytes())
        (first, *others), keys = metadata["codecs"], metadata["chunk_key_encoding"]
        codecs = tuple(codec["name"] for codec in others)
        endian = first.get("configuration", {}).get("endian", "little")
        separator = keys.get("configuration", {}).get("separator", "/")
        known = codecs in ((), ("zstd",), ("zstd", "crc32c")) and endian == "little"
        if not known or (keys["name"], separator) != ("default", "/"):
            raise ValueError(f"{folder} has chunks of another kind")
        rows = metadata["chunk_grid"]["configuration"]["chunk_shape"][0]
        dtype = np.dtype(metadata["data_type"])
        return cls(folder, tuple(metadata["shape"]), rows, dtype, codecs)

    def create(self) -> None:
        """Write the metadata; there are no chunks yet."""
        plain = {"name": "bytes"}
        first = LITTLE if self.dtype.itemsize > 1 else plain
        chunk_shape = [self.rows, *self.shape[1:]]
        metadata = {
            "shape": list(self.shape),
            "data_type": self.dtype.name,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk_shape}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": np.zeros((), self.dtype).item(),
            "codecs": [first, *(CODECS[name] for name in self.codecs)],
            "attributes": {},
            "zarr_format": 3,
            "node_type": "array",
            "storage_transformers": [],
        }
        write_json(self.folder / METADATA, metadata)

    @property
    def chunks(self) -> int:
        """The number of chunks."""
        return -(-self.shape[0] // self.rows)

    def file(self, chunk: int) -> Path:
        """Where a chunk is."""
        return self.folder.joinpath("c", str(chunk), *("0" for _ in self.shape[1:]))

    def write(self, chunk: int, values: np.ndarray) -> None:
        """Write a chunk at once; the last one may have fewer rows, and is filled up with zeros."""
        full = np.zeros((self.rows, *self.shape[1:]), self.dtype.newbyteorder("<"))
        full[: len(values)] = values
        content = full.tobytes()
        if "zstd" in self.codecs:
            content = _zstd().encode(content)
        if "crc32c" in self.codecs:
            content += _crc32c(content).to_bytes(CHECKSUM, "little")
        write_at_once(self.file(chunk), content)

    def read(self, chunk: int) -> np.ndarray:
        """The rows of a chunk.

        Raises:
            ValueError: it is damaged. Other errors where it is missing, or cannot be decompressed.
        """
        content = self.file(chunk).read_bytes()
        if "crc32c" in self.codecs:
            content, checksum = content[:-CHECKSUM], content[-CHECKSUM:]
            if _crc32c(content).to_bytes(CHECKSUM, "little") != checksum:
                raise ValueError("its checksum is wrong")
        if "zstd" in self.codecs:
            content = _zstd().decode(content)
        little = np.frombuffer(content, self.dtype.newbyteorder("<"))
        full = little.astype(self.dtype, copy=False).reshape(self.rows, *self.shape[1:])
        return full[: self.shape[0] - chunk * self.rows]


def write_json(file: Path, content: dict[str, Any]) -> None:
    """Write metadata."""
    write_at_once(file, json.dumps(content, indent=2).encode())


def write_at_once(file: Path, content: bytes) -> None:
    """Write a file of which nothing is seen until it is complete."""
    part = file.with_name(f".{file.name}.{secrets.token_hex(8)}.partial")
    try:
        try:
            part.write_bytes(content)
        except FileNotFoundError:
            file.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(content)
        os.replace(part, file)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _zstd() -> Any:
    from numcodecs.zstd import Zstd

    return Zstd(level=0)


def _crc32c(content: bytes) -> int:
    import google_crc32c

    return google_crc32c.value(content)
