"""Tiles on disk: what is wrong with damaged ones, and that a crash tears none."""

import shutil
import sys

import jax
import numpy as np
import pytest
import zarr
from store_helpers import GRID, HEADER, KINDS, RECORDS, SIZE, contents, numbers, reduced, victims

import dipoletop as dt
from dipoletop._maps.store import arrays
from stored_files import files, flip


def test_what_is_stored_is_what_single_runs_find_to_the_last_bit(good):
    basin, starts = dt.Basin.load(good), GRID.points(np.arange(np.prod(SIZE)))
    omegas = jax.vmap(lambda w3, phi: reduced(w3, phi)[1])(starts["w3"], starts["phi"])
    found = dt.classify_many(dt.TransverseReduced(-0.2), omegas)
    for name, kind in KINDS.items():
        assert basin.column(name).dtype == kind
        expected = np.asarray(getattr(found, name)).astype(kind)
        assert basin.column(name).ravel().tobytes() == expected.tobytes()


def damages(good):
    """364 of them: (file, what happens to it)."""
    generator = np.random.default_rng(22)
    found = []
    for kind, count in (("columns", 120), ("axes", 60), ("records", 40), ("metadata", 44)):
        for path in generator.choice(victims(good, kind), count):
            bit = int(generator.integers(8 * (good / path).stat().st_size))
            found.append((path, lambda file, bit=bit: flip(file, bit)))
    header = good / HEADER
    version = header.read_bytes().index(b'"version_jax"') + 17  # which identifies no sweep
    bits = [8 * version, *generator.integers(8 * header.stat().st_size, size=39).tolist()]
    found += [(header.relative_to(good), lambda file, bit=bit: flip(file, bit)) for bit in bits]
    every = contents(good)
    for path in generator.choice(every, 364 - len(found) - len(every)):
        rest = (good / path).read_bytes()
        rest = rest[: int(generator.integers(len(rest)))]
        found.append((path, lambda file, rest=rest: file.write_bytes(rest)))
    found += [(path, lambda file: file.unlink()) for path in every]
    return found


def test_none_of_364_damages_gives_a_wrong_number(good, copy):
    right, refused = numbers(dt.Basin.load(good)), []
    every = damages(good)
    assert len(every) == 364
    for path, harm in every:
        before = (copy / path).read_bytes()
        harm(copy / path)
        try:
            found = numbers(dt.Basin.load(copy))
        except ValueError as error:
            found, refused = right, [*refused, error]
        assert found == right, path
        (copy / path).write_bytes(before)
    assert len(refused) > 350  # white space in a header and the like may change
    for error in refused:
        sentence = str(error)
        assert str(copy) in sentence
        assert "\n" not in sentence
        if not isinstance(error, dt.StoreDamaged):  # as one without a record: not computed yet
            assert "is missing 1 of 2 tiles" in sentence
        else:
            assert error.path == copy
            assert f"tile {error.tiles[0]}:" if error.tiles else "metadata:" in sentence
    assert numbers(dt.Basin.load(copy)) == right


def test_a_chunk_of_another_tile_or_column_is_a_damage(good, copy):
    for source, target in (("steps/c/0/0", "steps/c/1/0"), ("certified/c/0/0", "outcome/c/0/0")):
        before = (copy / target).read_bytes()
        shutil.copy(good / source, copy / target)
        with pytest.raises(dt.StoreDamaged, match=f"tile {target[-3]}: its {target[:5]}"):
            dt.Basin.load(copy)
        (copy / target).write_bytes(before)
    shutil.copy(good / RECORDS / "c/0/0", copy / RECORDS / "c/1/0")
    with pytest.raises(dt.StoreDamaged, match="tile 1: its record is not what was written"):
        dt.Basin.load(copy)
    zarr.open_group(copy, mode="r+")["phi"][3] = 0.7
    with pytest.raises(dt.StoreDamaged, match="metadata: the values of phi are not what was writ"):
        dt.Basin.load(copy)


def test_what_zarr_reads_past_is_damage_too(copy):
    """The value of chunks that are missing, of which there are none."""
    file = copy / "outcome" / "zarr.json"
    file.write_text(file.read_text().replace('"fill_value": -128', '"fill_value": 1'))
    with pytest.raises(dt.StoreDamaged, match="metadata: the metadata of outcome are not as writ"):
        dt.Basin.load(copy)


def test_columns_of_all_zeros_are_on_disk_too(tmp_path):
    """STOP at once: ω∞ = 0 and no steps, which is no reason to write nothing."""
    place = tmp_path / "still.zarr"
    still = dt.sweep(reduced, dt.Grid(w3=0.3, phi=np.pi / 2), store=place)
    assert still.omega_inf[0, 0] == 0
    assert (place / "omega_inf" / "c" / "0" / "0").is_file()


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
    flip(tmp_path / "here.zarr" / "outcome" / "c" / "1" / "0", 77)
    with pytest.raises(dt.StoreDamaged, match=r"here.zarr is damaged, tile 1: its outcome"):
        _ = loaded.outcome
    shutil.rmtree(tmp_path / "here.zarr")
    for one in (basin, loaded):
        with pytest.raises(dt.StoreDamaged, match="tile 0: its omega_inf is missing"):
            _ = one.omega_inf


class PowerCutError(Exception):
    """In the middle of writing."""


def test_a_crash_between_any_two_writes_leaves_nothing_torn(good, tmp_path, monkeypatch):
    """The sweep goes on without a complaint, to the same bytes."""
    write, left = arrays.write_at_once, [0]

    def failing(file, content, staging=None):
        if "c" in file.parts and not any(f"/{name}/" in str(file) for name in GRID.axes):
            if left[0] == 0:
                raise PowerCutError
            left[0] -= 1
        write(file, content, staging)

    place = tmp_path / "torn.zarr"
    chunks = len(victims(good, "columns")) + len(victims(good, "records"))
    assert chunks == 2 * (len(dt.Basin.load(good).columns) + 1)
    for count in (1, chunks // 2 - 1, chunks // 2, chunks - 1):  # after a column, or a tile
        with monkeypatch.context() as patch:
            patch.setattr(arrays, "write_at_once", failing)
            left[0] = count
            with pytest.raises(PowerCutError):
                dt.sweep(reduced, GRID, store=place)
        dt.sweep(reduced, GRID, store=place)
        assert files(place) == files(good)
        shutil.rmtree(place)
