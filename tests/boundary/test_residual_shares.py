"""Residual shares and their derivatives against differences and counts."""

import jax.numpy as jnp
import numpy as np
import pytest
from slow_tops import DELTA, slow

import dipoletop as dt
from dipoletop import boundary


@pytest.mark.slow
def test_the_residual_share_moves_as_its_differences_say():
    def problem(delta, w3, phi):
        return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)

    def share(delta, by=(), higher=0.0):
        both = {"delta": delta, "w3": np.linspace(0.02, 0.35, 4) + higher}
        ends = (both | {"phi": 0.03}, both | {"phi": 0.03 + np.pi})
        return boundary.residual_share(problem, *ends, by=by, parts=32)

    found, step = share(DELTA, ("delta", "w3")), 2e-4
    shifts, weights = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
    by_delta = [share(DELTA + step * k).share for k in shifts]
    by_w3 = [share(DELTA, higher=step * k).share for k in shifts]
    exact = np.array([weights @ by_delta, weights @ by_w3]) / step
    np.testing.assert_allclose([*found.slopes.values()], exact, rtol=1e-7)
    # The whole plane by counting, in which a residual share is that of area.
    grid = dt.Grid(w3=np.linspace(0.02, 0.35, 4), phi=0.03 + np.pi * (np.arange(512) + 0.5) / 512)
    counted = dt.sweep(lambda w3, phi: problem(DELTA, w3, phi), grid, progress=False)
    assert found.share == pytest.approx(counted.fractions()["RESIDUAL"].share, abs=2e-3)
    assert found.undecided == 0


@pytest.mark.slow
def test_a_share_is_not_known_of_segments_where_nothing_is():
    point = {"delta": DELTA, "phi": 0.0, "w": 1e-3}
    ends = {"z": [4.0, 4.0], **point, "delta": [DELTA, 2.0]}, {"z": 4.5, **point}
    found = boundary.residual_share(slow, *ends, by="delta", parts=8)
    assert 0 < found.undecided < 1  # δ = 2 and others between that are too large
    assert np.isfinite([found.share, found.slopes["delta"]]).all()
    ends[1]["delta"] = [DELTA, 3.0]
    found = boundary.residual_share(slow, *ends, by="delta", parts=8)
    assert found.undecided == 0.5
    assert np.isnan([found.share, found.slopes["delta"]]).all()


@pytest.mark.slow
def test_what_is_not_known_beside_a_boundary_does_not_hide_it():
    """A hole next to the boundary, and one at the beginning, change nothing."""
    known = {"phi": 0.0}, {"phi": 0.464}

    def problem(phi):
        return dt.TransverseReduced(DELTA), dt.cylindrical(0.2, 0.2, phi)

    whole = boundary.residual_share(problem, *known, by="phi", parts=10)
    edge = whole.share * known[1]["phi"]

    def holed(phi):
        hole = (phi < 0.01) | ((phi > edge - 0.02) & (phi < edge - 0.01))
        equation, omega0 = problem(phi)
        return equation, omega0 * jnp.where(hole, jnp.nan, 1.0)

    for ends in (known, known[::-1]):
        exact = boundary.residual_share(problem, *ends, by="phi", parts=10)
        found = boundary.residual_share(holed, *ends, by="phi", parts=10)
        assert found.undecided == pytest.approx(2 / 11)
        assert found.share == pytest.approx(exact.share, abs=1e-13)
        assert found.slopes["phi"] == pytest.approx(exact.slopes["phi"], rel=1e-6)
