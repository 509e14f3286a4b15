"""Pictures of trajectories: curves, the limit ω∞, the law of decay, refusals."""

from dataclasses import replace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_basins import legend

import dipoletop as dt
from dipoletop import plots

START = dt.cylindrical(0.2, 0.2, np.pi / 30)
N = 41  # times of every run, whose programs are compiled for so many


@pytest.fixture(scope="module")
def residual():
    ts = np.concatenate([[0.0], np.geomspace(0.5, 3e3, N - 1)])
    return dt.simulate(dt.TransverseReduced(-0.2), START, ts)


@pytest.fixture
def averaged(residual):
    """As if the states were those of an equation without a verdict."""
    return replace(residual, equation=dt.TransverseAveraged(-0.2))


def curves(ax):
    return {line.get_label(): line for line in ax.lines}


def test_a_trajectory_that_keeps_a_residual_rotation(residual):
    ax = plots.trajectory(residual)
    drawn = curves(ax)
    ts, omega = np.asarray(residual.ts), np.asarray(residual.omega)
    times = drawn[r"$|\omega|$"].get_xdata()
    own = np.searchsorted(times, ts)
    np.testing.assert_array_equal(times[own], ts)
    for k in range(3):
        curve = drawn[rf"$\omega_{k + 1}$"].get_ydata()
        np.testing.assert_allclose(curve[own], omega[:, k], rtol=1e-14)
    sizes = drawn[r"$|\omega|$"].get_ydata()[own]
    np.testing.assert_allclose(sizes, np.linalg.norm(omega, axis=1), rtol=1e-14)
    assert r"$\omega_\infty = 0.09887$" in drawn  # Fig. 2a of the paper
    assert r"$\propto\tau^{-1/2}$" not in drawn
    assert (ax.get_xscale(), ax.get_xlim()) == ("asinh", (0.0, 3e3))
    thick = curves(plots.trajectory(residual, lw=4, alpha=0.5))[r"$\omega_1$"]
    assert (thick.get_linewidth(), thick.get_alpha()) == (4, 0.5)
    assert ax.get_title() == (
        r"Reduced, order 1 (the paper's): $\delta = -0.2$, $|\omega| = 0.2828$ at first"
    )


def test_a_trajectory_that_stops_has_its_power_law():
    ts = np.geomspace(1.0, 1e4, N)
    run = dt.simulate(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, np.pi / 3), ts)
    _, given = plt.subplots()
    ax = plots.trajectory(run, ax=given)
    assert ax is given
    law = curves(ax)[r"$\propto\tau^{-1/2}$"]
    slope = np.diff(np.log(law.get_ydata())) / np.diff(np.log(law.get_xdata()))
    np.testing.assert_allclose(slope, -0.5)
    np.testing.assert_allclose(law.get_ydata()[-1], np.linalg.norm(run.omega[-1]))
    assert ax.get_xscale() == "log"


def test_a_level_without_a_verdict_has_no_asymptote(averaged):
    ax = plots.trajectory(averaged)
    assert legend(ax) == [r"$|\omega|$", r"$\omega_1$", r"$\omega_2$", r"$\omega_3$"]


@pytest.mark.slow
@pytest.mark.parametrize("dense", [False, True])
def test_sparse_times_make_smooth_curves(dense):
    """Between its times a curve is what a run with more times gives."""
    ts = np.linspace(0.0, 200.0, N)
    run = dt.simulate(dt.TransverseSemi(-0.2), START, ts, dense=dense)
    curve = curves(plots.trajectory(run))[r"$\omega_2$"]
    times = curve.get_xdata()
    assert len(times) > 700
    assert np.all(np.diff(times) > 0)
    exact = dt.simulate(dt.TransverseSemi(-0.2), START, times).omega[:, 1]
    np.testing.assert_allclose(curve.get_ydata(), exact, atol=1e-7 if dense else 2e-4)


@pytest.mark.slow
def test_times_too_far_apart_are_joined_by_straight_lines():
    ts = np.linspace(0.0, 10_900.0, N)  # some 100 radians from one to the next
    run = dt.simulate(dt.TransverseSemi(-0.9), dt.cylindrical(0.05, 0.2, 1.0), ts)
    ax = plots.trajectory(run)
    assert len(curves(ax)[r"$\omega_2$"].get_xdata()) == N
    assert any(line.get_marker() == "." for line in ax.lines)


def test_several_runs_have_their_labels_and_dashes():
    ts = np.linspace(0.0, 100.0, N)
    runs = {
        name: dt.simulate(dt.equation_at(level, -0.2), START, ts)
        for name, level in (("paper", "order-1"), ("consistent", "semi"))
    }
    ax = plots.trajectory(runs, curves=["w1", "size"])
    assert legend(ax) == [r"$|\omega|$", r"$\omega_1$", "paper", "consistent"]
    dashes = {line.get_linestyle() for line in ax.lines if len(line.get_xdata()) > 100}
    assert len(dashes) == 2
    assert "Reduced, order 1 (the paper's); Semi-reduced" in ax.get_title()


def test_refusals(averaged):
    batch = replace(averaged, ts=jnp.zeros((4, 3)), ys=jnp.zeros((4, 3, 3)))
    with pytest.raises(ValueError, match="must describe one top, but has times of shape"):
        plots.trajectory(batch)
    with pytest.raises(ValueError, match="`trajectory` must hold from 1 to 4 runs, but holds 0"):
        plots.trajectory({})
    with pytest.raises(ValueError, match="`curves` must be among size, w1, w2, w3"):
        plots.trajectory(averaged, curves=["w4"])
