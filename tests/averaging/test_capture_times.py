"""When the mean energy of needles of random phase falls, by clocks and by direct integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop._averaging.capture_times import clock_of_needle
from dipoletop._averaging.ends import time_of_needle

STARTS = 256


@pytest.mark.slow
def test_thin_rods_lose_energy_as_their_slow_angle_moves():
    """φ follows z = −sin 2φ/(3 cos²φ) to an axis, (1/u)′ = 2 sin²φ; its first density is cos²φ."""
    first = (np.arange(400) + 0.5) * np.pi / 800
    half = (1 + 0.4727) / 2  # with the mean of 3 cos²φ − 2 where it is positive

    def rates(t, y):
        phi, inverse = y.reshape(2, -1)
        moves = phi < np.pi / 2 - 1e-6
        slope = np.where(moves, np.tan(phi) * (2 / 3 - np.cos(phi) ** 2), 0.0) / inverse
        return np.concatenate([slope, 2 * np.sin(phi) ** 2])

    def mean(t, y):
        return (1 / y[400:]) @ np.cos(first) ** 2 / 200 - half

    mean.terminal = True
    run = solve_ivp(rates, (0.0, 2.0), np.append(first, np.ones(400)), events=mean, rtol=1e-6)
    clock = jax.jit(clock_of_needle)(jnp.asarray(1 - 1e-9), jnp.asarray(0.4727))
    assert float(clock.time(jnp.asarray(half))) == pytest.approx(run.t[-1], rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delta", "size", "asymmetry"),
    [(0.95, 1e-4, 0.0), (0.8, 1e-4, 0.05), (0.8, 1e-4, -0.05)],
)
def test_half_of_the_mean_energy_of_random_phases_is_lost_at_the_half_time(delta, size, asymmetry):
    """The first states lie on the circle of one averaged motion, by the oscillations of (4.2)."""
    axial = 0.4 * size
    moments = np.array([1.0, 1 - asymmetry * size**2, 1 - delta])
    body = dt.Body(np.diag(moments), [1.0, 0.0, 0.0])
    predicted = dt.predict(body, [size, 0.0, axial])
    phase = 2 * np.pi * (np.arange(STARTS) + 0.5) / STARTS
    s, m = np.sin(2 * phase), 1 + delta + delta**2
    flat = size * np.exp(-s * (size**2 + m * axial**2) / (4 * delta * axial))
    third = axial * np.exp(s * 3 * size**2 / (4 * (1 - delta) * axial))
    starts = np.stack([flat * np.cos(phase), flat * np.sin(phase), third], axis=1)
    half = float(predicted.half_time)
    times = jnp.array([0.0, 0.95, 1.0, 1.05]) * half

    @jax.jit
    @jax.vmap
    def energies(start):
        equation = dt.SemiReduced(body)
        return dt.simulate(equation, start, times, max_steps=500_000, rtol=1e-8).energy

    first, before, at_half, after = np.mean(energies(jnp.asarray(starts)), axis=0)
    wanted = first - float(predicted.radiated_energy) / 2
    off = (at_half - wanted) / (after - before) / 10  # relative to the half time
    assert 5e-4 < predicted.error < 0.01
    assert abs(off) < predicted.error


@pytest.mark.parametrize(("delta", "omega"), [(0.2, [1.0, 0.3, 4.0]), (0.9, [0.2, 0.1, 3.0])])
def test_a_half_time_before_the_capture_is_that_of_the_averaged_equations(delta, omega):
    """By (4.13) and (4.14), with u = ω⊥² and v = ω₃²; the unit of its time is τ₀/2."""
    u, v = omega[0] ** 2 + omega[1] ** 2, omega[2] ** 2

    def rates(t, y):
        u, v = y
        fall = u + (1 + delta + delta**2) * v
        return [-u * fall, -v * ((2 + delta) * u + 2 * v) / (1 - delta)]

    def energy(t, y):
        return y[0] + (1 - delta) * y[1] - 0.7 * (u + (1 - delta) * v)

    energy.terminal = True
    settings = {"rtol": 1e-12, "atol": 1e-14, "method": "DOP853", "events": energy}
    run = solve_ivp(rates, (0, 100), [u, v], **settings)
    found = jax.jit(time_of_needle)(jnp.asarray(delta), jnp.asarray(omega), jnp.asarray(0.7))
    assert found / 2 == pytest.approx(run.t[-1], rel=1e-10)
