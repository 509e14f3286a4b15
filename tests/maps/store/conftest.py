"""A finished store, and a copy to be harmed."""

import shutil

import pytest
from store_helpers import GRID, reduced

import dipoletop as dt


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A finished store; copy it before it is harmed."""
    place = tmp_path_factory.mktemp("stores") / "good.zarr"
    dt.sweep(reduced, GRID, store=place)
    return place


@pytest.fixture
def copy(good, tmp_path):
    return shutil.copytree(good, tmp_path / "copy.zarr")
