"""Whole basins on disk: saved, loaded, and those that older versions wrote."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr
from store_helpers import GRID, KINDS, files, flip, numbers, reduced

import dipoletop as dt


def test_save_and_load(tmp_path):
    basin = dt.sweep(reduced, GRID)
    basin.save(tmp_path / "map.zarr")
    loaded = dt.Basin.load(tmp_path / "map.zarr")
    assert numbers(loaded) == numbers(basin)
    for name, column in basin.columns.items():
        np.testing.assert_array_equal(np.asarray(loaded.columns[name]), column, strict=True)
    with pytest.raises(dt.StoreMismatch, match="`path` must not exist yet"):
        basin.save(tmp_path / "map.zarr")


def test_what_is_no_basin_is_refused(tmp_path):
    with pytest.raises(
        dt.StoreMismatch, match=r"`path` must be a folder with a basin, but .* not ex"
    ):
        dt.Basin.load(tmp_path / "none.zarr")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(dt.StoreMismatch, match="`path` must be a folder with a basin"):
        dt.Basin.load(tmp_path / "text")
    (tmp_path / "empty").mkdir()
    with pytest.raises(dt.StoreMismatch, match="`path` must be a folder with a basin"):
        dt.Basin.load(tmp_path / "empty")


@pytest.fixture
def version_1(good, tmp_path):
    """What `dipoletop basin, version 1` was: flags, and no checksum of anything."""
    place, basin = tmp_path / "old.zarr", dt.Basin.load(good)
    group = zarr.open_group(place, mode="w")
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, kind in KINDS.items():
            array = group.create_array(name, shape=(216,), chunks=(128,), dtype=kind)
            array[:] = basin.column(name).ravel()
        for name, values in basin.coords.items():
            group.create_array(f"axis_{name}", data=values, chunks=values.shape)
        group.create_array("done", shape=(2,), chunks=(1,), dtype="uint8")[:] = 1
    header = {"format": "dipoletop basin, version 1", "axes": ["w3", "phi"], "tile": 128}
    header |= {"dims": ["w3", "phi"], "shape": [12, 18], "columns": list(KINDS)}
    group.attrs.update({**header, "attrs": basin.attrs, "fingerprint": "f00"})
    return place


def test_a_store_of_version_1_is_read_but_not_gone_on_with(good, version_1):
    before = files(version_1)
    old = dt.Basin.load(version_1)
    right = numbers(dt.Basin.load(good))
    assert numbers(old) == {name: right[name] for name in numbers(old)}
    message = "must be new or a dipoletop basin, version 3, to go on with it, but .* version 1"
    for repair in (False, True):
        with pytest.raises(dt.StoreMismatch, match=message):
            dt.sweep(reduced, GRID, store=version_1, repair=repair)
    assert files(version_1) == before
    message = r"`name` must be a column of this basin \(outcome, .*\), but is 'omega_inf_error'"
    with pytest.raises(ValueError, match=message):
        old.column("omega_inf_error")


@pytest.mark.parametrize("victim", ["stop/c/1", "axis_phi/c/0", "time/zarr.json", "zarr.json"])
def test_what_is_missing_in_a_store_of_version_1_is_damage(version_1, victim):
    old = dt.Basin.load(version_1)
    (version_1 / victim).unlink()
    with pytest.raises(dt.StoreDamaged, match="tile 1" if victim == "stop/c/1" else "metadata"):
        dt.Basin.load(version_1)
    if victim == "stop/c/1":
        with pytest.raises(dt.StoreDamaged, match="tile 1: its stop is missing"):
            _ = old.stop


@pytest.fixture
def version_2(tmp_path):
    """A store that version 0.1.0 wrote while `dipoletop basin, version 2` was the format."""
    place = tmp_path / "version_2.zarr"
    shutil.unpack_archive(Path(__file__).with_name("version_2.zip"), place)
    return place


def test_a_store_of_version_2_is_read_but_not_gone_on_with(version_2):
    before, old, new = files(version_2), dt.Basin.load(version_2), dt.sweep(reduced, GRID)
    assert old.attrs["max_steps"] == 50_000
    assert old.coords.keys() == new.coords.keys()
    for name in new.columns:
        assert old.column(name).dtype == new.column(name).dtype
        np.testing.assert_allclose(old.column(name), new.column(name), rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(old.isel(w3=3).time, old.time[3])
    message = "must be new or a dipoletop basin, version 3, to go on with it, but .* version 2"
    for repair in (False, True):
        with pytest.raises(dt.StoreMismatch, match=message):
            dt.sweep(reduced, GRID, store=version_2, repair=repair)
    assert files(version_2) == before


@pytest.mark.parametrize("victim", ["stop/c/1", "axis_phi/c/0", "done/c/0/0", "zarr.json"])
def test_a_flipped_bit_in_a_store_of_version_2_is_damage(version_2, victim):
    flip(version_2 / victim, 100)
    with pytest.raises(dt.StoreDamaged, match=r"tile [01]|metadata"):
        dt.Basin.load(version_2)
