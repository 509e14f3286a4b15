"""Particles: the table of the conclusions, SI against Gaussian units, braking in seconds."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.constants import c, e, epsilon_0
from scipy.integrate import solve_ivp

from dipoletop.equations.rigid import Reduced
from dipoletop.particles import DEBYE, Particle, Rotator, paper_particles, particle_table

RNG = np.random.default_rng(8)
X, Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
D = [3e-26, 0.0, 0.0]
MOMENTS = np.diag([2e-34, 3e-34, 4e-34])
SPEED = 2e9 * np.pi
# mass, moment, dipole in debye, τ₀, T, in SI units, with the digits that are known
TABLE = {
    "silica sphere": ("1e-18", "1.000e-33", "2401.6", "1.4271e-35", "1.775e15"),
    "DAST about the long axis": ("6.4e-19", "6.667e-34", "2.8e7", "2.9097e-27", "8.705e6"),
    "DAST about the short axis": ("6.4e-19", "1.0667e-33", "2.8e7", "1.8186e-27", "1.393e7"),
    "cellulose fibre": ("4.32e-19", "3.2724e-33", "4000", "1.2098e-35", "2.094e15"),
    "CdSe sphere": ("3.80e-22", "9.507e-40", "100", "2.603e-32", "9.73e11"),
    "CdS sphere": ("3.15e-22", "7.887e-40", "100", "3.137e-32", "8.07e11"),
}


def close(found, expected, rtol):
    """Equal but for `rtol`; unlike `pytest.approx` this takes 1e-35 for a number, not for 0."""
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=0)


@jax.jit
def acceleration(particle, axis, angular_velocity):
    """Ω̇ of the reduced equation in rad/s², by way of the dimensionless body."""
    rate = Reduced(particle.body(axis))(0.0, particle.omega(angular_velocity, axis))
    return particle.angular_velocity(rate, axis) / particle.tau0(axis)


def rotation():
    """A rotation matrix, drawn at random."""
    axes, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    return axes * np.linalg.det(axes)


def rounding(digits):
    """Half a unit of the last digit."""
    mantissa, _, power = digits.partition("e")
    return 0.5 * 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))


@pytest.fixture(scope="module")
def particles():
    return {rotator.name: rotator for rotator in paper_particles()}


def test_the_table_of_the_conclusions(particles):
    rows = particle_table(particles.values())
    assert [row.name for row in rows] == list(TABLE)
    for row in rows:
        for value, digits in zip(row[1:], TABLE[row.name], strict=True):
            assert abs(value - float(digits)) <= 1.000001 * rounding(digits), (row, digits)


def test_constants_of_the_table(particles):
    close(DEBYE, 3.335641e-30, 2e-7)
    grain = particles["silica sphere"].particle
    close(grain.dipole[0], e * 50e-9, 1e-15)
    # the classical formula, factor by factor
    k = 1 / (6 * np.pi * epsilon_0 * c**3)
    close(grain.tau0(Z), k * (e * 50e-9) ** 2 / (0.4e-18 * 50e-9**2), 1e-14)


@pytest.mark.parametrize(
    ("made", "mass", "moments"),
    [
        (Particle.sphere(2e-8, D, density=3000), 3000 * 4 / 3 * np.pi * 8e-24, (0.4 * 4e-16,) * 3),
        (
            Particle.cuboid([1e-8, 2e-8, 3e-8], D, density=3000),
            3000 * 6e-24,
            np.array([13, 10, 5]) * 1e-16 / 12,
        ),
        (
            Particle.rod(3e-8, 1e-8, D, density=3000),
            3000 * np.pi * 3e-24,
            np.array([1, 1, 0.5]) * 1e-16,
        ),
    ],
)
def test_density_gives_the_mass_and_the_shape_its_moments(made, mass, moments):
    close(made.mass, mass, 1e-14)
    close(made.inertia, np.diag(mass * np.array(moments)), 1e-14)
    np.testing.assert_array_equal(made.dipole, D)


def test_mass_or_density():
    weighed = Particle.rod(3e-8, 1e-8, D, mass=3000 * np.pi * 3e-24)
    close(weighed.inertia, Particle.rod(3e-8, 1e-8, D, density=3000).inertia, 1e-14)


def test_gaussian_units():
    # k d²/I = 2d²/(3c³I) with every number in cgs; the units agree since 2019 only to 1e-9
    inertia, dipole = np.diag([2e-27, 3e-27, 4e-27]), np.array([0, 1e-14, 2e-14])
    made = Particle.gaussian(1e-15, inertia, dipole)
    speed_of_light = 100 * c
    for axis, moment in ([1, 0, 0], 2e-27), ([1, 1, 0], 2.5e-27):
        expected = 2 * 5e-28 / (3 * speed_of_light**3 * moment)
        close(made.tau0(axis), expected, 2e-9)
    close(made.mass, 1e-18, 1e-15)
    close(made.moment(X), 2e-34, 1e-15)
    close(made.dipole, np.array([0, 1e4, 2e4]) * DEBYE, 1e-14)


def test_body_is_the_particle_in_its_own_units():
    turn = rotation()
    dipole = turn @ [1e-26, 2e-26, 2e-26]
    particle = Particle(1e-18, turn @ MOMENTS @ turn.T, dipole)
    axis = 7 * turn @ [0, 3, 4]  # the moment about it is 0.36·3e-34 + 0.64·4e-34
    close(particle.moment(axis), 3.64e-34, 1e-14)
    body = particle.body(axis)
    close(body.moments, np.array([2, 3, 4]) / 3.64, 1e-13)
    close(body.dipole, dipole / 3e-26, 1e-14)


def test_torque_in_SI_units():
    # IΩ̇ + N = k d×{d×(Ω²Ω − Ω̈) + (d·Ω̇)Ω + 2(d·Ω)Ω̇}, (3.3) with (3.4), in SI numbers alone
    turn = rotation()
    inertia, d = turn @ MOMENTS @ turn.T, turn @ [1e-20, 2e-20, 2e-20]
    particle, axis = Particle(1e-18, inertia, d), turn @ [0, 0, 1]
    w = 0.05 * np.array([0.6, -0.3, 0.7]) / float(particle.tau0(axis))
    momentum, inverse = inertia @ w, np.linalg.inv(inertia)
    n = np.cross(w, momentum)
    first = -inverse @ n
    second = inverse @ (np.cross(w, n) - np.cross(momentum, inverse @ n))
    third = np.cross(d, w @ w * w - second) + d @ first * w + 2 * d @ w * first
    k = 1 / (6 * np.pi * epsilon_0 * c**3)
    expected = inverse @ (k * np.cross(d, third) - n)
    error = np.linalg.norm(acceleration(particle, axis, w) - expected)
    assert error < 1e-13 * np.linalg.norm(expected)
    # the radiation is seen: without it the rate is another
    assert np.linalg.norm(expected - first) > 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", TABLE)
def test_real_particles_brake_in_seconds(particles, name):
    # (2.4): Ω = Ω₀/√(1 + 2t/T), for years or millions of years, with τ₀Ω₀ down to 1e-25
    _, particle, axis = particles[name]
    period = float(particle.braking_time(SPEED, axis))
    t = period * np.linspace(0, 5, 6)
    run = solve_ivp(
        lambda _, w: np.asarray(acceleration(particle, axis, w)),
        (0, t[-1]),
        SPEED * np.array(axis),
        method="DOP853",
        t_eval=t,
        rtol=1e-10,
        atol=1e-10 * SPEED,
    )
    expected = SPEED / np.sqrt(1 + 2 * np.arange(6))
    close(run.y, np.outer(axis, expected), 1e-8)
    # the same T in dimensionless time, where it is 1/ω₀²
    (omega,) = particle.omega(SPEED * np.array(axis), axis)[np.array(axis) == 1]
    close(particle.seconds([0, 1 / omega**2], axis), [0, period], 1e-14)


def test_conversions_are_inverse():
    particle = Particle(1e-18, MOMENTS, D)
    many = RNG.normal(size=(4, 3))
    close(particle.omega(particle.angular_velocity(many, Z), Z), many, 1e-14)
    slow, fast = particle.braking_time([1e9, 2e9], Z)
    close(slow / fast, 4, 1e-14)


def test_table_at_another_speed():
    rotator = Rotator("mine", Particle(1e-18, MOMENTS, D), (0.0, 0.0, 1.0))
    (row,) = particle_table([rotator], speed=3.0)
    assert row.name == "mine"
    close(row.braking_time, 1 / (9 * row.tau0), 1e-14)
    close(row.debye, 3e-26 / 3.335641e-30, 2e-7)


def test_methods_of_a_batch_are_those_of_each():
    """Two grains: not as many as a tensor has rows, so that rows cannot stand for grains."""
    moments = np.array([[1.0, 2.0, 2.5], [3.0, 3.5, 4.0]]) * 1e-33
    dipole = np.array([1e-27, 2e-27, 0.0])
    grains = jax.vmap(lambda i: Particle(1e-18, jnp.diag(i), dipole))(jnp.asarray(moments))
    axis, tau0 = [0.0, 0.0, 2.0], np.sum(dipole**2) / (6 * np.pi * epsilon_0 * c**3 * moments[:, 2])
    np.testing.assert_allclose(grains.moment(axis), moments[:, 2], rtol=1e-14)
    np.testing.assert_allclose(grains.tau0(axis), tau0, rtol=1e-14)
    np.testing.assert_allclose(grains.seconds(3.0, axis=axis), 3 * tau0, rtol=1e-14)
    np.testing.assert_allclose(grains.braking_time(2.0, axis), 1 / (4 * tau0), rtol=1e-14)
    speed = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(grains.omega(speed, axis), tau0[:, None] * speed, rtol=1e-14)
    bodies = grains.body(axis)
    scaled = [np.diag(row / row[2]) for row in moments]
    np.testing.assert_allclose(bodies.inertia, scaled, rtol=1e-14)


def test_a_family_of_spheres():
    # at one density τ₀ ∝ R⁻⁵; a radius that is none spoils its own lane alone
    tau0 = lambda radius: Particle.sphere(radius, D, density=2000).tau0(Z)  # noqa: E731
    radii = jnp.array([1e-8, 2e-8, -1e-8])
    lanes, slopes = jax.jit(jax.vmap(jax.value_and_grad(tau0)))(radii)
    close(lanes[0] / lanes[1], 32, 1e-13)
    close((radii * slopes / lanes)[:2], -5, 1e-13)
    assert np.isnan(lanes[2])


MESSAGES = [
    (lambda: Particle(-1, MOMENTS, D), "mass", "be positive", "is -1.0"),
    (lambda: Particle([1, 1], MOMENTS, D), "mass", "have shape ()", "has shape (2,)"),
    (lambda: Particle(1, MOMENTS, [0, 0, 0]), "dipole", "not be zero", "has 0, 0, 0"),
    (lambda: Particle(1, MOMENTS, [1, 0]), "dipole", "have shape (3,)", "has shape (2,)"),
    (lambda: Particle(1, [MOMENTS], D), "inertia", "have shape (3, 3)", "has shape (1, 3, 3)"),
    (
        lambda: Particle(1, np.diag([1e-40, 1e-40, 3e-40]), D),
        "inertia",
        "have principal moments with J1 + J2 >= J3",
        "has 1e-40, 1e-40, 3e-40",
    ),
    (lambda: Particle.sphere(0, D, mass=1), "radius", "be positive", "is 0.0"),
    (lambda: Particle.sphere(1, [D], mass=1), "dipole", "have shape (3,)", "has shape (1, 3)"),
    (lambda: Particle.sphere(1, D), "mass", "be given or else `density`", "neither is"),
    (lambda: Particle.sphere(1, D, mass=1, density=1), "mass", "be given or else", "both are"),
    (lambda: Particle.cuboid([1, 1, 1], D, density=-1), "density", "be positive", "is -1.0"),
    (lambda: Particle.cuboid([1, -2, 1], D, density=1), "lengths", "be positive", "has -2"),
    (lambda: Particle.rod(-1, 1, D, mass=1), "length", "be positive", "is -1.0"),
    (lambda: Particle.gaussian(-1, MOMENTS, D), "mass", "be positive", "is -1.0"),
    (lambda: Particle(1, MOMENTS, D).tau0([0, 0, 0]), "axis", "not be zero", "has 0, 0, 0"),
    (lambda: Particle(1, MOMENTS, D).body([1, 0]), "axis", "have shape (3,)", "has shape (2,)"),
    (lambda: Particle(1, MOMENTS, D).omega(1.0, Z), "angular_velocity", "have shape", "has shape"),
    (lambda: Particle(1, MOMENTS, D).braking_time(0, Z), "speed", "be positive", "is 0.0"),
    (lambda: Particle(1, MOMENTS, D).seconds(np.nan, Z), "tau", "be finite", "is nan"),
]


@pytest.mark.parametrize(("make", "name", "must", "was"), MESSAGES)
def test_refusals(make, name, must, was):
    sentence = re.escape(f"Argument `{name}` must {must}") + ".*, but " + re.escape(was)
    with pytest.raises(ValueError, match=f"^{sentence}") as caught:
        make()
    assert str(caught.value).endswith(".")


def test_float32_is_refused():
    # 1e-40 kg m² would be zero there
    with jax.enable_x64(False):
        for make in (
            paper_particles,
            lambda: Particle.cuboid([1e-8] * 3, D, density=1),
            lambda: Particle(1e-18, MOMENTS, D),
        ):
            with pytest.raises(ValueError, match=r"must be float64, but is float32.*switches"):
                make()
