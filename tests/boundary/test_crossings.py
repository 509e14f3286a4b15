"""Crossings and their derivatives against the limit of small amplitudes."""

import numpy as np
import pytest
from slow_tops import DELTA, RESIDUAL, ROTATING, SLOPE, Z_S, across, backwards, slow

from dipoletop import boundary
from dipoletop._maps.sweep import PointSweeps
from dipoletop.boundary.crossings import first_change


def test_the_change_lies_between_the_last_decided_points():
    fates = np.array(
        [
            [1, 1, 5, 5, 5],
            [1, -1, -1, -2, 5],
            [1, 1, -1, 2, 5],
            [5, 1, -1, 1, 5],
            [1, 1, -1, 1, 1],
            [-1, 1, 5, 5, 5],
        ]
    )
    places, there = first_change(fates)
    np.testing.assert_array_equal(there, [True, True, True, True, False, False])
    np.testing.assert_array_equal(places[:4], [[1, 2], [0, 4], [1, 3], [0, 1]])


def test_bisection_ends_at_rounding_and_at_the_universal_boundary():
    w = np.array([1e-3, 1e-2, 1e-2])
    found = across((4.0, np.array([4.5, 4.5, 4.1])), w=w)
    np.testing.assert_array_equal(found.found, [True, True, False])
    assert np.isnan(found.before["z"][2])
    assert list(found.fates[2]) == [RESIDUAL, RESIDUAL]
    np.testing.assert_array_equal(found.fates[:2], [[RESIDUAL, ROTATING]] * 2)
    assert np.all(found.width[:2] <= 2.0**-52)
    assert np.all(found.after["z"][:2] - found.before["z"][:2] <= 2 * np.spacing(4.2))
    np.testing.assert_allclose(found.after["z"][:2] / Z_S - 1, [1.06e-5, 1.06e-3], rtol=0.01)


def test_what_is_undecided_is_left_between():
    rough = boundary.bisect(
        lambda z: slow(DELTA, z, 0.0, 1e-3), {"z": 4.0}, {"z": 4.5}, max_steps=60, slow_flow=False
    )
    assert 1e-6 < rough.width[0] < 0.1
    exact = across().after["z"][0]
    assert rough.before["z"][0] < exact < rough.after["z"][0]


@pytest.mark.slow
def test_derivative_is_that_of_bisected_points_and_of_the_planar_limit():
    h = 1e-4
    delta = DELTA + np.array([0.0, 0.0, -h, h, -3 * h, 3 * h])
    found = across(delta=delta, w=np.array([1e-3, 1e-2] + 4 * [1e-3]))

    def derivatives(distance=None):
        return boundary.derivative(found, "z", ["delta", "phi"], distance=distance)

    slope, turning = derivatives().T
    _, _, *near = found.before["z"]
    simple, wide = (near[1] - near[0]) / (2 * h), (near[3] - near[2]) / (6 * h)
    np.testing.assert_allclose(slope[0], simple + (simple - wide) / 8, rtol=1e-8)
    excess = slope[:2] / SLOPE - 1
    assert excess[0] < 3e-5
    np.testing.assert_allclose(excess[1] / excess[0], 100, rtol=0.05)  # O(ω⊥²)
    (far, _), (less, _) = derivatives(1e-3)[0], derivatives(1e-4)[0]
    ratio = (far / slope[0] - 1) / (less / slope[0] - 1)
    np.testing.assert_allclose(ratio, 10, rtol=0.01)  # an error like the distance
    flow = backwards(0.0, [0.0, Z_S])
    np.testing.assert_allclose(turning[0], flow[1] / flow[0], rtol=1e-4)


def test_a_summary_of_crossings_has_counts():
    bracket = np.array([[0.25, 0.5], [np.nan, np.nan]])
    ends = {"z": np.zeros(2)}
    sides = np.array([[1, 5], [1, 1]])
    crossings = boundary.Crossings(PointSweeps(slow, {}), ends, ends, bracket, sides)
    assert repr(crossings) == (
        "Crossings(2 segments, 1 crossed, s=0.375 and 1 NaN, width=0.25 and 1 NaN)"
    )
