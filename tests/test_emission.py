"""Spectral lines and polarisation, against the rotation integrated in the laboratory frame."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.constants import c, epsilon_0
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop._base.directions import spread_directions
from dipoletop.emission import lines, stokes

RNG = np.random.default_rng(24)
COMPILED = jax.jit(lines, static_argnames="n")
TURN, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
TURN *= np.linalg.det(TURN)
GENERIC, DIPOLE = (1.0, 1.4, 2.0), np.array([0.7, -0.4, 0.9])
# moments, Ω in principal axes
STATES = {
    "low": (GENERIC, (0.3, -0.5, 0.9)),
    "low, downwards": (GENERIC, (0.3, 0.5, -0.9)),
    "high": (GENERIC, (0.9, 0.5, 0.2)),
    "high, downwards": (GENERIC, (-0.9, 0.4, 0.2)),
    "plate": ((1.0, 1.3, 2.3), (0.8, 0.7, 0.2)),
    "needle": ((0.01, 1.0, 1.0005), (5.0, 0.4, -0.3)),
    "nearly spherical": ((1.0, 1.01, 1.03), (0.3, 0.2, 1.0)),
    "oblate": ((1.0, 1.0, 1.7), (0.5, 0.3, -0.6)),
    "prolate": ((0.5, 1.0, 1.0), (0.9, 0.3, 0.4)),
    "sphere": ((1.0, 1.0, 1.0), (0.9, 0.3, 0.4)),
    "spin about 1": (GENERIC, (-1.3, 0.0, 0.0)),
    "spin about 2": (GENERIC, (0.0, 1.3, 0.0)),
    "spin about 3": (GENERIC, (0.0, 0.0, 1.3)),
    "oblate, across": ((1.0, 1.0, 1.7), (0.5, 0.3, 0.0)),
    "prolate, across": ((0.5, 1.0, 1.0), (0.0, 0.3, 0.4)),
}


def of(state):
    """A body whose principal axes are not those of its frame, and Ω."""
    moments, omega = STATES[state]
    return dt.Body(TURN @ np.diag(moments) @ TURN.T, TURN @ DIPOLE), jnp.asarray(TURN @ omega)


def in_the_laboratory(body, omega, times):
    """The dipole in time, by Euler's equations, with axis 3 along L and d₂ = 0 ≤ d₁ at first."""
    inertia, dipole, omega = (np.asarray(x) for x in (body.inertia, body.dipole, omega))
    inverse, momentum = np.linalg.inv(inertia), inertia @ omega

    def field(_, y):
        omega, axes = y[:3], y[3:].reshape(3, 3)  # a row is a fixed axis, in body axes
        change = -inverse @ np.cross(omega, inertia @ omega)
        return np.concatenate([change, np.cross(axes, omega).ravel()])

    up = momentum / np.linalg.norm(momentum)
    first = dipole - up * (up @ dipole)
    first /= np.linalg.norm(first)
    start = np.concatenate([omega, first, np.cross(up, first), up])
    run = solve_ivp(field, times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-13)
    return run.y[3:].T.reshape(-1, 3, 3) @ dipole


@pytest.mark.parametrize("state", STATES)
def test_lines_are_those_of_the_rotating_dipole(state):
    body, omega = of(state)
    times = np.linspace(0.0, 20.0, 31)
    exact = in_the_laboratory(body, omega, times)
    found = COMPILED(body, omega, n=32)
    waves = np.exp(-1j * times[:, None] * np.asarray(found.frequency)[None])
    series = np.real(waves @ np.asarray(found.amplitude))
    difference = series - exact
    assert np.ptp(difference[:, 2]) < 3e-11  # but for a constant
    assert np.max(abs(difference[:, :2])) < 3e-11
    assert abs(found.missing) < 1e-10
    if state.startswith(("spin", "sphere")) or state.endswith("across"):
        (line,) = np.flatnonzero(found.power > 1e-20)
        np.testing.assert_allclose(found.frequency[line], np.linalg.norm(omega), rtol=1e-14)


def test_powers_add_up_to_the_closed_form():
    rng = np.random.default_rng(3)
    spread = rng.random((300, 3)) ** 3
    # Sums of two of three positive numbers are the moments of a body.
    moments = np.roll(spread, 1, 1) + np.roll(spread, 2, 1) + 1e-3
    bodies = dt.Body(moments[:, :, None] * np.eye(3), rng.normal(size=(300, 3)))
    omega = rng.normal(size=(300, 3))
    found = jax.jit(jax.vmap(partial(lines, n=200)))(bodies, omega)
    missing = np.abs(found.missing)
    assert np.mean(missing < 1e-10) > 0.97
    assert np.max(missing) < 1e-3
    # Near the separatrix more lines are needed, and it is said how much is missing.
    body = dt.Body(np.diag(GENERIC), [1.0, 0.5, 0.2])
    omega = jnp.array([1e-3, 1.0, 1e-3])
    shares = [float(COMPILED(body, omega, n=n).missing) for n in (2, 8, 32)]
    assert 0.1 > shares[0] > shares[1] > 3 * shares[2] > 1e-15


def test_light_towards_all_directions_is_the_power():
    body, omega = of("high")
    nodes, weights = np.polynomial.legendre.leggauss(3)
    angles = np.arange(3) * 2 * np.pi / 3
    towards = [
        (np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z)
        for z in nodes
        for a in angles
    ]
    seen = jax.jit(jax.vmap(stokes, (None, None, 0)))(body, omega, jnp.asarray(towards))
    total = np.repeat(weights, 3) * 2 * np.pi / 3 @ seen.lines[..., 0]
    np.testing.assert_allclose(total, lines(body, omega).power, rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(seen.total, seen.lines.sum(axis=1), rtol=1e-13, atol=1e-15)
    i, *rest = np.moveaxis(np.asarray(seen.lines), -1, 0)
    np.testing.assert_allclose(np.sum(np.square(rest), axis=0), i**2, rtol=1e-12, atol=1e-20)


def test_polarisation_is_that_of_the_field_at_the_observer():
    body, omega = of("low")
    found, s = lines(body, omega), np.array([0.5, -0.3, 0.7])
    seen = stokes(body, omega, s)
    s /= np.linalg.norm(s)
    north = np.array([0.0, 0.0, 1.0]) - s[2] * s
    north /= np.linalg.norm(north)
    east = np.cross(s, north)  # counter-clockwise from N for an observer towards whom s points
    for k in np.argsort(-np.asarray(found.power))[:6]:
        phases = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        moving = np.real(np.exp(-1j * phases)[:, None] * np.asarray(found.amplitude)[k][None])
        field = -np.cross(s, np.cross(s, -(float(found.frequency[k]) ** 2) * moving))
        n, e = field @ north, field @ east
        swept = np.mean(n * np.roll(e, -1) - e * np.roll(n, -1)) / np.sin(phases[1])
        expected = [np.mean(n**2 + e**2), np.mean(n**2 - e**2), 2 * np.mean(n * e), swept]
        np.testing.assert_allclose(
            seen.lines[k], 3 / (8 * np.pi) * np.array(expected), rtol=1e-12, atol=1e-15
        )


def test_rotator_seen_from_above_from_below_and_from_the_side():
    body, omega = dt.axisymmetric(-0.5), [0.0, 0.0, -2.0]  # L along −3
    for angle in (0.0, 0.4, np.pi / 2, np.pi):
        cosine, strength = np.cos(angle), 3 / (16 * np.pi) * 16
        expected = np.array([1 + cosine**2, -(np.sin(angle) ** 2), 0.0, 2 * cosine])
        seen = stokes(body, omega, [np.sin(angle) if angle < 3 else 0.0, 0.0, cosine]).total
        np.testing.assert_allclose(seen, strength * expected, atol=1e-14)


def test_particle_radiates_as_its_scaled_body():
    moment, dipole = 2e-33, np.array([3e-27, 1e-27, 2e-27])
    particle = dt.Particle(1e-18, moment * np.diag(GENERIC), dipole)
    omega, axis = np.array([2e9, 4e9, 1e9]), [1.0, 0.0, 0.0]
    found, scaled = lines(particle, omega), lines(particle.body(axis), particle.omega(omega, axis))
    tau0 = float(particle.tau0(axis))

    def close(a, b):
        np.testing.assert_allclose(a / b, 1.0, rtol=2e-13)

    strong = np.asarray(found.power) > 1e-12 * np.max(found.power)
    close(found.frequency, scaled.frequency / tau0)
    close(found.power[strong], (moment / tau0**3) * scaled.power[strong])
    close(found.total, (moment / tau0**3) * scaled.total)
    norm = np.linalg.norm(dipole)
    for part in ("real", "imag"):
        here, there = (getattr(each.amplitude, part) for each in (found, scaled))
        np.testing.assert_allclose(here / norm, there, rtol=1e-12, atol=1e-14)
    s = jnp.array([0.3, 0.4, 0.5])
    light = stokes(particle, omega, s).total
    expected = stokes(particle.body(axis), particle.omega(omega, axis), s).total
    expected *= moment / tau0**3
    np.testing.assert_allclose(light, expected, rtol=1e-12, atol=1e-12 * expected[0])
    # Larmor's formula in SI units, for a rotator.
    rotator = dt.Particle(1e-18, moment * np.eye(3), [3e-27, 0.0, 0.0])
    power = (3e-27) ** 2 * (5e9) ** 4 / (6 * np.pi * epsilon_0 * c**3)
    close(lines(rotator, [0.0, 5e9, 0.0]).power.sum(), power)


@pytest.mark.slow
def test_derivatives_by_omega():
    body, _ = of("low")

    @jax.jit
    def numbers(omega):
        found = lines(body, omega, n=32)
        return jnp.stack([found.power.sum(), found.total, found.power[34], found.precession])

    omega, step = of("low")[1], 1e-5
    rates = jax.jit(jax.jacfwd(numbers))
    slopes = rates(omega)
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=1e-9)
    moved = step * jnp.eye(3)
    differences = [(numbers(omega + m) - numbers(omega - m)) / (2 * step) for m in moved]
    np.testing.assert_allclose(slopes.T, differences, rtol=1e-7, atol=1e-8)
    # The power of a spin is that of the fourth power of Ω, and no derivative is infinite.
    for state in ("spin about 1", "spin about 2", "spin about 3"):
        omega = of(state)[1]
        at = rates(omega)
        assert np.all(np.isfinite(at)), state
        np.testing.assert_allclose(at[:2] @ omega, 4 * numbers(omega)[:2], rtol=1e-12)
        np.testing.assert_allclose(at[0], at[1], rtol=1e-9, atol=1e-12)


def test_no_rotation_no_light():
    body, _ = of("low")
    assert repr(lines(body, jnp.zeros(3))) == "Lines(total=0, missing<1e-13, strongest: none)"
    assert np.all(np.asarray(stokes(body, jnp.zeros(3), [1, 0, 0]).lines) == 0)
    huge, tiny = (lines(body, [0.3e0 * z, z, 2 * z]) for z in (1e60, 1e-200))
    np.testing.assert_allclose(huge.frequency / 1e60, tiny.frequency / 1e-200, rtol=1e-14)


def test_of_a_traced_bad_rotation_nothing_is_known():
    body, omega = of("low")
    traced = COMPILED(body, omega * jnp.nan, n=32)
    assert np.all(np.isnan(traced.power))


# Damping of thermal rotation

BOLTZMANN = 1.380649e-23
FLATTENINGS = {-0.5: 0.341666666667, -0.3904: 0.386296053213, -0.1: 0.574466666667}
FLATTENINGS |= {0.3: 1.044066666667, 1.0: 2.666666666667, 2.0: 7.466666666667}


@pytest.mark.parametrize("beta", FLATTENINGS)
def test_damping_of_wobbling_tops(beta):
    """⟨Σ mP/ω⟩ at L = I₁ and k = 1, of dipoles across and along the symmetry axis."""
    moments = np.array([1 + beta, 1 + beta, 1.0])
    largest = moments.max()
    for dipole, expected in (([1.0, 0, 0], FLATTENINGS[beta]), ([0, 0, 1.0], 2 / 3)):
        grain = dt.Particle(1.0, np.diag(moments), dipole)
        loss = expected / (1 + beta) ** 3  # at L = 1
        rate = 3 * BOLTZMANN * 100.0 * largest * dt.particles.RADIATION * loss
        found = dt.emission.damping_time(grain, 100.0)
        np.testing.assert_allclose(1 / found, rate, rtol=3e-12)


def test_damping_of_spinning_dust():
    """Times by SpyDust 1.3.1 for grains of a cold cloud, warm gas and a nebula."""
    debye, cgs = dt.particles.DEBYE, 1e-7

    def grain(moment, beta, dipole):
        inertia = moment * cgs * np.diag([1 + beta, 1 + beta, 1.0])
        directions = np.array([np.sqrt(2 / 3), 0.0, np.sqrt(1 / 3)])
        return dt.Particle(1e-24, inertia, dipole * debye * directions)

    cases = [
        (grain(3.7534e-37, -0.3904, 2.176), 100.0, 1.3713e7),
        (grain(3.8357e-35, 0.0, 9.304), 100.0, 2.4878e10),
        (grain(3.8357e-35, 0.0, 9.318), 6000.0, 4.1337e8),
        (grain(3.8357e-35, 0.0, 9.372), 100.0, 2.4518e10),
    ]
    for particle, temperature, expected in cases:
        found = dt.emission.damping_time(particle, temperature)
        np.testing.assert_allclose(found, expected, rtol=4e-4)


def test_damping_of_a_triaxial_grain_is_the_loss_of_its_lines():
    """Over directions of L spread evenly, each with the angular momentum that its lines carry."""
    moments, dipole = np.array([1.0, 1.3, 1.9]), np.array([0.5, 0.6, -0.4])
    along = spread_directions(400)
    lines = jax.vmap(lambda omega: dt.lines(dt.Body(np.diag(moments), dipole), omega, n=16))(
        jnp.asarray(along / moments)
    )
    amplitude, frequency = np.asarray(lines.amplitude), np.asarray(lines.frequency)
    sense = np.sign(np.imag(np.conj(amplitude[..., 0]) * amplitude[..., 1]))
    carried = sense * np.asarray(lines.power) / np.where(frequency > 0, frequency, 1.0)
    mean = np.mean(np.sum(carried, axis=1))
    grain = dt.Particle(1.0, np.diag(moments), dipole)
    rate = 3 * BOLTZMANN * 100.0 * moments[2] * dt.particles.RADIATION * mean
    np.testing.assert_allclose(1 / dt.emission.damping_time(grain, 100.0), rate, rtol=3e-3)
