"""Exact solutions: put into their equations, and against the paper's forms at 30 digits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

import dipoletop as dt

TIMES = jnp.array([0.0, 1e-3, 0.4, 7.0, 300.0])
LATE = np.array([0.1, 1.0, 1e3, 1e8])
averaged, longitudinal = jax.jit(dt.exact.averaged), jax.jit(dt.exact.longitudinal)
averaged_late, exponents = jax.jit(dt.exact.averaged_late), jax.jit(dt.exact.longitudinal_exponents)
rotator = jax.jit(dt.exact.rotator)


def solves(equation, solution, *, start):
    """Whether dω/dτ of a solution, by forward differentiation, is what the equation says."""
    motion = jax.jit(lambda t: jax.jvp(solution, (t,), (jnp.ones_like(t),)))
    value, rate = map(np.asarray, motion(TIMES))
    np.testing.assert_allclose(value[0], start, rtol=1e-15)
    expected = np.asarray(eqx.filter_jit(equation)(0.0, value.T))
    scale = np.max(np.abs(expected), axis=0)
    assert np.all(np.abs(np.moveaxis(rate, -1, 0) - expected) <= 1e-13 * scale)


def test_rotator():
    solves(dt.RotatorReduced(), lambda t: dt.exact.rotator(-0.7, t)[:, None], start=[-0.7])
    assert abs(float(dt.exact.rotator(1e-25, 1.5e50)) / 5e-26 - 1) < 1e-14


@pytest.mark.parametrize("delta", [-1.0, -0.3, 0.0, 0.8])
@pytest.mark.parametrize("start", [(0.3, -0.4, 0.5), (0.2, 0.1, 0.0), (1e-3, 0.0, 2.0)])
def test_longitudinal(delta, start):
    def solution(t):
        return dt.exact.longitudinal(delta, np.array(start), t)

    solves(dt.LongitudinalReduced(delta), solution, start=start)


@pytest.mark.parametrize(("delta", "w3"), [(-0.5, 0.4), (0.5, 1e-7), (0.9, 1.0)])
def test_longitudinal_as_the_paper_has_it(delta, w3):
    """(3.11): ω⊥ = s/√((1 + s²/u₀)e^{2s²τ} − 1), at 30 digits."""
    found = np.asarray(longitudinal(delta, np.array([0.3, 0.4, w3]), TIMES))
    with mp.workdps(50):
        s = (1 - mp.mpf(delta)) * mp.mpf(w3)
        for t, w in zip(TIMES.tolist(), np.hypot(found[:, 0], found[:, 1]), strict=True):
            expected = s / mp.sqrt((1 + 4 * s**2) * mp.e ** (2 * s**2 * t) - 1)
            assert abs(w / expected - 1) < 5e-14


def test_longitudinal_limits():
    """A rod, and ω₃ = 0: the rotator (3.13)."""
    braked = rotator(0.5, TIMES)
    for delta, w3 in ((1.0, 0.4), (0.3, 0.0)):
        found = np.asarray(longitudinal(delta, np.array([0.3, 0.4, w3]), TIMES))
        np.testing.assert_allclose(np.hypot(found[:, 0], found[:, 1]), braked, rtol=1e-15)


def test_longitudinal_exponents():
    """(2α−1)²α(α−1) = s², the series of α₋ and B, and the spectrum of the full equation."""
    jacobian = jax.jit(jax.jacfwd(lambda y, delta: dt.LongitudinalFull(delta)(0.0, y)))
    for delta, w3 in ((0.4, 1e-6), (-0.7, 0.3), (0.2, 5.0)):
        s = mp.mpf(1 - delta) * mp.mpf(w3)
        below, above, turn = (float(x) for x in exponents(delta, w3))
        with mp.workdps(40):
            for found, sign in ((below, -1), (above, 1)):
                root = mp.sqrt((1 + mp.sqrt(1 + 16 * s**2)) / 2)
                assert abs(found / ((1 + sign * root) / 2) - 1) < 1e-14
            assert abs((2 * below - 1) ** 2 * below * (below - 1) / s**2 - 1) < 1e-14
        rotation = np.array([0.0, 0.0, w3, 0.0, 0.0])
        rates = np.linalg.eigvals(np.asarray(jacobian(rotation, delta)))
        assert np.min(np.abs(rates - complex(below, turn - w3))) < 1e-14 * max(1, w3)
        assert np.min(np.abs(rates - complex(above, -turn - w3))) < 1e-14 * max(1, 30 * w3)
    below, _, turn = (float(x) for x in exponents(0.0, 0.01))
    assert abs(below + 0.01**2 - 5 * 0.01**4 + 42 * 0.01**6) < 1e-13
    assert abs(turn - 0.01 + 2 * 0.01**3 - 14 * 0.01**5) < 2e-12


@pytest.mark.parametrize(
    ("delta", "start"),
    [
        (-0.3, (0.03, 0.4, 0.0)),  # (4.5)
        (0.6, (0.0, -0.4, 0.0)),
        (0.6, (0.0, 0.0, 0.7)),  # (4.6)
        (0.0, (0.03, 0.24, 0.32)),  # a sphere
    ],
)
def test_transverse(delta, start):
    def solution(t):
        return dt.exact.transverse(delta, np.array(start), t)

    solves(dt.TransverseReduced(delta), solution, start=start)


@pytest.mark.parametrize("delta", [-1.0, -0.5, 0.0])
def test_there_is_no_jump_next_to_where_exponents_degenerate(delta):
    """The averaged equation is solved there, too: see `test_transverse_approximations`."""
    there, nearby = (averaged(d, np.array([1.0, 0.0, 0.7]), LATE) for d in (delta, delta + 1e-12))
    np.testing.assert_allclose(nearby[:, 2], there[:, 2], rtol=1e-9)


def test_averaged_on_the_axes_and_at_the_fixed_ratio():
    on_axis = averaged(-0.3, np.array([0.0, 0.0, -0.6]), LATE)
    np.testing.assert_allclose(on_axis[:, 2], -0.6 / np.sqrt(1 + 0.72 * LATE / 1.3), rtol=1e-14)
    across = averaged(-0.3, np.array([0.6, 0.0, 0.0]), LATE)
    np.testing.assert_allclose(across[:, 0], 0.6 / np.sqrt(1 + 0.36 * LATE), rtol=1e-14)
    ratio = (1 - 0.75**3) / 0.5  # ξ* of δ = −3/4
    stays = np.asarray(averaged(-0.75, np.array([np.sqrt(ratio), 0.0, 1.0]), LATE))
    u, v = stays[:, 0] ** 2 + stays[:, 1] ** 2, stays[:, 2] ** 2
    np.testing.assert_allclose(u / v, ratio, rtol=1e-12)
    np.testing.assert_allclose(1 / v, 1 + LATE * (1.25 * ratio + 2) / 1.75, rtol=1e-12)


def test_averaged_time_is_the_inverse():
    start = np.array([0.5, 0.0, 0.4])
    time_of = jax.jit(dt.exact.averaged_time)
    for delta in (-0.8, -0.2, 0.5):
        w = np.asarray(averaged(delta, start, LATE))[1]
        xi = (w[0] ** 2 + w[1] ** 2) / w[2] ** 2
        assert abs(float(time_of(delta, start, xi)) - 1) < 1e-12


@pytest.mark.parametrize("delta", [-1.0, -0.8, -0.5, -0.2, 0.0, 0.3])
def test_late_averaged_motion(delta):
    """(4.20), (4.21) and the two logarithms that are missing in the paper."""
    start = np.array([1.0, 0.0, 0.7])
    times = np.array([1e8, 1e30, 1e100, 1e250])
    found = np.asarray(averaged(delta, start, times))
    u, v = found[:, 0] ** 2 + found[:, 1] ** 2, found[:, 2] ** 2
    late = np.asarray(averaged_late(delta, start, times))
    v_ratio = np.divide(v, late[1], out=np.ones(4), where=v > 0)
    for gap in (np.abs(u / late[0] - 1), np.abs(v_ratio - 1)):
        if delta in (-1.0, -0.5):  # the next term falls like ln ln τ/ln τ
            assert gap[0] < 0.2
            assert np.all(gap[2:] < 0.02)
        else:
            assert np.all(gap < (0.03, 1e-5, 1e-12, 1e-12))


def test_late_rotator():
    """(A.4) with its logarithm: the remainder falls like 1/τ."""
    f = jax.jit(dt.critical_manifold)
    remainders, time = [], 0.0
    for high, low in ((0.5, 0.02), (0.02, 0.01), (0.01, 0.005)):
        time += quad(lambda s: float(-np.exp(s) / f(np.exp(s))), np.log(low), np.log(high))[0]
        remainders.append((low / float(dt.exact.rotator_late(time)) - 1) * time)
    assert abs(remainders[2] - remainders[1]) < 0.01
    assert abs(remainders[2]) < 5


def test_of_traced_bad_times_nothing_is_known():
    start = np.array([0.1, 0.2, 0.3])
    assert np.all(np.isnan(averaged(0.5, start, np.array([-1.0, np.nan]))))
