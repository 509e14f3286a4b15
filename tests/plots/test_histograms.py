"""Histograms count what a sweep found, each start once."""

import numpy as np
import pytest
from made_basins import R, S, made
from matplotlib.patches import StepPatch

import dipoletop as dt
from dipoletop import plots


def steps(ax):
    return [patch for patch in ax.patches if isinstance(patch, StepPatch)]


def test_residual_starts_are_counted_by_omega_inf():
    values = np.array([[-0.2, 0.12, 0.12, np.nan], [0.0, 0.0, 0.2, 0.15]])
    found = made([[R, R, R, R], [S, S, R, R]], values)
    ax = plots.histogram(found, bins=4)
    (patch,) = steps(ax)
    counts, edges, _ = patch.get_data()
    np.testing.assert_allclose(edges, [-0.2, -0.1, 0.0, 0.1, 0.2], atol=1e-15)
    assert counts.sum() == 5  # not the one whose ω∞ is unknown, nor stops
    np.testing.assert_array_equal(counts, [1, 0, 0, 4])
    assert "8 starts, residual 75 %, stop 25 %" in ax.get_title()
    (grey,) = steps(plots.histogram(found, bins=4, color="0.5", alpha=0.3))
    assert (grey.get_facecolor()[:3], grey.get_alpha()) == ((0.5, 0.5, 0.5), 0.3)


def test_times_are_stacked_by_outcome():
    time = np.array([[1.0, 10.0, 100.0], [1.0, 10.0, 10.0]])
    ax = plots.histogram(made([[R, R, R], [S, S, S]], time=time), "time", bins=2)
    residual, stop = (patch.get_data() for patch in steps(ax))
    np.testing.assert_allclose(residual[1], [1, 10, 100])
    np.testing.assert_array_equal(residual[0], [1, 2])
    np.testing.assert_array_equal(stop[0], [2, 4])
    np.testing.assert_array_equal(stop[2], [1, 2])
    assert ax.get_xscale() == "log"


def test_one_value_is_a_histogram_too():
    (patch,) = steps(plots.histogram(made([[R, R]], 0.1), bins=3))
    assert patch.get_data()[0].sum() == 2


def test_a_tally_has_its_own_bins():
    def problem(w3, phi):
        return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)

    grid = dt.Grid(w3=np.linspace(0, 0.5, 12), phi=np.linspace(0, 3, 16))
    edges = np.linspace(-0.2, 0.2, 9)
    tally = dt.tally(problem, grid, keep="w3", histograms={"omega_inf": edges})
    (patch,) = steps(plots.histogram(tally))
    counts, found_edges, _ = patch.get_data()
    np.testing.assert_array_equal(found_edges, edges)
    np.testing.assert_array_equal(counts, tally.histogram("omega_inf").sum(axis=0))
    (own,) = steps(plots.histogram(dt.sweep(problem, grid), bins=30))
    assert own.get_data()[0].sum() == tally.fractions()["RESIDUAL"].count.sum()


@pytest.mark.parametrize(
    ("column", "message"),
    [("certified", "name a column of numbers"), ("speed", "be a column"), ("omega_inf", "values")],
)
def test_refusals(column, message):
    with pytest.raises(ValueError, match=message):
        plots.histogram(made([[S, S], [S, S]], 0.0), column)
