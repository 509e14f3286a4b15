"""Parts of basins: what xarray takes from the same data, in memory and from a store."""

import numpy as np
import pytest
import xarray

import dipoletop as dt


def problem(delta, w3, phi):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


GRID = dt.Grid(delta=[-0.3, -0.2], w3=np.linspace(0.0, 0.45, 21), phi=np.linspace(0.0, 3.0, 16))


@pytest.fixture(scope="module", params=["memory", "store"])
def basin(request, tmp_path_factory):
    place = tmp_path_factory.mktemp("s") / "s.zarr" if request.param == "store" else None
    return dt.sweep(problem, GRID, store=place)


@pytest.mark.parametrize(
    "positions",
    [
        {},
        {"delta": 1},
        {"w3": slice(3, 17, 2), "phi": -1},
        {"phi": [3, 1, 2], "delta": [0]},
        {"delta": 0, "w3": 20, "phi": 0},
        {"w3": np.arange(21) % 2 == 0},
    ],
)
def test_positions_are_those_of_xarray(basin, positions):
    part = basin.isel(**positions)
    xarray.testing.assert_identical(part.to_xarray(), basin.to_xarray().isel(**positions))
    assert part.attrs == basin.attrs


@pytest.mark.parametrize(
    ("method", "values"),
    [
        (None, {"delta": -0.2, "phi": slice(0.35, 1.2)}),
        ("nearest", {"w3": 0.11, "phi": [0.0, 2.1]}),
        ("nearest", {"w3": 0.11, "phi": slice(1.0, 2.0)}),
        ("pad", {"w3": [0.11, 0.2]}),
    ],
)
def test_values_are_those_of_xarray(basin, method, values):
    part = basin.sel(method=method, **values).to_xarray()
    expected = basin.to_xarray()
    for name, wanted in values.items():
        how = None if isinstance(wanted, slice) else method
        expected = expected.sel({name: wanted}, method=how)
    xarray.testing.assert_identical(part, expected)


def test_a_part_is_saved_and_drawn_like_any_basin(basin, tmp_path):
    part = basin.sel(delta=-0.2)
    assert part.shape == (21, 16)
    assert "delta: -0.2, w3: 21 values" in repr(part)
    part.save(tmp_path / "part.zarr")
    assert dt.Basin.load(tmp_path / "part.zarr") == part
    assert "= −0.2" in dt.plots.basin(part).get_title()
    single = basin.isel(delta=0, w3=1, phi=2)
    assert single.outcome.shape == ()
    single.save(tmp_path / "single.zarr")
    assert dt.Basin.load(tmp_path / "single.zarr") == single


def test_samples_and_points_are_taken_by_number():
    sample = dt.sweep(lambda w: (dt.TransverseReduced(-0.2), w), dt.Sample(n=200, amplitude=0.2))
    stopped = np.flatnonzero(sample.outcome == dt.Outcome.STOP)
    part = sample.isel(sample=stopped)
    np.testing.assert_array_equal(part.omega0, sample.omega0[stopped])
    assert sample.sel(sample=slice(3, 7)).shape == (4,)
    points = dt.sweep(problem, dt.Points(delta=[-0.2, -0.3], w3=[0.1, 0.2], phi=[0.3, 1.0]))
    np.testing.assert_array_equal(points.isel(point=[1]).coords["w3"], [0.2])
    xarray.testing.assert_identical(
        points.isel(point=1).to_xarray(), points.to_xarray().isel(point=1)
    )


@pytest.mark.parametrize(
    ("take", "said"),
    [
        (lambda b: b.sel(psi=1.0), r"`psi` must be an axis of this basin \(delta, w3, phi\)"),
        (lambda b: b.isel(w3=21), "`w3` must be positions from 0 to 20, or a slice, but is 21"),
        (lambda b: b.isel(w3="a"), "`w3` must be positions from 0 to 20"),
        (lambda b: b.isel(w3=[]), "`w3` must choose at least one position"),
        (lambda b: b.sel(w3=0.1), r"`w3` must be values on that axis \(`method='nearest'` takes"),
        (
            lambda b: b.compare(b.isel(w3=0)),
            "`other` must have the axes delta, w3, phi, but has delta",
        ),
    ],
)
def test_what_is_not_there_is_refused_in_one_sentence(basin, take, said):
    with pytest.raises(ValueError, match=said) as caught:
        take(basin)
    assert "\n" not in str(caught.value)


def test_basins_are_compared_bit_by_bit(basin):
    again = dt.sweep(problem, GRID)
    assert basin == again
    assert basin != dt.sweep(problem, GRID, rtol=1e-9)
    assert basin != basin.isel(phi=slice(5))
    again.columns["omega_inf"][7] = np.nextafter(again.columns["omega_inf"][7], 1.0)
    assert basin != again
    assert basin != "basin"


def test_pairs_of_outcomes_are_counted(basin):
    thin, thick = basin.sel(delta=-0.3), basin.sel(delta=-0.2)
    pairs = thin.compare(thick)
    differ = np.sum(thin.outcome != thick.outcome)
    assert differ > 10
    assert sum(share.count for (a, b), share in pairs.items() if a != b) == differ
    assert sum(share.count for share in pairs.values()) == 21 * 16
