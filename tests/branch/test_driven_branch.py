"""Torques from outside along the physical branch: closed forms, other integrators, balances.

Small rotations about axis 3 of a sphere under M = γω obey ω″ = ω′ − γω: the physical motion is
e^{λτ}, 2λ = 1 − √(1 − 4γ), and the branch ends at γ = 1/4.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from branched import Branched
from jax.tree_util import Partial
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop import torques

pytestmark = pytest.mark.slow  # compiles for long
SMALL = 1e-6


def rate_of(gamma):
    """λ, the smaller root of λ² − λ + γ = 0."""
    return (1 - (1 - 4 * gamma) ** 0.5) / 2


def equation_of(delta, gamma, size):
    """M = γω, and a wave about axis 3."""

    def torque(gamma, size, t, omega):
        return gamma * omega + jnp.stack([0 * t, 0 * t, size * jnp.sin(0.5 * t)])

    return torques.with_torque(dt.TransverseFull(delta), Partial(torque, gamma, size))


@eqx.filter_jit
def motion(delta, gamma, size, start, ts, rtol):
    equation = equation_of(delta, gamma, size)
    run = dt.simulate(equation, start, ts, rtol=rtol, throw=False, balance=True)
    return run, run.balance_defect


def driven(gamma, w3, ts, rtol):
    """ω₃ of a sphere under M = γω at some times; always as many, so that it compiles once."""
    given = map(jnp.asarray, (0.0, gamma, 0.0, [0.0, 0.0, w3], ts, rtol))
    return motion(*given)[0].omega[:, 2]


START = [0.1, 0.1, 0.1]


def test_a_wave_sets_a_body_in_motion():
    """I₃ω₃′ = M(τ) + ω₃″ − ω₃³ about axis 3, near rest: ω₃ = Im(A e^{iτ/2}) + a constant."""
    ts, size = np.linspace(0.0, 30.0, 30), 1e-8
    run, _ = motion(*map(jnp.asarray, (0.4, 0.0, size, [0.0, 0.0, 0.0], ts, 1e-10)))
    answer = 1 / ((1 - 0.4) * 0.5j - 0.5j**2)
    exact = (answer * np.exp(0.5j * ts)).imag - answer.imag
    np.testing.assert_allclose(run.omega[:, 2] / size, exact, atol=1e-8)


@pytest.mark.parametrize("gamma", [0.1, -0.5, -1.9])
def test_small_rotations_follow_the_closed_form(gamma):
    """Also where the levels that give the end value diverge, γ < −1/4."""
    ts = np.linspace(0.0, 20.0, 30)
    rounding = 2e-9 if gamma > 0 else 1e-11  # ω³ counts where a torque makes ω grow
    for rtol in (1e-6, 1e-10, 1e-12):
        found, exact = driven(gamma, SMALL, ts, rtol), SMALL * np.exp(rate_of(gamma) * ts)
        np.testing.assert_allclose(found, exact, rtol=max(3 * rtol, rounding))


@pytest.mark.parametrize("gamma", [-2.0, 0.23, 0.245])
def test_where_a_runaway_may_pass_for_the_branch_nothing_is_found(gamma):
    """At γ = −2 all levels agree on the runaway 2; at 0.245 the roots are 0.43 and 0.57."""
    assert not np.isfinite(driven(gamma, SMALL, np.linspace(0.0, 20.0, 30), 1e-10)[-1])


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
    ts = np.linspace(0.0, 20.0, 30)
    found = driven(gamma, w0, ts, 1e-10)
    np.testing.assert_allclose(found, exact.sol(exact.t[-1] + ts)[0], rtol=1e-7)


def test_radiated_energy_and_work_over_several_windows():
    """E − d₁·d₂ + ∫(|d₂|² − ω·M)dτ is constant, whatever the time at which the run begins."""
    ts = np.linspace(7.0, 150.0, 30)
    run, defect = motion(*map(jnp.asarray, (0.2, 0.0, 0.01, START, ts, 1e-10)))
    assert run.stats["num_steps"] > 3
    assert float(jnp.max(jnp.abs(defect))) < 1e-9
    rough = np.trapezoid(run.omega[:, 2] * 0.01 * np.sin(0.5 * ts), ts)
    np.testing.assert_allclose(run.work[-1], rough, rtol=0.2)  # 30 times only
    assert abs(run.work[-1]) > 1e-3


# What depends on time, by an equation of a user's own, which compiles fast


class Uneven(Branched):
    """ω′ = −γω on the branch, γ = g(1 + ½ sin ½τ): the acceleration a obeys (a + γω)′ = a + γω."""

    g: jax.Array
    rest = 0.01

    def gamma(self, t):
        return self.g * (1 + 0.5 * jnp.sin(0.5 * t))

    def __call__(self, t, y, args=None):
        gamma, change = self.gamma(t), self.g * 0.25 * jnp.cos(0.5 * t)
        return jnp.concatenate([y[3:], y[3:] + (gamma - change) * y[:3] - gamma * y[3:]])

    def semi(self, t, w):
        return -self.gamma(t) * w

    def reduced(self, order):
        return self.semi


def test_the_rate_at_a_time_and_its_derivatives():
    def rate(g, time):
        found = dt.slow_manifold(Uneven(g), START, time=time)
        return found, found

    g, time = 0.05, 7.0
    slopes, found = jax.jit(jax.jacfwd(rate, (0, 1), has_aux=True))(g, time)
    by_g = -(1 + 0.5 * np.sin(0.5 * time)) * np.array(START)
    np.testing.assert_allclose(found, g * by_g, rtol=1e-10)
    np.testing.assert_allclose(slopes[0], by_g, rtol=1e-9)
    by_time = -g * 0.25 * np.cos(0.5 * time) * np.array(START)
    np.testing.assert_allclose(slopes[1], by_time, rtol=1e-9)


def test_derivatives_by_the_first_time_and_by_a_torque():
    def end(g, first):
        return dt.simulate(Uneven(g), START, jnp.stack([first, jnp.asarray(90.0)])).omega[-1, 0]

    g, first = 0.05, 7.0
    found, slopes = jax.jit(jax.value_and_grad(end, (0, 1)))(g, first)
    passed = 90.0 - first + np.cos(0.5 * first) - np.cos(45.0)  # ln(ω₀/ω)/γ
    exact = 0.1 * np.exp(-g * passed)
    np.testing.assert_allclose(found, exact, rtol=1e-8)
    by_first = g * (1 + 0.5 * np.sin(0.5 * first)) * exact
    np.testing.assert_allclose(slopes, [-passed * exact, by_first], rtol=1e-7)


def test_half_of_the_energy_is_lost_in_a_later_window():
    def time(g):
        return dt.decay_time(Uneven(g), [0.2, 0.0, 0.0], 0.5)

    g = 0.004
    found, slope = (float(x) for x in jax.value_and_grad(time)(g))
    reached = found + 1 - np.cos(0.5 * found)  # ln(ω₀/ω)/γ
    np.testing.assert_allclose(2 * g * reached, np.log(2), rtol=1e-8)
    np.testing.assert_allclose(slope, -reached / (g * (1 + 0.5 * np.sin(0.5 * found))), rtol=1e-7)
