"""Critical manifold and separatrix of the plane rotator against their equation and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt

SPEEDS = np.logspace(-6, 8, 141)


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


@pytest.mark.slow
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


def test_separatrix_comes_from_rest():
    start = 1e-7
    run = solve_ivp(
        lambda t, y: [y[1], y[1] + y[0] ** 3], (0, 17.0), [start, start], rtol=1e-12, atol=1e-20
    )
    w, rate = run.y[:, -1]
    assert w > 1
    assert abs(rate / float(dt.separatrix(w)) - 1) < 1e-9
