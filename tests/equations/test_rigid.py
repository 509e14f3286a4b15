"""Equations of any body against the equation of motion (3.3) and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import radiation

RNG = np.random.default_rng(11)

# Compiled once for each equation and shape: op by op, a general body takes a second for each start.
rate = eqx.filter_jit(lambda equation, y: equation(0.0, y))


def test_full_equation_is_the_equation_of_motion():
    """IΩ̇ + N = T with Ω̈ from the state's own rate, for a generic body (3.3)."""
    root = RNG.normal(size=(3, 3))
    inertia = root @ root.T + 6 * np.eye(3)
    body = dt.Body(inertia, RNG.normal(size=3))
    equation = dt.Full(body)
    n = body.dipole / jnp.linalg.norm(body.dipole)
    a = jnp.asarray(RNG.normal(size=3))
    y = jnp.concatenate([jnp.asarray(RNG.normal(size=3)), a - jnp.dot(a, n) * n])
    rates = equation(0.0, y)
    rate, second = rates[:3], jax.jvp(lambda y: equation(0.0, y)[:3], (y,), (rates,))[1]
    torque = radiation.radiation_torque(body, y[:3], rate, second)
    left = body.inertia @ rate + radiation.gyroscopic_torque(body, y[:3])
    assert float(jnp.max(jnp.abs(left - torque))) < 1e-11 * float(jnp.max(jnp.abs(torque)))


@pytest.mark.parametrize("order", [1, 2])
def test_general_body_against_finite_differences(order):
    """Order m: Ω̇ and Ω̈ in the torque of (3.3) are those of a motion of the order below.

    Below order 1 lies free rotation, (3.4).
    """
    body = dt.Body(np.diag([1.0, 1.3, 2.0]), [0.6, 0.0, 0.8])
    w = jnp.array([0.3, -0.4, 0.5])

    def lower(y):
        if order == 2:
            return rate(dt.Reduced(body), y)
        return -jnp.linalg.solve(body.inertia, radiation.gyroscopic_torque(body, y))

    h = 1e-4
    slopes = [lower(w + s * h * lower(w)) for s in (-1, 1)]
    second = (slopes[1] - slopes[0]) / (2 * h)
    free = -radiation.gyroscopic_torque(body, w)
    found = jnp.linalg.solve(
        body.inertia, free + radiation.radiation_torque(body, w, lower(w), second)
    )
    assert float(jnp.max(jnp.abs(found - rate(dt.Reduced(body, order=order), w)))) < 1e-8


def test_the_semi_reduced_rate_balances_the_torques():
    """IΩ̇ + N = T(Ω, Ω̇, Ω̈) with Ω̈ of free rotation, for dipoles along no axis, by NumPy."""
    rng = np.random.default_rng(7)
    for _ in range(5):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inertia = axes @ np.diag([1.0, 1.3, 1.8]) @ axes.T
        d, omega = rng.normal(size=3), rng.normal(size=3)
        body = dt.Body(inertia, d)
        rate = np.asarray(dt.SemiReduced(body)(0.0, jnp.asarray(omega)))
        load = np.cross(omega, inertia @ omega)
        first = -np.linalg.solve(inertia, load)
        turned = np.cross(first, inertia @ omega) + np.cross(omega, inertia @ first)
        second = -np.linalg.solve(inertia, turned)
        third = np.cross(d, omega @ omega * omega - second)
        third += d @ rate * omega + 2 * (d @ omega) * rate
        np.testing.assert_allclose(inertia @ rate + load, np.cross(d, third), atol=1e-12)
