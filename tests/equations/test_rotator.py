"""Plane rotator: the critical manifold, the separatrix, the four domains, runaways."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import dipoletop as dt

SPEEDS = np.logspace(-6, 8, 141)
FULL = dt.RotatorFull()


@pytest.fixture(scope="module")
def curves():
    """f, f′, g, g′ at SPEEDS, compiled once."""

    def both(w):
        one = jnp.ones_like(w)
        return (
            *jax.jvp(dt.critical_manifold, (w,), (one,)),
            *jax.jvp(dt.separatrix, (w,), (one,)),
        )

    return [np.asarray(x) for x in jax.jit(both)(SPEEDS)]


@pytest.mark.parametrize(
    ("w", "f"),
    [
        (0.1, -0.00097215149697444904),
        (0.3, -0.022428220160021891),
        (1.0, -0.4734467160950165281),
        (10.0, -67.523066735607424581),
    ],
)
def test_tabulated_values(w, f):
    assert abs(float(dt.critical_manifold(w)) / f - 1) < 1e-14
    assert float(dt.critical_manifold(-w)) == -float(dt.critical_manifold(w))


def test_both_curves_solve_their_equation(curves):
    """ϖϖ′ = ϖ + ω³, from 1e-6 to 1e8; f runs below the axis, g above."""
    f, slope, g, rise = curves
    cube = SPEEDS**3
    np.testing.assert_allclose(f * slope, f + cube, rtol=0, atol=np.max(1e-14 * cube))
    assert np.all(np.abs(f * slope - f - cube) < 2e-15 * cube)
    assert np.all(np.abs(g * rise - g - cube) < 2e-15 * (g + cube))
    assert np.all(f < 0)
    assert np.all(g > 0)


def test_both_ends_of_the_critical_manifold(curves):
    """−ω³ + 3ω⁵ − 24ω⁷ at 0 (A.16), −ω²/√2 + ω/3 − √2/9 at infinity."""
    f, w = curves[0], SPEEDS
    low, high = w < 3e-3, w > 1e5
    series = -(w**3) + 3 * w**5 - 24 * w**7
    assert np.all(np.abs(f - series)[low] < 300 * w[low] ** 9 + 1e-15 * w[low] ** 3)
    gap = f + w**2 / np.sqrt(2) - w / 3
    assert np.all(np.abs(gap + np.sqrt(2) / 9)[high] < 1e-15 * w[high] ** 2)
    assert abs(float(dt.critical_manifold(1e3)) + 1e6 / 2**0.5 - 1e3 / 3 + 2**0.5 / 9) < 1e-3


def test_derivatives():
    assert float(jax.grad(dt.critical_manifold)(0.0)) == 0
    assert float(jax.grad(dt.separatrix)(0.0)) == 1
    h = 1e-4
    slope = jax.grad(dt.critical_manifold)
    for w in (0.05, 0.4, 3.0):
        second = (slope(w + h) - slope(w - h)) / (2 * h)
        assert abs(float(jax.grad(slope)(w) / second) - 1) < 1e-6


def test_closed_approximation():
    """−ω³/√(1 + 2ω²): 22 % too large at 1, and G′ is its inverse."""
    ratio = float(dt.closed_manifold(1.0) / dt.critical_manifold(1.0))
    assert abs(ratio - 1.22) < 0.005
    for w in (0.03, 1.0, 40.0):
        inverse = float(jax.grad(dt.exact.rotator_closed_time)(w))
        assert abs(inverse * float(dt.closed_manifold(w)) - 1) < 1e-14


def test_lyapunov_function():
    """V′ = ϖ² + ω⁴ along the motion."""
    states = jnp.asarray(np.random.default_rng(3).normal(size=(2, 50)))
    rate = jax.jvp(FULL.lyapunov, (states,), (FULL(0.0, states),))[1]
    np.testing.assert_allclose(rate, states[1] ** 2 + states[0] ** 4, rtol=1e-13)


def ending(state, direction):
    """The sign of ω when it has become large, by another integrator."""

    def large(t, y):
        return abs(y[0]) - 30

    large.terminal = True
    run = solve_ivp(
        lambda t, y: direction * np.array([y[1], y[1] + y[0] ** 3]),
        (0, 1e4),
        state,
        events=large,
        rtol=1e-9,
        atol=1e-12,
    )
    return np.sign(run.y[0, -1])


def test_four_domains():
    found = set()
    for w, rate in itertools.product((-1.2, -0.3, 0.4, 1.1), (-1.5, -0.2, 0.1, 1.6)):
        domain = FULL.domain(jnp.array([w, rate]))
        signs = int(domain.past), int(domain.future)
        assert signs == (ending((w, rate), -1), ending((w, rate), 1))
        found.add(signs)
    assert len(found) == 4
    on_both = FULL.domain(jnp.stack([jnp.array([0.5, 0.5]), jnp.array([0.0, 0.0])]))
    assert on_both.past.tolist() == [1, 1]
    assert FULL.domain(FULL.lift(jnp.array([0.0, 0.0, 0.7]))).future == 0
    assert FULL.domain(jnp.stack([jnp.asarray(0.7), dt.separatrix(0.7)])).past == 0


def test_separatrix_comes_from_rest():
    start = 1e-7
    run = solve_ivp(
        lambda t, y: [y[1], y[1] + y[0] ** 3], (0, 17.0), [start, start], rtol=1e-12, atol=1e-20
    )
    w, rate = run.y[:, -1]
    assert w > 1
    assert abs(rate / float(dt.separatrix(w)) - 1) < 1e-9


def test_a_runaway_says_when_it_blows_up():
    state = (1.0, 0.0)
    run = dt.classify(FULL, jnp.array(state))
    assert run.outcome == dt.Outcome.FAILED
    # Time as an integral over ω needs only the motion up to a large ω, and √2/ω from there (A.5).
    large = 1e4
    path = solve_ivp(
        lambda s, y: [(1 + np.exp(3 * s) / y[0]) * np.exp(s), np.exp(s) / y[0]],
        (np.log(1.5), np.log(large)),
        [*_at(state, 1.5)],
        rtol=1e-12,
        atol=1e-13,
    )
    expected = path.y[1, -1] + np.sqrt(2) / large
    assert abs(float(run.time) - expected) < 1e-7


def _at(state, speed):
    """(ϖ, τ) where the motion from `state` first has that ω."""

    def there(t, y):
        return y[0] - speed

    there.terminal = True
    run = solve_ivp(
        lambda t, y: [y[1], y[1] + y[0] ** 3], (0, 9), state, events=there, rtol=1e-12, atol=1e-13
    )
    return run.y[1, -1], run.t[-1]


def test_the_physical_branch_is_followed():
    """τ = −∫dω/f, and every reduced route to the same motion stops."""
    start = jnp.array([0.0, 0.0, 0.8])
    run = dt.simulate(FULL, start, jnp.array([0.0, 20.0, 500.0]))
    assert run.level == "full"
    for time, w in zip(run.ts[1:], run.omega[1:, 2], strict=True):
        found = quad(lambda x: -1 / float(_f(x)), float(w), 0.8, epsrel=1e-10)[0]
        assert abs(found / float(time) - 1) < 1e-8
    for equation in (FULL, dt.RotatorReduced()):
        ended = dt.classify(equation, start)
        assert (int(ended.outcome), int(ended.stop)) == (dt.Outcome.STOP, dt.Stop.AXIS)
        assert ended.certified
    rate, error = dt.slow_manifold(FULL, start, with_error=True)
    np.testing.assert_allclose(rate, [0, 0, float(dt.critical_manifold(0.8))], rtol=1e-14)
    assert 0 < error < 1e-13


_f = jax.jit(dt.critical_manifold)


def test_refusals():
    with pytest.raises(ValueError, match=r"`omega0` must lie along axis 3"):
        dt.simulate(FULL, jnp.array([0.1, 0.0, 0.5]), jnp.array([0.0, 1.0]))
    with pytest.raises(ValueError, match=r"`w` must be a real"):
        dt.critical_manifold("a")
    assert jnp.isnan(dt.critical_manifold(jnp.nan))
