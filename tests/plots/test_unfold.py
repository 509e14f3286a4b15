"""Unfolding: a symmetry cell becomes the whole plane that a sweep would have computed."""

import numpy as np
import pytest
from made_basins import F, R, S, U, made

import dipoletop as dt
from dipoletop import plots


def whole_problem(phi, delta, w3):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def test_unfolded_cell_equals_a_sweep_of_the_whole_plane():
    phi, w3 = np.arange(8) * np.pi / 8, np.linspace(0.0, 0.4, 5)
    cell = dt.Grid(phi=phi, delta=[-0.2, 0.3], w3=w3)
    round_, axial = np.arange(16) * np.pi / 8, np.linspace(-0.4, 0.4, 9)
    plane = dt.sweep(whole_problem, dt.Grid(phi=round_, delta=[-0.2, 0.3], w3=axial))
    unfolded = plots.unfold(dt.sweep(whole_problem, cell))
    assert unfolded.dims == plane.dims
    assert unfolded.shape == plane.shape == (16, 2, 9)
    for name in plane.coords:
        np.testing.assert_allclose(unfolded.coords[name], plane.coords[name], atol=1e-14)
    for name in ("outcome", "stop", "certified"):
        np.testing.assert_array_equal(unfolded.column(name), plane.column(name))
    # Both outcomes and both signs occur, so that the comparison is worth something.
    assert set(plane.fractions()) == {"RESIDUAL", "STOP"}
    assert np.nanmin(plane.omega_inf) < -0.05 < 0.05 < np.nanmax(plane.omega_inf)
    np.testing.assert_allclose(unfolded.omega_inf, plane.omega_inf, rtol=1e-6, atol=1e-12)
    assert not np.signbit(unfolded.omega_inf[unfolded.outcome == S]).any()
    assert unfolded.level == plane.level


@pytest.mark.slow
def test_unfolded_derivatives_are_those_of_a_sweep_of_the_whole_plane():
    names = ("delta", "phi", "w3")
    cell = dt.Grid(phi=np.arange(4) * np.pi / 4, delta=[-0.2], w3=[0.1, 0.2])
    plane = dt.Grid(phi=np.arange(8) * np.pi / 4, delta=[-0.2], w3=[-0.2, -0.1, 0.1, 0.2])
    unfolded, whole = (dt.sweep(whole_problem, grid, derivatives=names) for grid in (cell, plane))
    unfolded = plots.unfold(unfolded)
    for name in names:
        computed = whole.derivative(name)
        assert np.nanmin(computed) < -1e-3 < 1e-3 < np.nanmax(computed)
        np.testing.assert_allclose(unfolded.derivative(name), computed, rtol=1e-6, atol=1e-9)


def test_a_circle_is_mirrored_but_not_extended():
    axes = {"w3": np.array([0.1, 0.3]), "phi": np.arange(6) * np.pi / 3}
    half = made(np.array([[R, S, R, U, S, F], [S, S, S, R, R, R]]), axes=axes)
    whole = plots.unfold(half)
    assert whole.shape == (4, 6)
    np.testing.assert_array_equal(whole.coords["w3"], [-0.3, -0.1, 0.1, 0.3])
    np.testing.assert_array_equal(whole.outcome[2:], half.outcome)
    np.testing.assert_array_equal(whole.outcome[1], half.outcome[0, [0, 5, 4, 3, 2, 1]])
    np.testing.assert_array_equal(whole.outcome[0], half.outcome[1, [0, 5, 4, 3, 2, 1]])


@pytest.mark.parametrize(
    "axes",
    [
        {"w3": [0.0, 0.1], "delta": [-0.2, 0.2]},
        {"w3": [0.0, 0.1], "phi": [0.0, 1.0]},
        {"w3": [0.0, 0.1], "phi": np.linspace(0.0, np.pi, 5)},
        {"w3": [-0.1, 0.1], "phi": [0.0, np.pi]},
        {"w3": [0.2, 0.1], "phi": [0.0, np.pi]},
        {"w3": [0.1], "phi": [0.0]},
    ],
)
def test_what_is_no_symmetry_cell_is_left_as_it_is(axes):
    given = made(np.full([len(values) for values in axes.values()], R), axes=axes)
    assert plots.unfold(given) is given
