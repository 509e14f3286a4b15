"""The drag by a gas: closed forms, a rotor gauge, and impacts of single molecules."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad

import dipoletop as dt
from dipoletop.particles import shapes
from dipoletop.surroundings import Gas

BOLTZMANN, DALTON = 1.380649e-23, 1.66053906892e-27
DIPOLE = [1e-27, 0.0, 0.0]
ONE = Gas(1.0, 300.0)


def over_flux(particle, gas=ONE):
    return np.asarray(gas.friction(particle) / gas.mass_flux)


def test_rod():
    rod = dt.Particle.rod(300e-9, 15e-9, DIPOLE, density=1600)
    np.testing.assert_allclose(over_flux(rod), [5.1991e-28, 5.1991e-28, 6.5208e-30], rtol=1e-5)


def test_box():
    a, b, c = lengths = np.array([100e-9, 80e-9, 50e-9])
    box = dt.Particle.cuboid(lengths, DIPOLE, density=1280)
    normal = 2 + np.pi / 2
    third = b * c * (a**2 / 2 + normal * b**2 / 6) + a * c * (b**2 / 2 + normal * a**2 / 6)
    third += a * b * (a**2 + b**2) / 6
    np.testing.assert_allclose(over_flux(box)[2], third, rtol=1e-13)
    turned = dt.Particle.cuboid(np.roll(lengths, 1), DIPOLE, density=1280)
    np.testing.assert_allclose(over_flux(turned), np.roll(over_flux(box), 1), rtol=1e-13)


def test_spinning_rotor_gauge():
    ball = dt.Particle.sphere(2.25e-3, DIPOLE, density=7800)
    gas = Gas(1e-3, 296.0, molecular_mass=28.0134 * DALTON)
    rate = gas.friction(ball) / ball.moment()
    np.testing.assert_allclose(rate, 3.83463e-7, rtol=2e-6)
    half = Gas(1e-3, 296.0, molecular_mass=28.0134 * DALTON, accommodation=0.5)
    np.testing.assert_allclose(half.friction(ball) / ball.moment(), rate / 2, rtol=1e-13)


@pytest.mark.parametrize("ratio", [1e-4, 0.03, 1.0, 30.0, 1e3])
def test_spheroids_of_any_shape(ratio):
    """About its axis: ∫ρ²dA, an integral over the meridian in closed form by the substitution."""
    spheroid = shapes.Ellipsoid(np.array([1.0, 1.0, ratio]))
    tangential, normal = map(np.asarray, spheroid.surface_integrals())
    u = (np.polynomial.legendre.leggauss(400)[0] + 1) / 2
    weights = np.polynomial.legendre.leggauss(400)[1] / 2
    # z = c sin t, ρ = cos t, with t = π/2 (1 − (1 − u)³) or π/2 u³: dense where it bends
    t = np.pi / 2 * (u**3 if ratio < 1 else 1 - (1 - u) ** 3)
    slope = np.pi / 2 * 3 * (u**2 if ratio < 1 else (1 - u) ** 2)
    arc = np.sqrt(np.sin(t) ** 2 + (ratio * np.cos(t)) ** 2)
    expected = 4 * np.pi * np.sum(weights * slope * np.cos(t) ** 3 * arc)
    np.testing.assert_allclose(tangential[2], expected, rtol=1e-9)
    assert normal[2] == 0
    if ratio == 1:
        np.testing.assert_allclose(tangential, 8 * np.pi / 3, rtol=1e-13)


def test_ellipsoid():
    axes = np.array([1.0, 2.0, 0.5])
    tangential, normal = shapes.Ellipsoid(axes).surface_integrals()

    def integrand(height, angle, which):
        flat = np.sqrt(1 - height**2)
        s = np.array([flat * np.cos(angle), flat * np.sin(angle), height])
        r, n = axes * s, s / axes
        area = axes.prod() * np.linalg.norm(n)
        n = n / np.linalg.norm(n)
        return area * (r @ r - r[1] ** 2, np.cross(r, n)[1] ** 2)[which]

    for which, found in enumerate((tangential, normal)):
        exact, _ = dblquad(lambda h, a, k=which: integrand(h, a, k), 0, np.pi / 2, 0, 1)
        np.testing.assert_allclose(found[1], 8 * exact, rtol=1e-7)


def test_noise_is_that_of_the_impacts():
    """Molecules that arrive and leave at random, on a box that is hotter than the gas."""
    gas = Gas(2.0, 200.0, accommodation=0.7, surface_temperature=500.0)
    lengths = np.array([3.0, 2.0, 1.0])
    box = dt.Particle.cuboid(lengths, [1.0, 0, 0], density=1.0)
    rng, n = np.random.default_rng(1), 400_000
    faces = lengths.prod() / lengths
    side = rng.choice(3, n, p=faces / faces.sum())
    points = (rng.random((n, 3)) - 0.5) * lengths
    sense = rng.choice([-1.0, 1.0], n)
    points[np.arange(n), side] = sense * lengths[side] / 2
    mass = float(gas.molecular_mass)

    def impulses(temperature):
        """Of molecules that cross a surface: towards it along its normal, and along it."""
        spread = np.sqrt(BOLTZMANN * temperature / mass)
        along = rng.normal(size=(n, 3)) * spread
        normal = spread * np.sqrt(-2 * np.log(rng.random(n)))
        along[np.arange(n), side] = 0
        return along, normal

    (into, hit), (out, left) = impulses(200.0), impulses(500.0)
    diffuse = rng.random(n) < 0.7
    push = np.where(diffuse[:, None], into - out, 0.0)
    push[np.arange(n), side] = -sense * np.where(diffuse, hit + left, 2 * hit)
    torque = np.cross(points, mass * push)
    arrivals = float(gas.mass_flux) / mass * 2 * faces.sum()  # per second
    expected = arrivals * np.mean(torque[:, :, None] * torque[:, None], axis=0)  # 2D
    found = 2 * np.asarray(gas.diffusion(box, jnp.ones(3)))
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=1e-2)
    assert np.all(np.abs(expected - np.diag(np.diag(expected))) < 2e-2 * expected.max())


def test_equal_temperatures_obey_the_fluctuation_dissipation_theorem():
    rod = dt.Particle.rod(300e-9, 15e-9, DIPOLE, density=1600)
    gas = Gas(1e-4, 77.0, accommodation=0.3)
    expected = BOLTZMANN * 77.0 * np.diag(gas.friction(rod))
    np.testing.assert_allclose(gas.diffusion(rod, jnp.ones(3)), expected, rtol=1e-13)
