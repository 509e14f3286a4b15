"""`dipoletop info`, `plot`, `export`: of a store that is finished, and of one that is not."""

import contextlib
import shutil

import numpy as np
import pandas
import pytest
import xarray
from matplotlib import image

import dipoletop as dt
from command_line import refusal, said
from dipoletop._maps.store.tiles import open_store


def problem(delta, w3, phi):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


GRID = dt.Grid(delta=[-0.4, -0.2], w3=np.linspace(0.0, 0.45, 20), phi=np.arange(16) * np.pi / 16)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    place = tmp_path_factory.mktemp("data") / "s.zarr"
    dt.sweep(problem, GRID, store=place)
    return place


@pytest.fixture(scope="module")
def unfinished(store, tmp_path_factory):
    place = shutil.copytree(store, tmp_path_factory.mktemp("data") / "u.zarr")
    for name in ("outcome", "omega_inf", "dipoletop-tiles/done"):
        for chunk in ("c/4", "c/1/1"):
            shutil.rmtree(place / name / chunk, ignore_errors=True)
    return place


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """The store of a sample, whose starts are in columns."""
    place = tmp_path_factory.mktemp("data") / "sample.zarr"
    starts = dt.Sample(n=50, amplitude=0.2)
    dt.sweep(lambda omega0: (dt.TransverseReduced(-0.2), omega0), starts, store=place, value=False)
    return place


def test_info_says_what_how_far_and_by_what(store, unfinished):
    text, basin = said("info", store), dt.Basin.load(store)
    assert repr(basin) in text
    lines = text.splitlines()
    words = dict(line.split(maxsplit=1) for line in lines if line[0] in "STW")
    assert "rtol 1e-08" in words["Settings"]
    assert words["Tiles"].startswith("6 of 6 finished, 640 starts (100.0%)")
    assert words["Work"] == "no process is at it"
    assert "starts per second" in words["Speed"]
    digests = [line for line in lines if line.startswith("Digest")]
    problem_digest = xarray.open_zarr(store).attrs["problem_digest"]
    assert any(problem_digest in line and line.endswith("of the problem") for line in digests)
    text = said("info", unfinished)
    assert "5 of 6 finished" in text
    assert "left at this rate" in text


def test_a_sweep_that_is_at_work_is_seen(store):
    with contextlib.closing(open_store(store).claims()):
        assert "a process is at it" in said("info", store)


@pytest.mark.parametrize(
    "options",
    [
        ("--at", "delta", "-0.21"),
        ("--panels", "delta", "--shade", "time"),
        ("--average", "--x", "phi", "--y", "w3"),
        ("--at", "phi", "0.1", "--x", "w3", "--shade", "none"),
    ],
)
@pytest.mark.parametrize("kind", ["store", "unfinished"])
def test_any_two_axes_are_drawn(request, tmp_path, kind, options):
    place = request.getfixturevalue(kind)
    text = said("plot", place, *options, "--output", tmp_path / "p.png")
    assert text == f"Picture: {tmp_path / 'p.png'}\n"
    assert image.imread(tmp_path / "p.png").std() > 0.1


def test_shares_are_means_over_the_other_axes(store):
    basin = dt.Basin.load(store)
    drawn = dt.plots.shares(basin, "phi", "w3").collections[0].get_array()
    expected = np.mean(basin.outcome == dt.Outcome.RESIDUAL, axis=0)
    np.testing.assert_allclose(np.asarray(drawn).reshape(20, 16), expected)


def test_what_is_not_computed_yet_is_no_outcome(unfinished):
    with pytest.raises(dt.StoreMismatch, match="is missing 1 of 6 tiles"):
        dt.Basin.load(unfinished)
    basin = dt.Basin.load(unfinished, unfinished=True)
    missing = basin.outcome == -128
    assert 0 < np.sum(missing) < 640
    assert np.all(np.isnan(basin.omega_inf[missing]))
    assert sum(share.count for share in basin.fractions().values()) == np.sum(~missing)
    assert f"not computed yet {np.mean(missing):.2%}" in repr(basin)
    np.testing.assert_array_equal(basin.isel(delta=1).outcome, basin.outcome[1])
    for name, values in basin.to_xarray().data_vars.items():
        assert np.all(np.isnan(values.values[missing])), name
        np.testing.assert_array_equal(values.values[~missing], basin.column(name)[~missing])


def test_an_unfinished_basin_stays_as_it_was_loaded(store, tmp_path):
    """While a sweep goes on, all of its columns are of the same tiles."""
    place, whole = shutil.copytree(store, tmp_path / "s.zarr"), dt.Basin.load(store)
    record = place / "dipoletop-tiles/done/c/3/0"
    kept = record.read_bytes()
    record.unlink()
    basin = dt.Basin.load(place, unfinished=True)
    seen = basin.outcome
    record.write_bytes(kept)
    missing = basin.outcome == -128
    np.testing.assert_array_equal(basin.outcome, seen)
    assert np.all(np.isnan(basin.time[missing]))
    assert dt.Basin.load(place, unfinished=True) == whole


def test_only_what_is_chosen_is_read(store, tmp_path):
    """One tile of a column is damaged: a part that needs neither is taken all the same."""
    place = shutil.copytree(store, tmp_path / "s.zarr")
    (place / "time/c/0/0/0").write_bytes(b"damaged")
    basin = dt.Basin.load(place, unfinished=True)
    part = basin.isel(delta=1)
    assert np.all(np.isfinite(part.time))
    assert basin.isel(delta=0, w3=0).outcome.shape == (16,)
    with pytest.raises(dt.StoreDamaged, match="tile 0: its time cannot be read"):
        _ = basin.isel(delta=0, w3=0).time


def test_a_selection_is_exported_exactly(store, tmp_path):
    basin = dt.Basin.load(store).sel(delta=-0.2).sel(w3=slice(0.1, 0.3))
    for name in ("a.nc", "a.csv", "a.parquet"):
        part = "--at", "delta", "-0.2", "--range", "w3", "0.1", "0.3"
        said("export", store, tmp_path / name, *part)
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as read:
        np.testing.assert_array_equal(read.omega_inf, basin.omega_inf)
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True, dtype=None)
    np.testing.assert_array_equal(table["omega_inf"], basin.omega_inf.ravel())
    np.testing.assert_array_equal(table["outcome"], basin.outcome.ravel())
    assert set(table["delta"]) == {-0.2}
    rows = pandas.read_parquet(tmp_path / "a.parquet")
    assert list(rows.columns) == list(table.dtype.names)
    np.testing.assert_array_equal(rows["omega_inf"], table["omega_inf"])


def test_names_of_any_alphabet_are_exported_and_a_failure_harms_no_file(tmp_path, monkeypatch):
    place, target = tmp_path / "s.zarr", tmp_path / "x.nc"
    dt.sweep(lambda φ: problem(-0.2, 0.1, φ), dt.Grid(φ=[0.1, 0.2]), store=place)
    said("export", place, target)
    with xarray.open_dataset(target, engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["φ"], [0.1, 0.2])
    before = target.read_bytes()
    monkeypatch.setattr("dipoletop.cli.store_commands.find_spec", lambda name: None)
    assert "NetCDF with the name φ needs h5netcdf" in refusal("export", place, target)
    assert target.read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"s.zarr", "x.nc"}


def test_starts_of_samples_are_columns_of_tables(sample, tmp_path):
    said("export", sample, tmp_path / "a.csv", "--column", "outcome")
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True, dtype=None)
    assert set(table.dtype.names) == {"sample", "outcome", "omega0_1", "omega0_2", "omega0_3"}
    np.testing.assert_array_equal(table["omega0_2"], dt.Basin.load(sample).omega0[:, 1])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("export", "STORE", "a.txt"), "a.txt must end with .nc, .parquet, .csv"),
        (("export", "STORE", "a.csv", "--column", "x"), "--column x: the columns are outcome,"),
        (("export", "STORE", "a.csv", "--at", "psi", "1"), "psi must be an axis of this basin"),
        (("plot", "STORE"), "basin must have exactly two axes of numbers"),
        (("plot", "STORE", "--average"), "--average needs --x and --y"),
        (("plot", "STORE", "--panels", "psi"), "--panels must be an axis of this basin"),
        (("info", "nowhere.zarr"), "PATH must be a folder with a basin"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(store, tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert sentence in refusal(*(store if word == "STORE" else word for word in arguments))


def test_info_tells_what_a_tally_counts(tmp_path):
    place, bins = tmp_path / "t.zarr", {"time": [0, 10]}
    counted = dt.tally(problem, GRID, keep="w3", histograms=bins, store=place)
    text = said("info", place)
    assert repr(counted) in text
    assert "finished, 640 starts (100.0%)" in text
    assert "is a tally (`Tally.load` reads it)" in refusal("plot", place)


def test_single_axes_and_samples_are_drawn(store, sample, tmp_path):
    line = tmp_path / "line.zarr"
    dt.Basin.load(store).isel(delta=[0], w3=[5]).save(line)
    without = ["--shade", "none"]
    drawn = (line, ["--shade", "time"]), (sample, without), (sample, [*without, "--y", "w3"])
    for place, options in drawn:
        said("plot", place, *options, "--output", tmp_path / "p.png")
        assert (tmp_path / "p.png").stat().st_size > 5000
        (tmp_path / "p.png").unlink()
