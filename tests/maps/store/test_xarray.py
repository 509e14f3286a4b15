"""Stores as xarray opens them: labelled, described, and with missing values where not computed."""

import jax
import numpy as np
import pytest
import xarray
from store_helpers import GRID, RECORDS, header_of, numbers, reduced

import dipoletop as dt


def draw(key):
    ways, shape = jax.random.split(key)
    delta = jax.random.uniform(shape, (), float, -0.5, -0.1)
    return {"delta": delta, "way": jax.random.normal(ways, (3,))}


def of_sample(delta, way):
    return dt.TransverseReduced(delta), 0.2 * way


def over_points(delta, omega0):
    return dt.TransverseReduced(delta), omega0


SWEEPS = {
    "grid": (reduced, GRID),
    "sample": (of_sample, dt.Sample(n=300, draw=draw, seed=3)),
    "points": (
        over_points,
        dt.Points(delta=[-0.2, -0.3], omega0=[[0.1, 0.2, 0.3], [0.3, 0.1, 0.0]]),
    ),
}


@pytest.mark.parametrize("kind", SWEEPS)
def test_a_store_is_the_dataset_of_its_basin(tmp_path, kind):
    """Masked numbers become floating-point numbers; the type on disk is found without masks."""
    problem, over = SWEEPS[kind]
    basin = dt.sweep(problem, over, store=tmp_path / "s.zarr")
    expected = basin.to_xarray()
    masked = xarray.open_zarr(tmp_path / "s.zarr").load()
    digest = masked.attrs.pop("problem_digest")
    for name in expected.data_vars:
        masked[name] = masked[name].astype(expected[name].dtype).assign_attrs(masked[name].attrs)
    masked = masked.assign_coords(level=masked.attrs.pop("level"))
    xarray.testing.assert_identical(masked, expected)
    assert digest == header_of(tmp_path / "s.zarr")["programs"]["problem"]
    assert expected.level == basin.level

    raw = xarray.open_zarr(tmp_path / "s.zarr", mask_and_scale=False)
    assert raw.outcome.dtype == np.int8
    assert raw.outcome.attrs["_FillValue"] == -128
    flags = zip(
        raw.outcome.attrs["flag_meanings"].split(), raw.outcome.attrs["flag_values"], strict=True
    )
    assert dict(flags) == {outcome.name: outcome for outcome in dt.Outcome}
    np.testing.assert_array_equal(raw.outcome, basin.outcome)


def test_what_is_not_computed_yet_is_missing(tmp_path):
    """The second of two tiles; 0 would be UNDECIDED, or a residual rotation of 0."""
    dt.sweep(reduced, GRID, store=tmp_path / "s.zarr", confirm=1e-9)
    basin = dt.sweep(reduced, GRID, confirm=1e-9)
    for name in (*basin.columns, RECORDS):
        (tmp_path / "s.zarr" / name / "c/1/0").unlink()
    seen = xarray.open_zarr(tmp_path / "s.zarr").load()
    for name in basin.columns:
        assert np.all(np.isnan(seen[name][7:]))
        np.testing.assert_array_equal(seen[name][:7], basin.column(name)[:7])
    raw = xarray.open_zarr(tmp_path / "s.zarr", mask_and_scale=False)
    assert np.all(raw.outcome[7:] == -128)
    again = dt.sweep(reduced, GRID, store=tmp_path / "s.zarr", confirm=1e-9)
    assert numbers(again) == numbers(basin)


def test_a_dataset_can_be_written_as_netcdf(tmp_path):
    for kind, (problem, over) in SWEEPS.items():
        data = dt.sweep(problem, over).to_xarray()
        data.to_netcdf(tmp_path / f"{kind}.nc", engine="scipy")
        with xarray.open_dataset(tmp_path / f"{kind}.nc", engine="scipy") as read:
            assert read.level.item() == data.level.item()
            np.testing.assert_array_equal(read.outcome, data.outcome)


@pytest.mark.parametrize("store", [False, True])
def test_a_sample_keeps_its_starts_and_parameters(tmp_path, store):
    problem, sample = SWEEPS["sample"]
    basin = dt.sweep(problem, sample, store=tmp_path / "s.zarr" if store else None)
    points = sample.points(np.arange(300))
    np.testing.assert_array_equal(basin.omega0, 0.2 * points["way"])
    np.testing.assert_array_equal(basin.column("delta"), points["delta"])
    np.testing.assert_array_equal(basin.column("way"), points["way"])
    data = basin.to_xarray()
    assert data.omega0.dims == ("sample", "component")
    assert set(data.coords) == {"omega0", "delta", "way", "level"}
    stopped = data.omega0.where(data.outcome == dt.Outcome.STOP, drop=True)
    assert len(stopped) == np.sum(basin.outcome == dt.Outcome.STOP)
    found = dt.classify_many(dt.TransverseReduced(basin.column("delta")), basin.omega0)
    np.testing.assert_array_equal(found.outcome, basin.outcome)


def test_names_of_columns_are_none_of_arguments():
    def confused(key):
        return {"steps": jax.random.uniform(key)}

    with pytest.raises(ValueError, match="`draw` must give no argument the name of a column"):
        dt.sweep(lambda steps: reduced(steps, 0.1), dt.Sample(n=5, draw=confused))
    with pytest.raises(ValueError, match="`over` must give no argument the name of a column"):
        dt.sweep(lambda time: reduced(time, 0.1), dt.Grid(time=[0.1, 0.2]))
