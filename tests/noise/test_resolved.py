"""Noise turn by turn: exact Ornstein-Uhlenbeck laws, equilibria, attitudes, keys, refusals."""

import equinox as eqx
import numpy as np
import pytest

import dipoletop as dt
from dipoletop.noise import Bath, Noisy, ensemble, with_noise

MOMENTS = np.array([1.0, 1.3, 1.9])
LEVEL = [1.0, 0.0, 0.0, 0.0]


def body(kappa, direction=(0.5, 0.6, -0.4)):
    n = np.array(direction) / np.linalg.norm(direction)
    return dt.Body(np.diag(MOMENTS), np.sqrt(kappa) * n)


def sphere(kappa=1e-30):
    return dt.Body(np.eye(3), [np.sqrt(kappa), 0.0, 0.0])


def near(mean, expected, bias=0.0):
    """Within four standard errors, and a bias of the step."""
    error = 4 * np.asarray(mean.error) + bias * np.abs(expected)
    np.testing.assert_array_less(np.abs(np.asarray(mean.value) - expected), error)


def test_drag_of_a_sphere_is_an_ornstein_uhlenbeck_process():
    """⟨ω⟩ = ω₀e^{−γτ} and var ω = θ(1 − e^{−2γτ}) about every axis, exactly."""
    noisy = with_noise(dt.Reduced(sphere(), order=1), Bath(0.0, 0.5, drag_heat=2.0))
    found = ensemble(noisy, [3.0, 0.0, -1.0], [0.0, 0.7, 2.0, 9.0], n=3000, step=0.1)
    for k, t in enumerate(found.ts):
        omega = found.omega[:, k]
        decay = np.exp(-0.5 * t)
        start = np.array([3.0, 0.0, -1.0])
        if k:
            near(found.mean(omega), start * decay)
            near(found.mean((omega - start * decay) ** 2), np.full(3, 2 * (1 - decay**2)))
        else:
            np.testing.assert_array_equal(omega, np.tile(start, (3000, 1)))


def test_weak_order_of_convergence():
    """The variance of an Ornstein-Uhlenbeck process: θ(2/x)tanh(x/2), x = γh, for small x.

    A step multiplies ω by R(x) and adds noise of the variance 2θh((1 − R)/x)².
    """
    noisy = with_noise(dt.Reduced(sphere(), order=1), Bath(0.0, 1.0, drag_heat=2.0))
    for x in (1.0, 0.5, 0.25):
        found = ensemble(noisy, [0.0] * 3, np.arange(0.0, 60.0, 5.0), n=2048, step=x)
        factor = 1 - x + x**2 / 2 - x**3 / 6 + x**4 / 24
        expected = 4 * x * ((1 - factor) / x) ** 2 / (1 - factor**2)
        np.testing.assert_allclose(expected, 4 / x * np.tanh(x / 2), rtol=0.02 * x**4)
        near(found.mean(np.mean(found.omega[:, 1:] ** 2, axis=(1, 2))), expected)


def test_a_path_depends_on_its_own_key_only():
    noisy = with_noise(dt.Reduced(body(0.01), order=1), Bath(0.0, 0.1, drag_heat=1.0))
    ts = [0.0, 1.0, 2.5]
    few, many = (ensemble(noisy, [1.0, 0, 0], ts, n=n, step=0.1).omega for n in (3, 700))
    np.testing.assert_array_equal(few, many[:3])
    other = ensemble(noisy, [1.0, 0, 0], ts, n=3, step=0.1, seed=1).omega
    assert np.all(np.any(few[:, 1:] != other[:, 1:], axis=-1))
    starts = np.random.default_rng(0).normal(size=(700, 3))
    own = ensemble(noisy, starts, ts, n=700, step=0.1).omega
    np.testing.assert_array_equal(own[:, 0], starts)
    assert np.std(many[:, -1, 0]) > 0.1


@pytest.mark.slow
def test_without_noise_a_path_is_the_trajectory():
    equation = dt.SemiReduced(body(0.05))
    ts = np.linspace(0.0, 20.0, 5)
    expected = dt.simulate(equation, [0.7, 0.1, 0.4], ts, attitude=LEVEL)
    noisy = with_noise(equation, Bath())
    found = ensemble(noisy, [0.7, 0.1, 0.4], ts, n=2, step=0.02, attitude=LEVEL)
    np.testing.assert_allclose(found.omega[1], expected.omega, atol=1e-8)
    np.testing.assert_allclose(found.attitude[1], expected.attitude, atol=1e-8)
    np.testing.assert_allclose(found.dipole[1], expected.dipole, atol=1e-8)
    np.testing.assert_allclose(found.energy[1], expected.energy, rtol=1e-7)


@pytest.mark.slow
def test_noise_acts_on_an_equation_with_torques_and_an_attitude():
    """A dipole in a constant field, hot: ⟨cos ϑ⟩ = coth u − 1/u with u = dE/kT (Langevin)."""
    top = dt.Reduced(sphere(1e-6), order=1)
    field = dt.torques.field_on_dipole(top, [0.0, 0.0, 20.0])
    held = dt.torques.with_torque(top, field, attitude=LEVEL)
    noisy = with_noise(held, Bath(0.0, 0.3, drag_heat=0.01))
    found = ensemble(noisy, [0.0, 0.0, 0.0], [0.0, 150.0, 200.0, 250.0], n=1500, step=0.3)
    cosine = found.dipole[:, 1:, 2].mean(axis=1) / 1e-3
    near(found.mean(cosine), 1 / np.tanh(2) - 1 / 2)


@pytest.mark.slow
def test_the_spectrum_of_a_steady_rotation_is_a_line():
    noisy = with_noise(dt.Reduced(sphere(), order=1), Bath())
    ts = np.linspace(0.0, 400.0, 2001)
    found = ensemble(noisy, [0.0, 0.0, 0.9], ts, n=1, step=0.1, attitude=LEVEL)
    spectrum = found.spectrum()
    assert abs(spectrum.frequency[np.argmax(spectrum.density[:, 0])] - 0.9) < 0.15
    width = spectrum.frequency[1] - spectrum.frequency[0]
    mean_square = np.sum(spectrum.density, axis=0) * width
    np.testing.assert_allclose(mean_square[:2] / 1e-30, 0.5, rtol=0.05)
    assert mean_square[2] < 1e-40


@pytest.mark.slow
def test_equilibrium_of_the_thermal_partner_of_radiation():
    """½kT about every axis of a triaxial body with an oblique dipole; ⟨L²⟩, ⟨L⁴⟩ of Gauss."""
    noisy = with_noise(dt.Reduced(body(1 / 16), order=1), Bath(1.0))
    found = ensemble(noisy, [0.5] * 3, np.linspace(0.0, 600.0, 25), n=4096, step=0.05)
    late = found.omega[:, 6:]
    near(found.mean(np.mean(MOMENTS * late**2, axis=1)), np.ones(3), bias=0.01)
    size = found.size[:, 6:]
    near(found.mean(np.mean(size**2, axis=1)), 4.2, bias=0.01)
    near(found.mean(np.mean(size**4, axis=1)), 30.24, bias=0.02)


@pytest.mark.parametrize(
    ("call", "sentence"),
    {
        "with_noise(dt.TransverseFull(0.1), Bath())": "`equation` must be a reduced or the semi-r",
        "ensemble(NOISY, START, [0.0])": "`ts` must hold at least two times, but holds 1",
        "ensemble(NOISY, START, [1.0, 0.0])": "`ts` must be in ascending order",
        "ensemble(NOISY, START, TS, seed=-1)": "`seed` must be a whole number, not negative",
        "ensemble(NOISY, START, TS, step=0.0)": "`step` must be positive",
        "ensemble(NOISY, START, [0.0, 1e12])": "`ts` must be reached in at most 5000000 steps",
        "ensemble(NOISY, np.ones((3, 3)), TS, n=2)": r"`omega0` must have shape \(3,\) or \(2, 3\)",
        "ensemble(NOISY, START, TS, n=2).dipole": "`attitude` must be given to `ensemble`",
        "ensemble(NOISY, START, TS, n=2).mean(3.0)": "`values` must have the paths on the first",
        "Bath(-1.0)": "`heat` must not be negative",
        "Bath(0.1, [1.0, 2.0])": r"`drag` must be a number or have shape \(3, 3\)",
        "Bath(0.1, np.diag([1.0, 1.0, -1.0]))": "`drag` must be symmetric, without negative",
    }.items(),
)
def test_refusals(call, sentence):
    noisy = with_noise(dt.TransverseReduced(-0.2), Bath(1e-4))
    names = globals() | {"NOISY": noisy, "START": [0.1, 0.2, 0.3], "TS": [0.0, 1.0]}
    with pytest.raises(ValueError, match=sentence):
        eval(call, names)


def test_the_bath_of_a_particle():
    """Rates in units of 1/τ₀ and kT in units of I₁/τ₀²; the noise of a gas is 2kTΓ."""
    particle = dt.particles.paper_particles()[3].particle
    gas = dt.surroundings.Gas(1e-3, 250.0)
    thermal = dt.surroundings.RadiationReaction(77.0)
    bath = Bath.around(particle, thermal, gas)
    tau0, moment = particle.tau0(), particle.moment()
    boltzmann = 1.380649e-23
    np.testing.assert_allclose(bath.heat, boltzmann * 77 * tau0**2 / moment, rtol=1e-12)
    rates = np.asarray(gas.friction(particle)) / moment
    np.testing.assert_allclose(np.diag(bath.drag), rates * tau0, rtol=1e-12)
    np.testing.assert_allclose(
        np.diag(bath.diffusion), np.diag(bath.drag) * boltzmann * 250 * tau0**2 / moment, rtol=1e-12
    )
    assert isinstance(with_noise(dt.SemiReduced(particle.body()), bath), Noisy)
    assert eqx.tree_equal(Bath.around(particle), Bath())
