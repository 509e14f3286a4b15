"""Arrays on disk: the bytes of the library zarr, which reads them, and whose bytes are read."""

import os

import numpy as np
import pytest
import zarr
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

from dipoletop._maps.store.arrays import StoredArray, write_at_once
from dipoletop._maps.tiling import Tiling
from stored_files import files

PACKING = [ZstdCodec(level=0), Crc32cCodec()]
RNG = np.random.default_rng(0)
ARRAYS = {
    "int8": RNG.integers(-1, 3, 300).astype("int8"),
    "int32": RNG.integers(0, 2**30, 300).astype("int32"),
    "bool": RNG.random(300) > 0.5,
    "float64": RNG.normal(size=(300, 3)),
    "float32": np.zeros(300, "float32"),
}


def by_zarr(folder, values, **codecs):
    with zarr.config.set({"array.write_empty_chunks": True}):
        zarr.create_array(folder, data=values, chunks=(128, *values.shape[1:]), **codecs)


@pytest.fixture(params=ARRAYS)
def values(request):
    return ARRAYS[request.param]


@pytest.mark.parametrize("packed", [True, False])
def test_the_bytes_are_those_of_zarr(tmp_path, values, packed):
    chunk = 128, *values.shape[1:]
    array = StoredArray(tmp_path / "own", values.shape, chunk, values.dtype, packed)
    (tmp_path / "own").mkdir()
    array.create()
    array.write_all(values)
    by_zarr(tmp_path / "zarr", values, compressors=PACKING if packed else None)
    own, other = files(tmp_path / "own"), files(tmp_path / "zarr")
    chunks = {name for name in other if name.startswith("c/")}
    assert len(chunks) == 3
    assert {name: own[name] for name in chunks} == {name: other[name] for name in chunks}
    assert own.keys() == other.keys()
    read = zarr.open_array(tmp_path / "own", mode="r")
    assert read.dtype == values.dtype
    np.testing.assert_array_equal(read[...], values)


def test_what_zarr_has_written_is_read(tmp_path, values):
    by_zarr(tmp_path / "a", values, compressors=PACKING)
    array = StoredArray.open(tmp_path / "a")
    found = np.concatenate([array.read(chunk) for chunk in range(array.tiling.count)])
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found.reshape(values.shape), values)


@pytest.mark.parametrize(
    ("shape", "most"), [((7, 5, 6), 60), ((7, 5, 6), 12), ((7, 5, 6), 4), ((9, 4), 1000), ((), 8)]
)
def test_chunks_of_several_axes_are_where_zarr_looks_for_them(tmp_path, shape, most):
    """Read while one of them is not written yet: its numbers are the fill value."""
    values, tiling = RNG.normal(size=shape), Tiling.of(shape, most)
    array = StoredArray(tmp_path, shape, tiling.chunk, values.dtype, fill=np.nan)
    array.create()
    array.write_all(values)
    read = zarr.open_array(tmp_path, mode="r")
    np.testing.assert_array_equal(read[...], values)
    last = tiling.count - 1
    array.file(last).unlink()
    values[tiling.box(last)] = np.nan
    np.testing.assert_array_equal(zarr.open_array(tmp_path, mode="r")[...], values)


@pytest.mark.parametrize(
    "settings",
    [
        {"compressors": zarr.codecs.GzipCodec()},
        {"compressors": ZstdCodec(level=0)},
        {"compressors": PACKING, "serializer": BytesCodec(endian="big")},
        {"compressors": PACKING, "chunk_key_encoding": {"name": "v2", "separator": "/"}},
    ],
)
def test_arrays_of_another_kind_are_refused(tmp_path, settings):
    by_zarr(tmp_path / "a", ARRAYS["int32"], **settings)
    with pytest.raises(ValueError, match="chunks of another kind"):
        StoredArray.open(tmp_path / "a")


@pytest.mark.parametrize("place", [0, 40, -1])
def test_one_bit_is_seen(tmp_path, place):
    array = StoredArray(tmp_path, (128,), (128,), np.dtype(float))
    array.write(0, RNG.normal(size=128))
    content = bytearray(array.file(0).read_bytes())
    content[place] ^= 4
    array.file(0).write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        array.read(0)


def test_a_file_whose_part_is_removed_by_another_machine_is_written_again(tmp_path, monkeypatch):
    """As where that machine does not see our locks, and takes the part for a dead process's."""
    replace, removed = os.replace, []

    def after_removal(part, file):
        if not removed:
            removed.append(part)
            part.unlink()
            part.parent.rmdir()
        replace(part, file)

    monkeypatch.setattr(os, "replace", after_removal)
    write_at_once(tmp_path / "c/0", b"content", tmp_path / "partial")
    assert removed
    assert (tmp_path / "c/0").read_bytes() == b"content"
    assert list((tmp_path / "partial").iterdir()) == []
