"""Whole basins on disk: saved, loaded, and those of another format, which are refused."""

import numpy as np
import pytest
from store_helpers import GRID, numbers, reduced, rewrite

import dipoletop as dt
from stored_files import files


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
    (tmp_path / "text").write_text("hello")
    (tmp_path / "empty").mkdir()
    for name, is_not in {"none.zarr": "does not ex", "text": "", "empty": ""}.items():
        said = f"`path` must be a folder with a basin, but .*{name} {is_not}"
        with pytest.raises(dt.StoreMismatch, match=said):
            dt.Basin.load(tmp_path / name)


@pytest.mark.parametrize("version", [2, 4])
def test_another_format_is_refused_and_untouched(copy, version):
    rewrite(copy, format=f"dipoletop basin, version {version}")
    before = files(copy)
    said = (
        f"must be a dipoletop basin, version 3, but {copy} is a dipoletop basin, version {version}."
    )
    with pytest.raises(dt.StoreMismatch) as caught:
        dt.Basin.load(copy)
    assert str(caught.value) == f"Argument `path` {said}"
    for repair in (False, True):
        with pytest.raises(dt.StoreMismatch) as caught:
            dt.sweep(reduced, GRID, store=copy, repair=repair)
        assert str(caught.value) == f"Argument `store` {said}"
    assert files(copy) == before
