"""A single start: its verdict is that of `classify`, its slopes are differences of values."""

import math

import numpy as np
import pytest

import dipoletop as dt
from dipoletop.explorer import curves, drawing, scenes, starts

TOP = scenes.scene_of_top({})
FIGURE_2A = {"delta": -0.2, "w_perp": 0.2, "w3": 0.2, "phi": math.pi / 30}


def test_the_verdict_of_the_start_of_figure_2a():
    found = starts.verdict_of(drawing.Drawing(TOP), dt.Level.ORDER_1, FIGURE_2A, 1e-8)
    omega0 = dt.cylindrical(0.2, 0.2, math.pi / 30)
    verdict = dt.classify(dt.TransverseReduced(-0.2), omega0)
    assert found.omega_inf == pytest.approx(0.09887, abs=5e-6)  # of the paper
    assert found.outcome == "residual"
    assert found.omega_inf == pytest.approx(float(verdict.omega_inf), rel=1e-6)
    assert found.certified == bool(verdict.certified)


@pytest.mark.slow
def test_slopes_are_differences_of_values():
    problem, step = TOP.problem_at(dt.Level.ORDER_1), 1e-4
    slopes = starts.slopes_of(problem, FIGURE_2A, 1e-10)
    moved = np.array([*FIGURE_2A.values()]) + step * np.concatenate([np.eye(4), -np.eye(4)])
    ends = dt.sweep(problem, dt.Points(**dict(zip(FIGURE_2A, moved.T, strict=True))), rtol=1e-10)
    differences = (ends.omega_inf[:4] - ends.omega_inf[4:]) / (2 * step)
    assert slopes == pytest.approx(dict(zip(FIGURE_2A, differences, strict=True)), rel=1e-3)


def test_a_stop_has_its_kind_and_no_slope():
    values = FIGURE_2A | {"w3": 0.55, "phi": 0.1}
    found = starts.verdict_of(drawing.Drawing(TOP), dt.Level.SEMI, values, 1e-8)
    assert found.outcome == "stop, rotating"
    assert found.omega_inf == 0


@pytest.mark.slow
def test_the_motion_loses_energy_and_keeps_a_unit_quaternion():
    found = starts.verdict_of(drawing.Drawing(TOP), dt.Level.SEMI, FIGURE_2A, 1e-8)
    motion = starts.motion_of(TOP.problem_at(dt.Level.SEMI), FIGURE_2A, found, 1e-8)
    assert motion.of_body is not None
    assert np.all(np.diff(motion.of_body.energy) < 1e-12)
    np.testing.assert_allclose(np.linalg.norm(motion.of_body.attitude, axis=1), 1, atol=1e-9)
    np.testing.assert_array_equal(
        motion.omega[0], np.asarray(dt.cylindrical(0.2, 0.2, math.pi / 30))
    )
    # Angular velocity from the attitudes of neighbouring frames: 2 q*∘(q₁ − q)/Δτ.
    q, ts = motion.of_body.attitude, motion.ts
    change = (q[2] - q[0]) / (ts[2] - ts[0])
    a, v = q[1, 0], q[1, 1:]
    rate = 2 * (a * change[1:] - change[0] * v - np.cross(v, change[1:]))
    np.testing.assert_allclose(rate, motion.omega[1], rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("speed", [0.0, 1e-3, 0.2, 1.0])
@pytest.mark.parametrize("certain_at", [0.0, 30.0, 1e6, math.nan])
def test_times_increase_and_are_always_as_many(speed, certain_at):
    ts, is_cut = starts.times_of(speed, 0.5 * speed, 0.2 * speed, certain_at)
    assert len(ts) == 2 * starts.FRAMES + starts.BETWEEN
    assert ts[0] == 0
    assert np.all(np.diff(ts) > 0)
    if speed:
        assert np.max(np.diff(ts)) * 0.2 * speed < 0.5  # radians of precession
        assert np.max(np.diff(ts[: starts.FRAMES])) * speed <= 0.5
        assert is_cut == (ts[-1] < certain_at)


def test_the_body_that_is_drawn_has_the_moments():
    inertia = np.diag([1.0, 1.0, 1.2])
    x0, y0, z0, *_ = curves.surface(inertia)
    # Of a homogeneous ellipsoid I₃ = m(a² + b²)/5, and so on.
    a, b, c = (np.max(np.abs(x)) for x in (x0, y0, z0))
    moments = np.array([b**2 + c**2, c**2 + a**2, a**2 + b**2])
    np.testing.assert_allclose(moments / moments[0], [1.0, 1.0, 1.2], rtol=1e-9)
    x0, y0, z0, *_ = curves.surface(np.diag([0.1, 1.0, 1.0]))
    assert np.max(np.abs(x0)) == pytest.approx(1)
    assert np.max(np.abs(y0)) < 0.3
