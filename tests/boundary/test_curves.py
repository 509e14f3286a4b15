"""Boundary curves against a stable manifold and an exact level set."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from slow_tops import DELTA, across, backwards, slow

from dipoletop import boundary
from dipoletop.planar import Planar, saddle


@pytest.mark.slow
def test_a_fold_is_passed():
    box = {"phi": (-2.0, 2.0), "z": (0.0, 8.0)}
    curve = boundary.trace(across((2.5, 3.5), phi=-1.5), box, step=0.06, n=14, by="delta")
    phi, z = curve.points.T
    fold = np.argmin(phi)
    assert 3 < fold < len(phi) - 1
    assert np.all(np.diff(z[fold:]) < 0)
    # the same curve as the stable manifold of the saddle, followed from there
    at = saddle(Planar(DELTA, corrected=False))
    start = np.array([at.phi, at.z]) - 1e-7 * np.array([1.0, float(at.stable_slope)])
    manifold = solve_ivp(backwards, (0, 30), start, rtol=1e-10, atol=1e-12, max_step=0.01).y.T
    for point, normal in zip(curve.points, curve.normals, strict=True):
        away = manifold - point
        nearest = away[np.argmin(np.sum(away**2, axis=1))]
        assert abs(normal @ nearest) < 1e-4


@pytest.mark.slow
def test_an_ellipse_is_an_ellipse():
    # the boundary z = z_s is a level set of the function that is put for z
    def problem(x, y, c):
        return slow(DELTA, c + x**2 + 4.0 * y**2, 0.0, 1e-3)

    level = across().after["z"][0] - 4.0
    start = boundary.bisect(problem, {"x": 0.1, "y": 0.0, "c": 4.0}, {"x": 0.9, "y": 0.2, "c": 4.0})
    box = {"y": (-1.0, 1.0), "x": (-1.0, 1.0)}
    curve = boundary.trace(start, box, step=-0.24, n=50, by="c")
    y, x = curve.points.T
    assert curve.end == "closed"
    np.testing.assert_array_equal(curve.points[0], curve.points[-1])
    np.testing.assert_allclose(x**2 + 4 * y**2, level, rtol=1e-8)
    slope = np.stack([8 * y, 2 * x], axis=1)
    size = np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(curve.normals, slope / size, atol=1e-7)
    assert curve.shift is not None
    np.testing.assert_allclose(curve.shift, -slope / size**2, atol=1e-7)
    area = abs(np.sum(x[:-1] * np.diff(y) - y[:-1] * np.diff(x))) / 2
    np.testing.assert_allclose(area, np.pi * level / 2, rtol=0.2)


def test_a_summary_of_a_curve_has_its_ranges():
    points = np.array([[0.0, 1.0], [0.5, 2.0]])
    curve = boundary.Curve(points, points, None, boundary.CurveEnd.LOST)
    assert repr(curve) == "Curve(points=[0, 1, 0.5, 2], end=LOST)"
    assert curve.end == "lost"
