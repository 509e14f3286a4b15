"""Basins: names and units of their columns, and what they print."""

import dataclasses

import numpy as np
import pytest
import xarray

import dipoletop as dt
from dipoletop.boundary import fate


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


GRID = dt.Grid(w3=np.linspace(0.0, 0.45, 10), phi=np.linspace(0.0, 3.0, 26))


@pytest.fixture(scope="module")
def basin():
    return dt.sweep(reduced, GRID)


def test_xarray_names_units_and_sources(basin):
    data = basin.to_xarray()
    assert data.omega_inf.dims == ("w3", "phi")
    assert data.omega_inf.attrs["units"] == data.w3.attrs["units"] == "1/tau_0"
    assert data.phi.attrs["units"] == "rad"
    assert np.array_equal(data.phi, GRID.axes["phi"])
    assert data.level == "reduced, order 1 (the paper's)"
    assert data.attrs["rtol"] == 1e-8
    assert data.attrs["version_dipoletop"] == dt.__version__


def test_joined_datasets_keep_every_level(basin):
    other = dataclasses.replace(basin, attrs=basin.attrs | {"level": "semi-reduced"})
    joined = xarray.concat([basin.to_xarray(), other.to_xarray()], "level")
    assert joined.level.values.tolist() == [basin.level, "semi-reduced"]


def test_a_basin_prints_its_axes_shares_and_tolerance(basin, tmp_path):
    share = basin.fractions()["RESIDUAL"].share
    level, axes, shares = repr(basin).splitlines()
    assert level == "Basin(reduced, order 1 (the paper's); rtol 1e-08"
    assert axes.strip() == "w3: 10 values in [0, 0.45], phi: 26 values in [0, 3]; 260 starts"
    assert shares.strip() == f"RESIDUAL {share:.2%}, STOP {1 - share:.2%}, certified 100.00%)"
    basin.save(tmp_path / "b.zarr")
    loaded = dt.Basin.load(tmp_path / "b.zarr")
    assert repr(loaded) == repr(basin)
    (tmp_path / "b.zarr" / "outcome" / "c" / "0" / "0").unlink()
    assert repr(loaded).endswith("b.zarr is damaged, tile 0: its outcome is missing.)")
    few = dt.sweep(reduced, dt.Grid(w3=GRID.axes["w3"], phi=0.1), max_steps=1, slow_flow=False)
    assert "UNDECIDED" in repr(few)


def test_shares_have_the_intervals_of_wilson(basin):
    z = 1.959963984540054
    for share in basin.fractions().values():
        p = share.count / 260
        assert share.share == p
        for end in (share.low, share.high):  # the roots of (p̂ − p)² = z²p(1 − p)/n
            assert abs((p - end) ** 2 - z**2 * end * (1 - end) / 260) < 1e-14


def test_starts_are_compared_in_whatever_order_they_are(basin):
    w3, phi = GRID.axes["w3"], GRID.axes["phi"]
    for other in (dt.Grid(phi=phi[::-1], w3=w3), dt.Grid(w3=np.roll(w3, 3), phi=phi)):
        assert all(here == there for here, there in dt.sweep(reduced, other).compare(basin))
    shuffled = np.random.default_rng(2).permutation(260)
    points = {name: x.ravel() for name, x in zip(("w3", "phi"), np.meshgrid(w3, phi), strict=True)}
    first = dt.sweep(reduced, dt.Points(**points))
    second = dt.sweep(reduced, dt.Points(**{name: x[shuffled] for name, x in points.items()}))
    assert all(here == there for here, there in first.compare(second))
    assert sum(share.count for share in first.compare(second).values()) == 260


def test_other_starts_are_not_compared(basin):
    with pytest.raises(ValueError, match="`other` must have the axes w3, phi, but has point"):
        basin.compare(dt.sweep(reduced, dt.Points(w3=[0.1], phi=[0.2])))
    moved = dt.sweep(reduced, dt.Grid(w3=GRID.axes["w3"] + 1e-3, phi=GRID.axes["phi"]))
    with pytest.raises(ValueError, match="same values as this basin along the axis w3"):
        basin.compare(moved)

    def drawn(omega):
        return dt.TransverseReduced(-0.2), omega

    samples = [dt.sweep(drawn, dt.Sample(n=64, amplitude=0.2, seed=seed)) for seed in (1, 2, 1)]
    assert all(here == there for here, there in samples[0].compare(samples[2]))
    with pytest.raises(ValueError, match="same values as this basin along the axis"):
        samples[0].compare(samples[1])


def test_what_is_not_computed_yet_is_no_outcome(basin):
    outcome, half = basin.outcome.ravel().copy(), 130
    outcome[half:] = -128
    columns = {**basin.columns, "outcome": outcome}
    part = dt.Basin(basin.dims, basin.shape, basin.coords, columns, basin.attrs)
    shares = part.compare(basin)
    assert all(here == there for here, there in shares)
    assert sum(share.count for share in shares.values()) == half
    with pytest.raises(ValueError, match="`basin` must be finished, but lacks 130 of its 260"):
        fate(part)
    figure = dt.plots.compare(part, basin, unfold=False)
    assert "outcome differs for 0" in figure.axes[0].get_title()
