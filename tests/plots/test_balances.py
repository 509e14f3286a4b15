"""The picture of a balance: its lines are the rates, at other pressures and speeds, too."""

import numpy as np
import pytest

import dipoletop as dt
from dipoletop import plots
from dipoletop.particles import paper_particles

DAST, SPIN = paper_particles()[2].particle, 2e9 * np.pi


def test_lines_are_the_rates():
    found = dt.balance(DAST, SPIN, pressure=1e-7, loss=0.1, field=1e3, strength=1e8)
    left, right = plots.balance(found).axes
    lines = {line.get_label(): line for line in left.lines}
    assert list(lines)[:4] == ["radiation", "gas", "thermal radiation", "field, at most"]
    pressure, rate = lines["gas"].get_data()
    for p, r in zip(pressure[[0, -1]], rate[[0, -1]], strict=True):
        np.testing.assert_allclose(r, dt.balance(DAST, SPIN, pressure=p).rates["gas"], rtol=1e-10)
    for line in right.lines[:4]:
        speed, rate = line.get_data()
        name = {"thermal radiation": "blackbody", "field, at most": "field"}
        name = name.get(line.get_label(), line.get_label())
        there = dt.balance(DAST, speed[-1], pressure=1e-7, loss=0.1, field=1e3)
        np.testing.assert_allclose(rate[-1], there.rates[name], rtol=1e-10)
    marks = [line.get_xdata()[0] for line in right.lines if line.get_linestyle() in ("--", ":")]
    np.testing.assert_allclose(marks[0], found.thermal_spin)
    burst = dt.balance(DAST, marks[1], strength=1e8)
    np.testing.assert_allclose(burst.stress, 1e8, rtol=1e-10)


def test_refusals():
    bare = dt.Particle(1e-18, 1e-33 * np.eye(3), [8e-27, 0, 0])
    with pytest.raises(ValueError, match="`balance` must belong to a particle with a `shape`"):
        plots.balance(dt.balance(bare, SPIN))
    with pytest.raises(ValueError, match="`balance` must be that of one rotation, but has shape"):
        plots.balance(dt.balance(DAST, SPIN, pressure=[1.0, 2.0]))
