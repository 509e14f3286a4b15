"""Tallies: the counts of a sweep that keeps every start, whatever is kept, killed or resumed."""

import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome
from dipoletop._maps import tiling
from dipoletop._maps.store.saved_basins import verify
from dipoletop._maps.tally_results import Tally

AXES = {
    "delta": np.array([-0.4, -0.2, 0.3]),
    "w3": np.linspace(0.0, 0.45, 7),
    "phi": np.linspace(0.0, 3.0, 10),
}
GRID = dt.Grid(**AXES)
EDGES = np.linspace(-0.1, 0.08, 10)
TIMES = np.array([0.0, 1.0, 10.0, 1e3])
SAMPLE = dt.Sample(n=300, amplitude=(0.05, 0.4), seed=2)


def problem(delta, w3, phi):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def of_sample(omega0):
    return dt.TransverseReduced(-0.2), omega0


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(tiling, "TILE", 16)
    monkeypatch.setattr(tiling, "power_of_two", lambda least: 16)


@pytest.fixture(scope="module")
def basin():
    return dt.sweep(problem, GRID)


@pytest.fixture(scope="module")
def times():
    return dt.tally(of_sample, SAMPLE, histograms={"time": TIMES})


def expected_counts(basin, keep, outcome):
    others = tuple(i for i, dim in enumerate(basin.dims) if dim not in keep)
    counts = np.sum(basin.outcome == outcome, axis=others)
    kept = [dim for dim in basin.dims if dim in keep]
    return np.transpose(counts, [kept.index(dim) for dim in keep])


@pytest.mark.parametrize(
    "keep", [(), ("delta",), ("phi",), ("w3", "delta"), ("phi", "w3", "delta")]
)
@pytest.mark.usefixtures("small_tiles")
def test_the_counts_are_those_of_a_sweep(keep, basin):
    found = dt.tally(problem, GRID, keep=keep, histograms={"omega_inf": EDGES, "time": TIMES})
    assert found.dims == keep
    assert found.starts == found.size == 210
    for outcome in Outcome:
        np.testing.assert_array_equal(found.count(outcome), expected_counts(basin, keep, outcome))
    whole = found.merged
    residual = basin.omega_inf[basin.outcome == Outcome.RESIDUAL]
    np.testing.assert_array_equal(whole.histogram("omega_inf"), np.histogram(residual, EDGES)[0])
    assert whole.outside("omega_inf") == (np.sum(residual < -0.1), np.sum(residual > 0.08))
    assert 0 < np.sum(whole.outside("omega_inf")) < residual.size
    np.testing.assert_array_equal(whole.histogram("time"), np.histogram(basin.time, TIMES)[0])
    np.testing.assert_array_equal(whole.certified, np.sum(basin.certified))


def test_each_cell_has_its_own_histogram(basin):
    found = dt.tally(problem, GRID, keep="delta", histograms={"omega_inf": EDGES})
    for k, counts in enumerate(found.histogram("omega_inf")):
        of_cell = basin.omega_inf[k][basin.outcome[k] == Outcome.RESIDUAL]
        np.testing.assert_array_equal(counts, np.histogram(of_cell, EDGES)[0])


@pytest.mark.slow
@pytest.mark.usefixtures("small_tiles")
def test_a_sample_is_counted_with_intervals():
    basin, found = dt.sweep(of_sample, SAMPLE), dt.tally(of_sample, SAMPLE)
    for name, share in basin.fractions().items():
        got = found.fractions()[name]
        np.testing.assert_allclose([*got], [*share], rtol=1e-14)


def test_a_quantile_lies_in_its_bin(basin):
    edges = np.linspace(0.0, 0.4, 41)
    found = dt.tally(of_sample, SAMPLE, histograms={"omega_inf": np.r_[-edges[:0:-1], edges]})
    residual = dt.sweep(of_sample, SAMPLE)
    values = np.sort(residual.omega_inf[residual.outcome == Outcome.RESIDUAL])
    for q in (0.0, 0.1, 0.5, 0.9, 1.0):
        low, high = found.quantile("omega_inf", q)
        exact = values[max(int(np.ceil(q * len(values))), 1) - 1]
        assert low <= exact <= high
        assert high - low == pytest.approx(0.01)


def test_quantiles_outside_of_all_edges_and_of_nothing_are_not_made_up():
    edges = {"omega_inf": [0.9, 1.0]}
    found = dt.tally(of_sample, SAMPLE, histograms=edges)
    assert found.quantile("omega_inf", 0.5) == (-np.inf, 0.9)
    stops = dt.Grid(delta=[-0.9], w3=[0.45], phi=[0.0])
    low, high = dt.tally(problem, stops, histograms=edges).quantile("omega_inf", 0.5)
    assert np.isnan([low, high]).all()


@pytest.mark.usefixtures("small_tiles")
def test_a_tally_resumes_and_counts_each_tile_once(tmp_path):
    settings = {"keep": "delta", "histograms": {"omega_inf": EDGES}}
    alone = dt.tally(problem, GRID, **settings)
    place = tmp_path / "t.zarr"
    assert dt.tally(problem, GRID, store=place, **settings) == alone
    before = {p: p.read_bytes() for p in place.rglob("*") if p.is_file()}
    records = sorted((place / "dipoletop-tiles/done/c").iterdir(), key=lambda p: int(p.name))
    assert len(records) > 8
    for record in records[1::3]:
        (record / "0").unlink()
    partial = Tally.load(place, unfinished=True)
    assert 0 < partial.starts < alone.starts
    with pytest.raises(
        dt.StoreMismatch, match=r"hold a finished tally, but .* is missing 7 of 21 tiles"
    ):
        Tally.load(place)
    assert dt.tally(problem, GRID, store=place, **settings) == alone
    assert {p: p.read_bytes() for p in place.rglob("*") if p.is_file()} == before
    assert Tally.load(place) == alone
    assert not verify(place).damaged


@pytest.mark.usefixtures("small_tiles")
def test_damage_of_counts_is_found_and_repaired(tmp_path):
    place = tmp_path / "t.zarr"
    alone = dt.tally(of_sample, SAMPLE, store=place)
    file = place / "counts/c/3/0"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(dt.StoreDamaged, match="its counts"):
        Tally.load(place)
    with pytest.raises(dt.StoreDamaged, match="`repair` computes it again"):
        dt.tally(of_sample, SAMPLE, store=place)
    assert dt.tally(of_sample, SAMPLE, store=place, repair=True) == alone


def test_other_bins_are_another_tally(tmp_path):
    place = tmp_path / "t.zarr"
    dt.tally(of_sample, SAMPLE, store=place, histograms={"omega_inf": [0.0, 0.1]})
    with pytest.raises(dt.StoreMismatch, match=r"omega_inf is \[0.0, 0.1\] there and \[0.0, 0.2\]"):
        dt.tally(of_sample, SAMPLE, store=place, histograms={"omega_inf": [0.0, 0.2]})
    with pytest.raises(dt.StoreMismatch, match="holds another sweep"):
        dt.sweep(of_sample, SAMPLE, store=place)


def test_a_tally_and_a_basin_are_not_mixed_up(tmp_path):
    dt.tally(of_sample, SAMPLE, store=tmp_path / "t.zarr")
    dt.sweep(of_sample, SAMPLE, store=tmp_path / "b.zarr")
    with pytest.raises(dt.StoreMismatch, match=r"t.zarr is a tally \(`Tally.load` reads it\)"):
        dt.Basin.load(tmp_path / "t.zarr")
    with pytest.raises(dt.StoreMismatch, match=r"b.zarr is not one \(`Basin.load` reads a basin\)"):
        Tally.load(tmp_path / "b.zarr")


def test_no_value_is_paid_for_that_is_not_counted():
    assert dt.tally(of_sample, SAMPLE).attrs["value"] is False
    assert dt.tally(of_sample, SAMPLE, histograms={"omega_inf": EDGES}).attrs["value"] is True


@pytest.mark.slow
def test_derivatives_are_counted():
    def by_delta(delta, omega0):
        return dt.TransverseReduced(delta), omega0

    grid = dt.Grid(delta=[-0.2], omega0=np.asarray(SAMPLE.points(np.arange(20))))
    name = "d_omega_inf_d_delta"
    found = dt.tally(by_delta, grid, derivatives="delta", histograms={name: [-1.0, 0.0, 1.0]})
    values = dt.sweep(by_delta, grid, derivatives="delta")
    known = values.derivative("delta")[values.outcome == Outcome.RESIDUAL]
    np.testing.assert_array_equal(found.histogram(name), np.histogram(known, [-1.0, 0.0, 1.0])[0])


def test_the_data_are_labelled():
    found = dt.tally(problem, GRID, keep=("w3", "delta"), histograms={"time": TIMES})
    data = found.to_xarray()
    assert data.starts.dims == ("w3", "delta", "outcome")
    at = data.starts.sel(delta=-0.2, outcome="STOP").sum()
    assert int(at) == np.sum(found.count(Outcome.STOP)[:, 1])
    assert data.histogram_time.dims == ("w3", "delta", "time_bin")
    assert data.time_bin_low.values.tolist() == [-np.inf, *TIMES]
    assert data.delta.attrs["long_name"] == "1 - I3/I1"
    assert "3 values in [-0.4, 0.3]" in repr(found)
    assert "210 starts; kept: w3, delta" in repr(found)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"keep": "theta"}, r"`keep` must name axes of the grid \(delta, w3, phi\), but names"),
        ({"keep": ("w3", "w3")}, "`keep` must name each axis once"),
        ({"histograms": {"outcome": [0, 1]}}, "`histograms` must be of columns with numbers"),
        ({"histograms": {"time": [1.0]}}, "must have from 2 to 65537 edges, but has 1"),
        ({"histograms": {"time": [1.0, 0.0]}}, r"`histograms\['time'\]` must be edges that incr"),
        ({"histograms": {"time": [0.0, np.nan]}}, r"`histograms\['time'\]` must be finite"),
        ({"histograms": [1.0]}, "`histograms` must be a mapping from columns to edges"),
        ({"tolerance": 1e-6}, "`settings` must be among rtol, atol, max_steps, devices, engine"),
        ({"histograms": {"omega_inf": EDGES}, "value": False}, "`value` must be True"),
    ],
)
def test_bad_arguments_are_refused(arguments, said):
    with pytest.raises(ValueError, match=said):
        dt.tally(problem, GRID, **arguments)


def test_a_sample_has_no_axis_to_keep():
    with pytest.raises(ValueError, match=r"name axes of the grid \(none: no grid is swept\)"):
        dt.tally(of_sample, SAMPLE, keep="omega0")


@pytest.mark.parametrize("q", [-0.1, 1.5, "half"])
def test_bad_quantiles_are_refused(times, q):
    with pytest.raises(ValueError, match="`q` must be a number from 0 to 1"):
        times.quantile("time", q)


def test_what_is_not_counted_has_no_histogram(times):
    with pytest.raises(ValueError, match=r"`column` must have a histogram \(time\)"):
        times.histogram("steps")
