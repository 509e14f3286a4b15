"""Stores that another program has changed, or made: nothing outside them is written or deleted."""

import os
import shutil
import signal

import numpy as np
import pytest
from numcodecs.zstd import Zstd
from store_helpers import GRID, header_of, reduced, rewrite

import dipoletop as dt
from dipoletop._maps.store.arrays import _crc32c
from dipoletop._maps.store.tiles import open_store
from stored_files import files


def sweep_again(place, **options):
    return dt.sweep(reduced, GRID, store=place, **options)


def test_a_store_that_is_moved_away_is_not_begun_again(copy):
    tiles = open_store(copy)
    columns = {name: tiles.read(name, 0) for name in tiles.names}
    moved = copy.rename(copy.with_name("moved.zarr"))
    with pytest.raises(dt.StoreMismatch, match=r"stay in its place, but .* renamed or replaced"):
        tiles.write(0, columns, bytes(16))
    assert not copy.exists()
    other = copy.with_name("other.zarr")
    dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=other)
    other.rename(copy)
    with pytest.raises(dt.StoreMismatch, match="stay in its place"):
        tiles.write(0, columns, bytes(16))
    moved.rename(copy.with_name("again.zarr"))


@pytest.mark.parametrize("linked", ["dipoletop-tiles", "dipoletop-tiles/partial"])
def test_nothing_behind_a_link_is_deleted(copy, tmp_path, linked):
    outside = tmp_path / "outside"
    if (copy / linked).exists():
        shutil.move(copy / linked, outside)
    else:
        outside.mkdir()
    (outside / "partial").mkdir(exist_ok=True)
    (outside / "partial" / "precious").write_text("kept")
    (copy / linked).symlink_to(outside)
    before = files(outside)
    with pytest.raises(dt.StoreDamaged, match="is a link"):
        sweep_again(copy)
    assert files(outside) == before


def test_nothing_behind_a_link_is_written(copy, tmp_path):
    chunks = copy / "outcome" / "c"
    outside = shutil.copytree(chunks, tmp_path / "outside")
    shutil.rmtree(chunks)
    next(path for path in outside.rglob("*") if path.is_file()).write_bytes(b"damaged")
    chunks.symlink_to(outside)
    before = files(outside)
    with pytest.raises(ValueError, match="is a link"):
        sweep_again(copy, repair=True)
    assert files(outside) == before


@pytest.mark.parametrize("name", ["../outside", "/etc", "..", "a\\b", "", "red\x1b[31m"])
def test_names_do_not_lead_out_of_a_store(copy, name):
    rewrite(copy, columns=[name])
    with pytest.raises(dt.StoreDamaged, match="a column or an axis with the name") as caught:
        dt.Basin.load(copy)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("shape", [[10**6, 10**9], [-3, 4], [2.5, 3], ["a", 3], []])
def test_sizes_that_no_sweep_has_are_refused_at_once(copy, shape):
    rewrite(copy, shape=shape)
    with pytest.raises(dt.StoreDamaged, match=r"its shape is|its header cannot be read"):
        dt.Basin.load(copy)


def test_a_chunk_that_claims_another_size_is_not_unpacked(copy):
    """60 kB of packed zeros would fill 2 GB of memory."""
    chunk = next(path for path in (copy / "outcome" / "c").rglob("*") if path.is_file())
    content = Zstd().encode(np.zeros(10**7, np.uint8))
    chunk.write_bytes(content + _crc32c(content).to_bytes(4, "little"))
    with pytest.raises(dt.StoreDamaged, match="its length is wrong"):
        dt.Basin.load(copy)


def test_a_pipe_is_not_waited_for(copy):
    header = copy / "dipoletop-tiles" / "zarr.json"
    header.unlink()
    os.mkfifo(header)
    signal.alarm(20)
    with pytest.raises(dt.StoreDamaged, match="no ordinary file"):
        dt.Basin.load(copy)
    signal.alarm(0)


def test_a_terminal_is_not_controlled_by_a_store(copy):
    rewrite(copy, attrs=header_of(copy)["attrs"] | {"level": "\x1b[2Jnothing"})
    shown = repr(dt.Basin.load(copy, unfinished=True))
    assert "\x1b" not in shown
    assert "\\x1b[2Jnothing" in shown
