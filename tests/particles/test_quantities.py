"""Quantities of astropy and pint give what the same numbers in SI units give."""

import astropy.units
import jax.numpy as jnp
import numpy as np
import pint
import pytest
import unxt

import dipoletop as dt
from dipoletop import torques
from dipoletop.particles import DEBYE, angular_speed

UNITS = {"astropy": astropy.units, "pint": pint.UnitRegistry()}
KILOGRAMS = 2000 * 100e-9 * 60e-9 * 40e-9


@pytest.fixture(params=UNITS)
def u(request):
    return UNITS[request.param]


def same(a, b):
    np.testing.assert_allclose(np.asarray(a), np.asarray(b), rtol=1e-14)


def test_particles(u):
    dipole = [0.0, 2400 * DEBYE, 0.0]
    plain = dt.Particle.cuboid([100e-9, 60e-9, 40e-9], dipole, density=2000)
    sides = np.array([100.0, 60.0, 40.0])
    density, moment = 2.0 * u.g / u.cm**3, np.array(dipole) / 1e-9 * (u.C * u.nm)
    for lengths in (sides * u.nm, [side * u.nm for side in sides]):
        found = dt.Particle.cuboid(lengths, moment, density=density)
        same(found.mass, KILOGRAMS)
        same(found.inertia, plain.inertia)
        same(found.dipole, plain.dipole)
    inertia = np.asarray(plain.inertia) * 1e21 * (u.g * u.nm**2)
    whole = dt.Particle(KILOGRAMS * 1e18 * u.fg, inertia, moment, radius=0.1 * u.um)
    same(whole.inertia, plain.inertia)
    same(whole.radius, 1e-7)
    gaussian = dt.Particle.gaussian(KILOGRAMS * 1e18 * u.fg, inertia, moment, radius=0.1 * u.um)
    for name in ("mass", "inertia", "dipole", "radius"):
        same(getattr(gaussian, name), getattr(whole, name))


@pytest.mark.slow
def test_angular_speeds_and_frequencies(u):
    turn = 2 * np.pi
    same(angular_speed(1 * u.GHz), turn * 1e9)
    same(angular_speed(3 * u.rad / u.ms), 3e3)
    same(angular_speed(180 * u.deg / u.s), np.pi)
    particle = dt.Particle.sphere(50e-9, [8e-27, 0, 0], density=2000)
    start = dt.particles.start(particle, 1 * u.GHz, momentum=[1, 2, 3])
    same(start, dt.particles.start(particle, "1 GHz", momentum=[1, 2, 3]))
    same(particle.omega(1 * u.MHz), particle.omega("1 MHz"))
    same(particle.tau(1 * u.us), particle.tau(1e-6))
    predicted = dt.predict(particle, np.asarray(start) / 1e3 * (u.rad / u.ms))
    same(predicted.half_time, dt.predict(particle, start).half_time)
    hour = predicted.history(np.array([1.0]) * u.hour)
    same(hour.energy, predicted.history([3600.0]).energy)


def test_angles_and_gases(u):
    same(dt.cylindrical(0.2, 0.2, 30 * u.deg), dt.cylindrical(0.2, 0.2, np.pi / 6))
    particle = dt.Particle.sphere(50e-9, [8e-27, 0, 0], density=2000)
    drag = torques.gas_drag(particle, 1e-7 * u.mbar, molecular_mass=4.8e-23 * u.g)
    same(drag, torques.gas_drag(particle, 1e-5, molecular_mass=4.8e-26))


def test_surroundings(u):
    particle = dt.Particle.sphere(50e-9, [8e-27, 0, 0], density=2000)
    found = dt.balance(
        particle, 1 * u.GHz, pressure=1e-9 * u.mbar, temperature=0.3 * u.kK, strength=1 * u.GPa
    )
    plain = dt.balance(particle, "1 GHz", pressure=1e-7, temperature=300.0, strength=1e9)
    same(found.rates["gas"], plain.rates["gas"])
    same(found.strength, 1e9)
    same(dt.emission.damping_time(particle, 100 * u.K), dt.emission.damping_time(particle, 100.0))
    magnet = dt.Particle.magnetic(
        1e-18 * u.kg, 1e-33 * np.eye(3), np.full(3, 3e-19) * (u.A * u.mm**2)
    )
    same(magnet.dipole, np.full(3, 3e-25 / 299792458.0))
    with pytest.raises(ValueError, match="`pressure` must be in Pa or a unit of its dimension"):
        dt.balance(particle, 1 * u.GHz, pressure=1 * u.K)


def test_a_dimensionless_quantity_is_a_number(u):
    same(dt.cylindrical(0.2 * u.m / u.m, 0.2, 0.0), dt.cylindrical(0.2, 0.2, 0.0))


def sphere(**changes):
    given = {"radius": 5e-8, "dipole": [8e-27, 0.0, 0.0], "density": 2000.0}
    return dt.Particle.sphere(**(given | changes))


WRONG = {
    "a length in seconds": (lambda u: sphere(radius=5 * u.s), "`radius` must be in m or a unit of"),
    "a density in kilograms": (lambda u: sphere(density=5 * u.kg), "`density` must be in kg/m"),
    "a dipole in debye of charge": (
        lambda u: sphere(dipole=np.ones(3) * u.C),
        r"`dipole` must be in C\*m or a unit of its dimension, but is in",
    ),
    "a speed without turns": (lambda u: angular_speed(5 / u.s), "`spin` must be in rad/s"),
    "a body in kg m²": (
        lambda u: dt.Body(np.eye(3) * (u.kg * u.m**2), [1, 0, 0]),
        "`inertia` must be dimensionless, but is in",
    ),
    "a shape in metres": (lambda u: dt.TransverseSemi(0.1 * u.m), "`delta` must be dimensionless"),
    "starts in rad/s": (
        lambda u: dt.classify_many(dt.TransverseSemi(-0.2), np.ones((2, 3)) * (u.rad / u.s)),
        "`omegas` must be dimensionless",
    ),
    "times in seconds": (
        lambda u: dt.simulate(dt.TransverseSemi(-0.2), [0.1, 0.0, 0.0], np.arange(3.0) * u.s),
        "`ts` must be dimensionless",
    ),
    "an axis of a grid": (lambda u: dt.Grid(w3=np.arange(3.0) * u.m), "w3.* must be dimensionless"),
    "numbers with and without a unit": (
        lambda u: dt.Particle.cuboid([1e-7, 60 * u.nm, 1e-8], [1e-27, 0, 0], density=2000),
        "`lengths` must be in m .* but is in numbers with and without a unit",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_another_dimension_is_refused(case, u):
    call, sentence = WRONG[case]
    with pytest.raises(ValueError, match=sentence):
        call(u)


def test_masked_values_are_refused():
    starts = np.ma.masked_invalid(np.array([[0.1, np.nan, 0.2]]))
    with pytest.raises(ValueError, match="`omegas` must have no masked values, but has 1"):
        dt.classify_many(dt.TransverseSemi(-0.2), starts)
    same(dt.cylindrical(np.ma.masked_array([0.2, 0.3]), jnp.zeros(2), 0.0)[:, 0], [0.2, 0.3])


def test_quantities_of_unxt():
    particle = dt.Particle.sphere(50e-9, [8e-27, 0, 0], density=2000)
    plain = dt.balance(particle, 1e9, pressure=1e-7, temperature=200.0)
    pressure, temperature = unxt.Quantity(1e-9, "mbar"), unxt.Quantity(200.0, "K")
    found = dt.balance(particle, 1e9, pressure=pressure, temperature=temperature)
    same(found.rates["gas"], plain.rates["gas"])
    with pytest.raises(ValueError, match="`pressure` must be in Pa or a unit of its dimension"):
        dt.balance(particle, 1e9, pressure=temperature)
