"""Torques from outside along the physical branch: closed forms, other integrators, balances.

Small rotations about axis 3 of a sphere under M = γω obey ω″ = ω′ − γω: the physical motion is
e^{λτ}, 2λ = 1 − √(1 − 4γ), and the branch ends at γ = 1/4.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop import Outcome, torques

SPHERE = dt.TransverseFull(0.0)
SMALL = 1e-6


def rate(gamma):
    """λ, the smaller root of λ² − λ + γ = 0."""
    return (1 - (1 - 4 * gamma) ** 0.5) / 2


@functools.partial(eqx.filter_jit)
def driven(gamma, w3, ts, rtol):
    """ω₃ at some times, and Ω̇₃ at the first, under M = γω."""
    equation = torques.with_torque(SPHERE, torques.drag(-gamma))
    start = jnp.stack([0.0 * w3, 0.0 * w3, w3])
    run = dt.simulate(equation, start, ts, rtol=rtol, throw=False)
    return run.omega[:, 2]


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [0.1, -0.5, -1.9])
@pytest.mark.parametrize("rtol", [1e-6, 1e-10, 1e-12])
def test_small_rotations_follow_the_closed_form(gamma, rtol):
    """Also where the levels that give the end value diverge, γ < −1/4."""
    ts = np.linspace(0.0, 20.0, 5)
    found = driven(jnp.asarray(gamma), jnp.asarray(SMALL), jnp.asarray(ts), jnp.asarray(rtol))
    rounding = 2e-9 if gamma > 0 else 1e-11  # ω³ counts where a torque makes ω grow
    np.testing.assert_allclose(
        found, SMALL * np.exp(rate(gamma) * ts), rtol=max(3 * rtol, rounding)
    )


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [-2.0, 0.23, 0.245])
def test_where_a_runaway_may_pass_for_the_branch_nothing_is_found(gamma):
    """At γ = −2 all levels agree on the runaway 2; at 0.245 the roots are 0.43 and 0.57."""
    ts = jnp.linspace(0.0, 20.0, 5)
    found = driven(jnp.asarray(gamma), jnp.asarray(SMALL), ts, jnp.asarray(1e-10))
    assert not np.isfinite(found[-1])


@pytest.mark.slow
def test_a_torque_that_drives_to_a_steady_rotation():
    """The bounded motion from rest to ω² = γ, against an integration back from its end."""
    gamma = 0.2
    slow = (1 - np.sqrt(1 + 8 * gamma)) / 2  # of the two roots of λ² = λ + 2γ
    off, w0 = 1e-9, 0.01
    begins = lambda t, y: y[0] - w0  # noqa: E731
    begins.terminal = True
    exact = solve_ivp(
        lambda t, y: [y[1], y[1] - gamma * y[0] + y[0] ** 3],
        (0.0, -200.0),
        [np.sqrt(gamma) - off, -off * slow],
        "DOP853",
        rtol=1e-12,
        atol=1e-16,
        events=begins,
        dense_output=True,
    )
    ts = np.linspace(0.0, 20.0, 5)
    found = driven(jnp.asarray(gamma), jnp.asarray(w0), jnp.asarray(ts), jnp.asarray(1e-10))
    np.testing.assert_allclose(found, exact.sol(exact.t[-1] + ts)[0], rtol=1e-7)


@pytest.mark.slow
def test_the_branch_of_a_drag_has_the_rate_of_the_closed_form():
    equation = torques.with_torque(SPHERE, torques.drag(0.1))
    found, error = dt.slow_manifold(equation, [0.0, 0.0, SMALL], with_error=True)
    np.testing.assert_allclose(found[2] / SMALL, rate(-0.1), rtol=1e-10)
    assert abs(found[2] / SMALL - rate(-0.1)) <= error / SMALL + 1e-12


# Torques in time


def wave(t, omega):
    """A torque about axis 3."""
    return jnp.stack([0 * t, 0 * t, 0.01 * jnp.sin(0.5 * t)])


WAVE = torques.with_torque(dt.TransverseFull(0.2), wave)
START = [0.1, 0.1, 0.1]


@pytest.mark.slow  # compiles for long
def test_derivatives_by_the_first_time_and_by_a_torque():
    """Of a batch, against differences of order 6."""

    def end(x):
        equation = torques.with_torque(dt.TransverseFull(0.2), Partial(scaled, x[1]))
        times = jnp.stack([x[0], jnp.asarray(9.0)])
        return dt.simulate(equation, START, times).omega[-1, 2]

    def scaled(size, t, omega):
        return size * wave(t, omega)

    points, way, h = jnp.array([[1.0, 1.0], [2.0, 0.5]]), jnp.array([1.0, 0.3]), 4e-3
    slopes = jax.vmap(jax.grad(end))(points) @ way
    moves = h * jnp.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
    ends = jax.jit(end)
    for point, slope in zip(points, slopes, strict=True):
        around = jnp.stack([ends(point + move * way) for move in moves])
        differences = np.array([-1, 9, -45, 45, -9, 1]) / (60 * h) @ around
        np.testing.assert_allclose(slope, differences, rtol=1e-7)


@pytest.mark.slow
def test_the_rate_on_the_branch_at_a_time():
    run = dt.simulate(WAVE, START, [1.0, 2.0])
    np.testing.assert_allclose(
        dt.slow_manifold(WAVE, START, time=1.0), run.omega_dot[0], rtol=1e-7, atol=1e-10
    )
    assert abs(dt.slow_manifold(WAVE, START)[2] - run.omega_dot[0, 2]) > 1e-3


@pytest.mark.slow  # compiles for long
def test_the_rate_on_the_branch_has_a_derivative_by_the_time():
    def rates(time):
        return dt.slow_manifold(WAVE, START, time=time)

    h = 4e-3
    around = np.array([rates(1.0 + k * h) for k in (-3, -2, -1, 1, 2, 3)])
    differences = np.array([-1, 9, -45, 45, -9, 1]) / (60 * h) @ around
    np.testing.assert_allclose(jax.jacfwd(rates)(1.0), differences, rtol=1e-7, atol=1e-10)


@pytest.mark.slow
def test_radiated_energy_and_work_over_several_windows():
    """E − d₁·d₂ + ∫(|d₂|² − ω·M)dτ is constant, whatever the time at which the run begins."""
    ts = jnp.linspace(7.0, 150.0, 30)
    run = dt.simulate(WAVE, START, ts, balance=True)
    assert run.stats["num_steps"] > 3
    assert float(jnp.max(jnp.abs(run.balance_defect))) < 1e-9
    powers = run.omega[:, 2] * 0.01 * jnp.sin(0.5 * ts)
    rough = jnp.trapezoid(powers, ts)
    np.testing.assert_allclose(run.work[-1], rough, rtol=0.2)  # 30 times only
    assert abs(run.work[-1]) > 1e-3


@pytest.mark.slow  # compiles for long
def test_half_of_the_energy_is_lost_in_a_later_window():
    """I₁ω₁′ = −γ(1 + ½ sin ½τ)ω₁ along the dipole, where nothing radiates."""
    gamma = 0.004

    def uneven(gamma, t, omega):
        return jnp.stack([-gamma * (1 + 0.5 * jnp.sin(0.5 * t)) * omega[0], 0 * t, 0 * t])

    def rests(y):
        still = y[0] ** 2 < 1e-4
        return jnp.where(still, int(Outcome.STOP), 0), jnp.zeros_like(y[0]), still & False

    def time(gamma):
        torque = Partial(uneven, gamma)
        equation = torques.with_torque(dt.TransverseFull(0.3), torque, verdict=rests)
        return dt.decay_time(equation, [0.2, 0.0, 0.0], 0.5)

    found, slope = (float(x) for x in jax.value_and_grad(time)(gamma))
    reached = found + 1 - np.cos(0.5 * found)  # ln(ω₀/ω)/γ
    np.testing.assert_allclose(2 * gamma * reached, np.log(2), rtol=1e-8)
    speed = gamma * (1 + 0.5 * np.sin(0.5 * found))
    np.testing.assert_allclose(slope, -reached / speed, rtol=1e-7)
