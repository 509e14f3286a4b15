"""Paths of stores: long names and bytes are taken, impossible ones are refused."""

import os

import pytest
from store_helpers import numbers, reduced

import dipoletop as dt
from stored_files import files


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("link", "be a path to a folder, but .*link is a link to nothing"),
        ("n" * 300, "be a path where a folder can be made, but .* is not: File name too long"),
        ("nul\0", "be a path where a folder can be made, but .* is not: .*null"),
        ("file/store", "be a path where a folder can be made, but .* is not: .*(directory|exists)"),
        ("file", "be a folder with a basin, but .*file cannot be read as one"),
    ],
)
def test_a_path_that_cannot_be_is_refused(tmp_path, monkeypatch, path, said):
    monkeypatch.chdir(tmp_path)
    os.symlink("nowhere", "link")
    (tmp_path / "file").write_text("hello")
    before = files(tmp_path)
    with pytest.raises(dt.StoreMismatch, match=f"`store` must {said}"):
        dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=path)
    assert files(tmp_path) == before


def test_a_home_and_a_file_url_are_paths_and_other_urls_are_not(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    grid = dt.Grid(w3=0.2, phi=0.1)
    dt.sweep(reduced, grid, store="~/one.zarr")
    dt.sweep(reduced, grid, store=f"file://{tmp_path}/t%77o.zarr")
    assert {path.name for path in tmp_path.iterdir()} == {"one.zarr", "two.zarr"}
    for url in ("s3://bucket/x.zarr", "file://elsewhere/x.zarr"):
        with pytest.raises(ValueError, match="`store` must be a path, or a URL of a file of this"):
            dt.sweep(reduced, grid, store=url)


@pytest.mark.parametrize("path", ["n" * 255, b"bytes.zarr"])
def test_long_names_and_bytes_are_paths(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    basin = dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=path)
    assert numbers(dt.Basin.load(path)) == numbers(basin)
    assert len(os.listdir(tmp_path)) == 1
