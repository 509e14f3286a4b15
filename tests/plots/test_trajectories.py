"""Pictures of trajectories: curves, the limit ω∞, the law of decay, refusals."""

from dataclasses import replace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_basins import legend

import dipoletop as dt
from dipoletop import plots


def curves(ax):
    return {line.get_label(): line for line in ax.lines}


def test_a_trajectory_that_keeps_a_residual_rotation():
    ts = np.concatenate([[0.0], np.geomspace(0.5, 3e3, 60)])
    run = dt.simulate(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, np.pi / 30), ts)
    ax = plots.trajectory(run)
    drawn = curves(ax)
    omega = np.asarray(run.omega)
    for k in range(3):
        np.testing.assert_array_equal(drawn[rf"$\omega_{k + 1}$"].get_ydata(), omega[:, k])
    np.testing.assert_allclose(drawn[r"$|\omega|$"].get_ydata(), np.linalg.norm(omega, axis=1))
    np.testing.assert_array_equal(drawn[r"$|\omega|$"].get_xdata(), ts)
    assert r"$\omega_\infty = 0.09887$" in drawn  # Fig. 2a of the paper
    assert r"$\propto\tau^{-1/2}$" not in drawn
    assert (ax.get_xscale(), ax.get_xlim()) == ("symlog", (0.0, 3e3))
    assert ax.get_title() == "Reduced, order 1 (the paper's)"


def test_a_trajectory_that_stops_has_its_power_law():
    ts = np.geomspace(1.0, 1e4, 40)
    run = dt.simulate(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, np.pi / 3), ts)
    _, given = plt.subplots()
    ax = plots.trajectory(run, ax=given)
    assert ax is given
    law = curves(ax)[r"$\propto\tau^{-1/2}$"]
    slope = np.diff(np.log(law.get_ydata())) / np.diff(np.log(law.get_xdata()))
    np.testing.assert_allclose(slope, -0.5)
    np.testing.assert_allclose(law.get_ydata()[-1], np.linalg.norm(run.omega[-1]))
    assert ax.get_xscale() == "log"


def test_a_level_without_a_verdict_has_no_asymptote():
    ts = np.array([0.0, 1.0, 2.0])
    run = dt.simulate(dt.TransverseAveraged(-0.2), dt.cylindrical(0.2, 0.2, 1.0), ts)
    ax = plots.trajectory(run)
    assert legend(ax) == [r"$|\omega|$", r"$\omega_1$", r"$\omega_2$", r"$\omega_3$"]


def test_a_batch_of_trajectories_is_refused():
    run = dt.simulate(dt.TransverseAveraged(-0.2), dt.cylindrical(0.2, 0.2, 1.0), [0.0, 1.0, 2.0])
    batch = replace(run, ts=jnp.zeros((4, 3)), ys=jnp.zeros((4, 3, 3)))
    with pytest.raises(ValueError, match="must be that of one top, but has times of shape"):
        plots.trajectory(batch)
