"""Cylindrical, averaged and linearised forms of order 1, each from the form it approximates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt

RNG = np.random.default_rng(11)
DELTAS = jnp.asarray(np.concatenate([[-1.0, -0.5, 0.0], RNG.uniform(-1, 0.95, 5)]))
OMEGAS = jnp.asarray(RNG.normal(size=(3, 8)))


def test_cylindrical_form_is_the_cartesian_one():
    """d(ω⊥, ω₃, φ)/dτ by the chain rule from (4.2)–(4.4)."""
    for delta, w in zip(DELTAS, OMEGAS.T, strict=True):
        form, flat = dt.TransverseCylindrical(delta), dt.TransverseReduced(delta)
        expected = jax.jvp(form.lift, (w,), (flat(0.0, w),))[1]
        assert jnp.allclose(form(0.0, form.lift(w)), expected, rtol=1e-12, atol=1e-13)
        assert jnp.allclose(form.omega(form.lift(w)), w, rtol=1e-14)


def test_averaged_form_is_the_mean_over_the_angle():
    """(4.13)–(4.15): a trapezoidal mean over φ is exact for these harmonics."""
    angles = jnp.linspace(0, 2 * jnp.pi, 16, endpoint=False)
    for delta in DELTAS:
        states = jnp.stack([jnp.full(16, 0.7), jnp.full(16, -0.4), angles])
        mean = jnp.mean(dt.TransverseCylindrical(delta)(0.0, states), axis=1)
        averaged = dt.TransverseAveraged(delta)(0.0, jnp.array([0.7, -0.4, 0.1]))
        assert jnp.allclose(mean, averaged, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    "start",
    [(1.0, 1.0), *(pytest.param(x, marks=pytest.mark.slow) for x in ((0.1, -1.0), (1.0, 0.2)))],
)
def test_averaged_system_has_its_exact_solution(start):
    """`exact.averaged`, differentiated, obeys (4.13)–(4.15) over eleven decades of τ."""
    times, start = jnp.array([0.0, 0.1, 3.0, 1e3, 1e8]), dt.cylindrical(*start, 0.3)

    @jax.jit
    def solution(delta):
        return jax.jvp(lambda t: dt.exact.averaged(delta, start, t), (times,), (jnp.ones(5),))

    for delta in (-1.0, -0.9, -0.55, -0.5, -0.3, 0.0, 0.2, 0.9):
        omega, rate = map(np.asarray, solution(delta))
        np.testing.assert_allclose(omega[0], start, rtol=1e-14)
        equation = dt.TransverseAveraged(delta)
        y = equation.lift(jnp.asarray(omega.T))
        expected = np.asarray(jax.jvp(equation.omega, (y,), (equation(0.0, y),))[1]).T
        scale = np.max(np.abs(expected), axis=1, keepdims=True)
        np.testing.assert_allclose(rate / scale, expected / scale, rtol=0, atol=1e-11)


def test_linearised_form_is_the_derivative():
    """(4.22)–(4.24): the Jacobian of (4.9)–(4.11) at (w, 0, 0)."""
    w, y = 0.3, jnp.array([0.02, -0.03, 0.05])
    for delta in (-0.9, -0.5, 0.4):
        jacobian = jax.jacfwd(dt.TransverseCylindrical(delta), 1)(0.0, jnp.array([w, 0.0, 0.0]))
        assert jnp.allclose(dt.TransverseLinearised(delta, w)(0.0, y), jacobian @ y, atol=1e-16)
