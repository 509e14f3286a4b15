"""Stores that are resumed or repaired, and those of another sweep, which are not touched."""

import shutil

import jax
import numpy as np
import pytest
from store_helpers import GRID, HEADER, RECORDS, numbers, reduced

import dipoletop as dt
from dipoletop._maps.store.tiles import Tiles
from dipoletop._maps.sweep_plan import Plan
from stored_files import files, flip


def test_a_sweep_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """Killed half-way, with a torn tile: the same bytes as a run in one go."""
    monkeypatch.setattr("dipoletop._maps.tiling.TILE", 128)
    grid = dt.Grid(w3=np.linspace(0.0, 0.45, 20), phi=np.linspace(0.0, 3.0, 50))
    whole = numbers(dt.sweep(reduced, grid, store=tmp_path / "whole.zarr"))
    place = tmp_path / "again.zarr"
    shutil.copytree(tmp_path / "whole.zarr", place)
    for tile in (0, 3, 7):
        (place / RECORDS / "c" / str(tile) / "0").unlink()
    (place / "omega_inf" / "c" / "3" / "0").unlink()
    (place / "outcome" / "c" / "7" / "0").write_bytes(b"torn")
    with pytest.raises(dt.StoreMismatch, match="is missing 3 of 10 tiles; run the sweep again"):
        dt.Basin.load(place)

    made = []
    write = Tiles.write
    monkeypatch.setattr(Tiles, "write", lambda *a: (made.append(a[1]), write(*a)))
    again = dt.sweep(reduced, grid, store=place)
    assert sorted(made) == [0, 3, 7]
    assert numbers(again) == whole
    assert files(place) == files(tmp_path / "whole.zarr")
    assert numbers(dt.sweep(reduced, grid, store=place)) == whole
    assert sorted(made) == [0, 3, 7]


@pytest.mark.parametrize("engine", [pytest.param("jax", marks=pytest.mark.slow), "native"])
def test_tiles_that_share_a_queue_are_stored_as_ever(tmp_path, monkeypatch, engine):
    """As on an accelerator, which takes several at once: the same bytes, whatever it has done."""
    grid = dt.Grid(w3=np.linspace(0.0, 0.45, 20), phi=np.linspace(0.0, 3.0, 50))
    settings = {"engine": engine, "confirm": 1e-6, "devices": jax.devices()[:1]}
    dt.sweep(reduced, grid, store=tmp_path / "one.zarr", **settings)
    tiles = []
    compute = Plan.compute
    monkeypatch.setattr(Plan, "compute", lambda *a: (tiles.append(len(a[1])), compute(*a))[1])
    monkeypatch.setattr("dipoletop._maps.tiling.TILE", 128)
    monkeypatch.setattr("dipoletop._maps.sweep_plan.TILE", 128)
    monkeypatch.setattr("dipoletop._maps.sweep_plan.largest_tile", lambda devices: 400)
    dt.sweep(reduced, grid, store=tmp_path / "several.zarr", **settings)
    assert max(tiles) == 3
    assert sum(tiles) == 10
    assert files(tmp_path / "several.zarr") == files(tmp_path / "one.zarr")


@pytest.mark.parametrize(
    "victim",
    ["omega_inf/c/1/0", f"{RECORDS}/c/0/0", "phi/c/0", "time/zarr.json", "zarr.json", HEADER],
)
@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(lambda file: file.unlink(), marks=pytest.mark.slow),
        lambda file: flip(file, 200),
    ],
)
def test_a_sweep_finds_damage_and_repairs_it_to_the_same_bytes(good, copy, victim, harm):
    harm(copy / victim)
    lacking = victim.startswith(RECORDS) and not (copy / victim).exists()
    if not lacking:
        with pytest.raises(dt.StoreDamaged, match=r"damaged, (tile|metadata)"):
            dt.sweep(reduced, GRID, store=copy)
    again = dt.sweep(reduced, GRID, store=copy, repair=not lacking)
    assert numbers(again) == numbers(dt.Basin.load(good))
    assert files(copy) == files(good)


def test_a_sweep_on_another_kind_of_processor_is_refused(copy, monkeypatch):
    """Its last bits may differ."""
    monkeypatch.setattr("dipoletop._maps.sweep_plan.kind_of", lambda device: "abacus 01234567")
    with pytest.raises(dt.StoreMismatch, match=r"processor is .* there and abacus 01234567 here"):
        dt.sweep(reduced, GRID, store=copy)


def test_metadata_are_not_repaired_over_the_tiles_of_another_sweep(copy):
    flip(copy / HEADER, 4000)
    before = files(copy)
    with pytest.raises(
        dt.StoreMismatch, match="`store` must be new or hold this very sweep, but th"
    ):
        dt.sweep(lambda w3, phi: reduced(w3, phi, -0.3), GRID, store=copy, repair=True)
    assert files(copy) == before


def test_what_no_trace_shows_is_seen_in_the_starts_of_a_tile(tmp_path):
    """A number that the problem reads at run time."""
    size = [0.2]

    def read(w3):
        return np.full_like(w3, size[0])

    def problem(w3, phi):
        shape = jax.ShapeDtypeStruct(w3.shape, w3.dtype)
        w_perp = jax.pure_callback(read, shape, w3, vmap_method="expand_dims")
        return dt.TransverseReduced(-0.2), dt.cylindrical(w_perp, w3, phi)

    dt.sweep(problem, GRID, store=tmp_path / "c.zarr")
    dt.sweep(problem, GRID, store=tmp_path / "c.zarr")
    size[0] = 0.21
    with pytest.raises(
        dt.StoreMismatch, match=r"in tile . of .*c.zarr the equations or starts are"
    ):
        dt.sweep(problem, GRID, store=tmp_path / "c.zarr")
