"""Radiation reaction and its thermal noise: against the reduced equation, and heat against loss."""

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop.particles import RADIATION
from dipoletop.surroundings import Blackbody, RadiationReaction

INERTIA = np.array([[1.0, 0.1, 0.0], [0.1, 1.3, -0.05], [0.0, -0.05, 1.9]])
N = np.array([0.5, 0.6, -0.4]) / np.linalg.norm([0.5, 0.6, -0.4])
"""The direction of the dipole."""
OMEGA = np.array([0.7, -0.3, 0.5])
BOLTZMANN = 1.380649e-23


def particle(strength):
    """A particle of moments near 1 with κ = k d² = strength."""
    return dt.Particle(1.0, INERTIA, np.sqrt(strength / RADIATION) * N)


def free(omega):
    """Ω̇ and d₂ over |d|, of the free rotation."""
    change = -np.linalg.solve(INERTIA, np.cross(omega, INERTIA @ omega))
    return change, np.cross(omega, np.cross(omega, N)) + np.cross(change, N)


def test_torque_is_the_loss_of_angular_momentum():
    _, second = free(OMEGA)
    expected = -0.01 * np.cross(np.cross(OMEGA, N), second)
    found = RadiationReaction().torque(particle(0.01), jnp.asarray(OMEGA))
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_noise_heats_as_much_as_the_dipole_radiates():
    bath = RadiationReaction(300.0)
    diffusion = np.asarray(bath.diffusion(particle(0.01), jnp.asarray(OMEGA)))
    _, second = free(OMEGA)
    strength, first = 0.01 * BOLTZMANN * 300.0, np.cross(OMEGA, N)
    np.testing.assert_allclose(OMEGA @ diffusion @ OMEGA, strength * second @ second, rtol=1e-12)
    spin = INERTIA @ OMEGA / np.linalg.norm(INERTIA @ OMEGA)
    along = first @ first - (first @ spin) ** 2
    np.testing.assert_allclose(spin @ diffusion @ spin, strength * along, rtol=1e-12)


def test_friction_of_the_noise_is_the_reduced_equation():
    """P = L − k d×d₂ obeys dP = P×I⁻¹P − DΩ/kT but for terms of second order in k."""

    def defect(strength):
        body = dt.Body(INERTIA, np.sqrt(strength) * N)
        equation = dt.Reduced(body, order=1)

        def shifted(omega):
            change = -jnp.linalg.solve(body.inertia, jnp.cross(omega, body.inertia @ omega))
            schott = dt.radiation.schott_angular_momentum(body, omega, change)
            return body.inertia @ omega - schott

        omega = jnp.asarray(OMEGA)
        p, rate = jax.jvp(shifted, (omega,), (equation(0.0, omega),))
        slow = jnp.linalg.solve(body.inertia, p)
        diffusion = RadiationReaction(1.0).diffusion(particle(strength), slow)
        friction = -diffusion @ slow / BOLTZMANN
        return np.linalg.norm(rate - jnp.cross(p, slow) - friction)

    coarse, fine = defect(1e-3), defect(1e-4)
    assert coarse < 1e-5
    np.testing.assert_allclose(coarse / fine, 100, rtol=0.05)


def test_absorption_that_does_not_depend_on_frequency():
    ball = dt.Particle.sphere(50e-9, [1e-27, 0, 0], density=2000)
    volume = (50e-9) ** 3  # 3V/4π

    def absorbs(omega):
        return 0.1 * volume * jnp.ones_like(omega)

    found = Blackbody(77.0, absorbs).friction(ball)
    np.testing.assert_allclose(found, Blackbody(77.0, 0.1).friction(ball), rtol=1e-11)
    zeta = 1.2020569031595942
    heat, hbar, light = BOLTZMANN * 77.0, 1.0545718176461565e-34, 299792458.0
    expected = 16 * zeta / np.pi * 0.1 * volume * heat**3 / light**3 / hbar / hbar
    np.testing.assert_allclose(found, expected, rtol=1e-9)
