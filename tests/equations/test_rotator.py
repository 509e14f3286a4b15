"""Plane rotator: the four domains, runaways, the physical branch."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import dipoletop as dt

FULL = dt.RotatorFull()


def test_lyapunov_function():
    """V′ = ϖ² + ω⁴ along the motion."""
    states = jnp.asarray(np.random.default_rng(3).normal(size=(2, 50)))
    rate = jax.jvp(FULL.lyapunov, (states,), (FULL(0.0, states),))[1]
    np.testing.assert_allclose(rate, states[1] ** 2 + states[0] ** 4, rtol=1e-13)


def until_large(state, size, direction=1):
    """Time and state when |ω| has grown to a size, by another integrator."""

    def large(t, y):
        return abs(y[0]) - size

    large.terminal = True
    run = solve_ivp(
        lambda t, y: direction * np.array([y[1], y[1] + y[0] ** 3]),
        (0, 1e4),
        state,
        events=large,
        rtol=1e-11,
        atol=1e-12,
    )
    return run.t[-1], run.y[:, -1]


def sign_in(direction, state):
    """The sign of ω when it has become large."""
    return np.sign(until_large(state, 30, direction)[1][0])


def test_four_domains():
    found = set()
    for w, rate in itertools.product((-1.2, -0.3, 0.4, 1.1), (-1.5, -0.2, 0.1, 1.6)):
        domain = FULL.domain(jnp.array([w, rate]))
        signs = int(domain.past), int(domain.future)
        assert signs == (sign_in(-1, (w, rate)), sign_in(1, (w, rate)))
        found.add(signs)
    assert len(found) == 4
    on_both = FULL.domain(jnp.stack([jnp.array([0.5, 0.5]), jnp.array([0.0, 0.0])]))
    assert on_both.past.tolist() == [1, 1]
    assert FULL.domain(FULL.lift(jnp.array([0.0, 0.0, 0.7]))).future == 0
    assert FULL.domain(jnp.stack([jnp.asarray(0.7), dt.separatrix(0.7)])).past == 0


def test_a_runaway_says_when_it_blows_up():
    state, large = (1.0, 0.0), 1e4
    run = dt.classify(FULL, jnp.array(state))
    assert run.outcome == dt.Outcome.FAILED
    expected = until_large(state, large)[0] + np.sqrt(2) / large  # from there on (A.5)
    assert abs(float(run.time) - expected) < 1e-7


@pytest.mark.slow
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
