"""Stores: whose they are, what is wrong with them, and how they are gone on with and repaired."""

import json
import os
import shutil
import subprocess
import sys
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import zarr

import dipoletop as dt
from dipoletop import store as disk
from dipoletop import sweep as sweeping
from dipoletop._problems import builder

SIZE = 12, 18  # two tiles, the second not full
GRID = dt.Grid(w3=np.linspace(0.0, 0.45, SIZE[0]), phi=np.linspace(0.0, 3.0, SIZE[1]))
KINDS = {
    "outcome": "int8",
    "omega_inf": "float64",
    "time": "float64",
    "steps": "int32",
    "certified": "bool",
    "stop": "int8",
}


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A finished store; copy it before it is harmed."""
    place = tmp_path_factory.mktemp("stores") / "good.zarr"
    dt.sweep(reduced, GRID, store=place)
    return place


@pytest.fixture
def copy(good, tmp_path):
    return shutil.copytree(good, tmp_path / "copy.zarr")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def numbers(basin):
    """Every bit of a basin."""
    arrays = {name: basin.column(name) for name in basin.columns} | basin.coords
    return {name: (x.dtype, x.shape, x.tobytes()) for name, x in arrays.items()} | basin.attrs


def flip(file, bit):
    data = bytearray(file.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    file.write_bytes(data)


def test_what_is_stored_is_what_single_runs_find_to_the_last_bit(good):
    basin, starts = dt.Basin.load(good), GRID.points(np.arange(np.prod(SIZE)))
    omegas = jax.vmap(lambda w3, phi: reduced(w3, phi)[1])(starts["w3"], starts["phi"])
    found = dt.classify_many(dt.TransverseReduced(-0.2), omegas)
    for name, kind in KINDS.items():
        assert basin.column(name).dtype == kind
        expected = np.asarray(getattr(found, name)).astype(kind)
        assert basin.column(name).ravel().tobytes() == expected.tobytes()


class PowerCutError(Exception):
    """In the middle of writing."""


# Damage


def victims(good, kind):
    """The files of a store that hold columns, axes, records, or metadata."""
    every = sorted(p.relative_to(good) for p in good.rglob("*") if p.is_file())
    sorts = {"columns": [], "axes": [], "records": [], "metadata": []}
    for path in every:
        sort = "columns"
        if path.name == "zarr.json":
            sort = "metadata"
        elif path.parts[0].startswith("axis_"):
            sort = "axes"
        elif path.parts[0] == "done":
            sort = "records"
        sorts[sort].append(path)
    assert all(sorts.values())
    return sorts[kind]


def damages(good):
    """364 of them: (file, what happens to it)."""
    generator = np.random.default_rng(22)
    found = []
    for kind, count in (("columns", 120), ("axes", 60), ("records", 50), ("metadata", 74)):
        for path in generator.choice(victims(good, kind), count):
            bit = int(generator.integers(8 * (good / path).stat().st_size))
            found.append((path, lambda file, bit=bit: flip(file, bit)))
    every = [p for kind in ("columns", "axes", "records", "metadata") for p in victims(good, kind)]
    for path in generator.choice(every, 364 - len(found) - len(every)):
        rest = (good / path).read_bytes()
        rest = rest[: int(generator.integers(len(rest)))]
        found.append((path, lambda file, rest=rest: file.write_bytes(rest)))
    found += [(path, lambda file: file.unlink()) for path in every]
    return found


def test_none_of_364_damages_gives_a_wrong_number(good, copy):
    right, refused = numbers(dt.Basin.load(good)), 0
    every = damages(good)
    assert len(every) == 364
    for path, harm in every:
        before = (copy / path).read_bytes()
        harm(copy / path)
        try:
            found = numbers(dt.Basin.load(copy))
        except ValueError as error:
            refused += 1
            sentence = str(error)
            assert str(copy) in sentence
            assert sentence.count("\n") == 0
            if isinstance(error, dt.StoreDamaged):
                assert error.path == copy
                part = f"tile {error.tiles[0]}" if error.tiles else "metadata"
                assert part in sentence
            else:  # a record that is gone is that of a tile not yet computed
                assert "lacks 1 of 2 tiles" in sentence
        else:
            assert found == right, (path, harm)
        (copy / path).write_bytes(before)
    # White space in the header and the like may change.
    assert refused > 350
    assert numbers(dt.Basin.load(copy)) == right


@pytest.mark.parametrize(
    "victim", ["omega_inf/c/1", "done/c/0/0", "axis_phi/c/0", "time/zarr.json", "zarr.json"]
)
@pytest.mark.parametrize("harm", [lambda file: file.unlink(), lambda file: flip(file, 200)])
def test_a_sweep_finds_damage_and_repairs_it_to_the_same_bytes(good, copy, victim, harm):
    harm(copy / victim)
    lacking = victim.startswith("done") and not (copy / victim).exists()
    if not lacking:
        with pytest.raises(dt.StoreDamaged, match="tile 0|tile 1|metadata"):
            dt.sweep(reduced, GRID, store=copy)
    again = dt.sweep(reduced, GRID, store=copy, repair=not lacking)
    assert numbers(again) == numbers(dt.Basin.load(good))
    assert files(copy) == files(good)


def test_a_chunk_of_another_tile_or_column_is_a_damage(good, copy):
    for source, target in (("steps/c/0", "steps/c/1"), ("certified/c/0", "outcome/c/0")):
        before = (copy / target).read_bytes()
        shutil.copy(good / source, copy / target)
        with pytest.raises(dt.StoreDamaged, match=f"tile {target[-1]}: its {target[:5]}"):
            dt.Basin.load(copy)
        (copy / target).write_bytes(before)
    shutil.copy(good / "done/c/0/0", copy / "done/c/1/0")
    with pytest.raises(dt.StoreDamaged, match="tile 1: its record is not what was written"):
        dt.Basin.load(copy)


def test_metadata_are_not_repaired_over_the_tiles_of_another_sweep(copy):
    flip(copy / "zarr.json", 4000)
    before = files(copy)
    with pytest.raises(ValueError, match="`store` must be new or hold this very sweep, but the me"):
        dt.sweep(lambda w3, phi: reduced(w3, phi, -0.3), GRID, store=copy, repair=True)
    assert files(copy) == before


def test_columns_of_all_zeros_are_on_disk_too(tmp_path):
    """STOP at once: ω∞ = 0 and no steps, which is no reason to write nothing."""
    place = tmp_path / "still.zarr"
    still = dt.sweep(reduced, dt.Grid(w3=0.3, phi=np.pi / 2), store=place)
    assert still.omega_inf[0, 0] == 0
    assert (place / "omega_inf" / "c" / "0").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="no such folders")
def test_a_lazy_column_knows_its_place_and_its_bits(tmp_path, monkeypatch):
    """Kept in a store whose path was relative; the process moves, then the data do."""
    monkeypatch.chdir(tmp_path)
    basin = dt.sweep(reduced, GRID, store="here.zarr")
    loaded = dt.Basin.load(b"here.zarr")
    right = dt.sweep(reduced, GRID).omega_inf
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for one in (basin, loaded):
        assert np.array_equal(one.omega_inf, right, equal_nan=True)
    flip(tmp_path / "here.zarr" / "outcome" / "c" / "1", 77)
    with pytest.raises(dt.StoreDamaged, match=r"here.zarr is damaged, tile 1: its outcome"):
        _ = loaded.outcome
    shutil.rmtree(tmp_path / "here.zarr")
    for one in (basin, loaded):
        with pytest.raises(dt.StoreDamaged, match="tile 0: its omega_inf is missing"):
            _ = one.omega_inf


def test_a_crash_between_any_two_writes_leaves_nothing_torn(good, tmp_path, monkeypatch):
    """The sweep goes on without a complaint, to the same bytes."""
    write, left = zarr.storage.LocalStore.set, [0]

    async def failing(self, key, value):
        if "/c/" in key and not key.startswith("axis_"):
            if left[0] == 0:
                raise PowerCutError
            left[0] -= 1
        await write(self, key, value)

    place = tmp_path / "torn.zarr"
    chunks = len(victims(good, "columns")) + len(victims(good, "records"))
    assert chunks == 2 * (len(KINDS) + 1)
    for count in range(1, chunks, 2):  # 1, 3, …: after every column, in one tile or the other
        with monkeypatch.context() as patch:
            patch.setattr(zarr.storage.LocalStore, "set", failing)
            left[0] = count
            with pytest.raises(PowerCutError):
                dt.sweep(reduced, GRID, store=place)
        dt.sweep(reduced, GRID, store=place)
        assert files(place) == files(good)
        shutil.rmtree(place)
