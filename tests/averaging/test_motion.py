"""Slow motions: against quadrature in extended precision, closed limits, and an integration."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dipoletop._averaging.free_rotation import averages
from dipoletop._averaging.motion import motion_from
from dipoletop._averaging.slow_flow import FARTHEST, Side

MOMENTS = (0.616, 0.634, 1.0)
LOW = jnp.asarray(False)

# Compiled once for all tests.
motion_of = jax.jit(motion_from)
rates_at = eqx.filter_jit(Side.rates)
slope_at = jax.jit(jax.value_and_grad(lambda z, side: side.growth(z)))
each_point = jax.jit(jax.vmap(lambda motion, log: motion.at(log), (None, 0)))


def _side(axis, high=False):
    """The slow flow with the dipole on the principal axis 0, 1 or 2."""
    order = slice(None, None, -1) if high else slice(None)
    return Side(jnp.array(MOMENTS)[order], jnp.eye(3)[axis][order])


def _textbook(h, p1, p2, p3):
    """The mean f of a dipole along axis 3 on the low side, from E(m)/K(m)."""
    m = (p1 - p2) * (h - p3) / ((p2 - p3) * (p1 - h))
    w = mp.ellipe(m) / mp.ellipk(m)
    y = (
        h**2 * (2 * p1 * p2 - p1 * p3 - p2 * p3)
        + h * (-2 * p1**2 * p2 + 2 * p1**2 * p3 - 2 * p1 * p2**2 - p1 * p2 * p3 + 2 * p2**2 * p3)
        + p1**2 * p2**2
        - p1**2 * p3**2
        + 2 * p1 * p2 * p3**2
        - p2**2 * p3**2
    )
    return -(p1 - h) * (p2 - h) * (p1 * p2 - h * (p1 + p2)) + w * (p1 - h) * y / (p1 - p3)


def test_the_rate_of_h_is_that_of_the_textbook_form():
    with mp.workdps(40):
        p1, p2, p3 = (1 / mp.mpf(j) for j in MOMENTS)
        for x in (0.01, 0.4, 0.9):
            _, growth = rates_at(_side(2), jnp.asarray(x), jnp.asarray(1 - x))
            exact = _textbook(p3 + mp.mpf(x) * (p2 - p3), p1, p2, p3)
            assert abs(float(growth) * x * float(p2 - p3) / float(exact) - 1) < 1e-13


def test_the_loss_of_angular_momentum_is_an_integral_over_x():
    """ln L∞²/L₀² = −∫ r/(x F) dx from the start to the dipole's own axis."""
    points, weights = np.polynomial.legendre.leggauss(20)
    z = np.arange(-42, 2)[:, None] + (points + 1) / 2
    x = 1 / (1 + np.exp(-z))
    moments = np.broadcast_to(np.array(MOMENTS)[:, None, None], (3, *x.shape))
    r, growth = (np.asarray(mean)[2] for mean in jax.jit(averages)(moments, x, 1 - x))
    exact = np.sum(r / growth * (1 - x) * weights / 2)
    motion = motion_of(_side(2), LOW, jnp.asarray(2.0))
    assert not motion.crosses
    assert abs(float(motion.final.end.log) / float(exact) - 1) < 3e-12


@pytest.mark.parametrize(("axis", "high", "z"), [(2, True, 0.5), (1, False, -3.0)])
def test_the_motion_in_time_is_that_of_the_rates(axis, high, z):
    """Against an integration of x and ln L² over t on each side of the separatrix."""
    motion = motion_of(_side(axis, high), jnp.asarray(high), jnp.asarray(z))
    crossing = np.exp(float(motion.stage(0).end.log_time)) if motion.crosses else np.inf
    sides = {side: _side(axis, side) for side in (False, True)}

    def field(t, state, side):
        x, log = state
        r, growth = rates_at(sides[side], jnp.asarray(x), jnp.asarray(1 - x))
        return [float(x * growth) * np.exp(log), -float(r) * np.exp(log)]

    x0, side = 1 / (1 + np.exp(-z)), high
    times = np.array([0.01, 0.3, 0.9]) * min(crossing, 30.0)
    points = each_point(motion, jnp.asarray(np.log(times)))
    settings = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "t_eval": times}
    run = solve_ivp(field, (0, times[-1]), [x0, 0.0], args=(side,), **settings)
    assert np.all(np.asarray(points.high) == high)
    np.testing.assert_allclose(points.x, run.y[0], rtol=1e-9)
    np.testing.assert_allclose(points.log, run.y[1], rtol=1e-9)
    if motion.crosses:  # beyond, from a point next to the separatrix
        times = crossing * np.array([1.1, 1.5, 4.0])
        points = each_point(motion, jnp.asarray(np.log(times)))
        assert np.all(np.asarray(points.high) != high)
        settings["t_eval"] = span = times[1:] - times[0]
        start = [float(points.x[0]), float(points.log[0])]
        run = solve_ivp(field, (0, span[-1]), start, args=(not high,), **settings)
        np.testing.assert_allclose(points.x[1:], run.y[0], rtol=1e-8)
        np.testing.assert_allclose(points.log[1:], run.y[1], rtol=1e-8)


def test_rates_at_the_axes_have_their_closed_limits():
    """The dipole on c: F = −Db⁻¹-free limit f′; on a: r = p_c³."""
    ja, jb, jc = MOMENTS
    slope = -(jc * (ja + jb) - (ja - jb) ** 2) / (2 * ja**2 * jb**2 * jc)
    assert abs(float(slope_at(-FARTHEST, _side(2))[0]) / slope - 1) < 1e-13
    for axis, (a, b) in ((0, (ja, jb)), (1, (jb, ja))):
        r, growth = rates_at(_side(axis), jnp.asarray(0.0), jnp.asarray(1.0))
        slope = (a * b**2 - (jc - a) * (jc - b) ** 2) / (2 * a * b**2 * jc**3)
        assert abs(float(r) - 1 / jc**3) < 1e-14
        assert abs(float(growth) / slope - 1) < 1e-12


def test_a_tumbling_attractor_is_a_stable_zero():
    side = _side(1)
    motion = motion_of(side, LOW, jnp.asarray(3.0))
    limit, other = motion.final.limit, motion.final.interval.high
    assert limit.is_zero
    assert not other.is_zero
    zero = np.log(limit.x) - np.log(limit.rest)
    growth, slope = slope_at(float(zero), side)
    assert abs(float(growth)) < 1e-15
    assert float(slope) < 0
    points = each_point(motion, jnp.array([100.0, 200.0, 300.0]))
    x, rest, log = (getattr(points, name)[-1] for name in ("x", "rest", "log"))
    r, _ = rates_at(side, x, rest)
    assert abs(np.log(float(x) / float(rest)) - zero) < 1e-9
    assert abs(float(log) + 300 + np.log(float(r))) < 1e-9  # L² t → 1/(2κr*)


def test_an_attractor_that_is_approached_slowly_is_no_stiff_problem():
    """L² falls by far more than x changes: against an implicit method for x and 2κL²t over ln t."""
    moments = (0.4965426, 0.5121136, 1.0)  # next to those whose attractor is the axis of J₃
    side = Side(jnp.array(moments), jnp.eye(3)[1])
    motion = motion_of(side, LOW, jnp.asarray(-2.0))
    assert not motion.failed

    def field(_, state):
        x, u = state
        r, growth = rates_at(side, jnp.asarray(x), jnp.asarray(1 - x))
        return [u * x * float(growth), u - float(r) * u**2]

    times, first = np.array([0.0, 4.0, 16.0]), each_point(motion, jnp.array([-6.0] * 3))
    start = [float(first.x[0]), np.exp(float(first.log[0]) - 6.0)]
    run = solve_ivp(field, (-6, times[-1]), start, "Radau", times, rtol=1e-8, atol=1e-12)
    points = each_point(motion, jnp.asarray(times))
    np.testing.assert_allclose(points.x, run.y[0], rtol=1e-5)
    np.testing.assert_allclose(np.exp(points.log + times), run.y[1], rtol=1e-5)
