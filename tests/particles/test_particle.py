"""Particles: the table of the conclusions, SI against Gaussian units, braking in seconds."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.constants import c, e, epsilon_0
from scipy.integrate import solve_ivp

from dipoletop.bodies import Body, axisymmetric
from dipoletop.equations.rigid import Reduced
from dipoletop.particles import (
    DEBYE,
    Particle,
    Rotator,
    magnetic_dipole,
    paper_particles,
    particle_table,
    shapes,
)

MOST_PROGRAMS = 200  # every method, of one particle and of a batch, operation by operation

RNG = np.random.default_rng(8)
X, Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
D = [3e-26, 0.0, 0.0]
MOMENTS = np.diag([2e-34, 3e-34, 4e-34])
SPEED = 2e9 * np.pi
CUBOID = Particle.cuboid([1e-8, 2e-8, 3e-8], D, density=3000)
ROD = Particle.rod(3e-8, 1e-8, D, density=3000)
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
        (CUBOID, 3000 * 6e-24, np.array([13, 10, 5]) * 1e-16 / 12),
        (ROD, 3000 * np.pi * 3e-24, np.array([1, 1, 0.5]) * 1e-16),
    ],
)
def test_density_gives_the_mass_and_the_shape_its_moments(made, mass, moments):
    close(made.mass, mass, 1e-14)
    close(made.inertia, np.diag(mass * np.array(moments)), 1e-14)
    np.testing.assert_array_equal(made.dipole, D)


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
    grains = jax.jit(jax.vmap(lambda i: Particle(1e-18, jnp.diag(i), dipole)))(moments)
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


@pytest.mark.parametrize(
    ("moments", "unit"),
    [([2, 2, 3], 2), ([1e-3, 1, 1], 1), ([2, 2, 2], 2), ([2, 3, 4], 3), ([1, 1, 2], 1)],
)
def test_the_unit_without_an_axis(moments, unit):
    """An axisymmetric body knows I₁; another one takes its middle moment."""
    turn = rotation()
    inertia = turn @ np.diag(np.array(moments) * 1e-40) @ turn.T
    particle = Particle(1e-20, inertia, turn @ D)
    close(particle.moment(), unit * 1e-40, 1e-14)
    close(particle.body().inertia, particle.inertia / (unit * 1e-40), 1e-13)
    close(particle.tau0(), particle.tau0(turn[:, 1]), 1e-13)


def test_a_symmetric_shape_is_a_top_of_the_library():
    particle = Particle.spheroid(3e-8, 2e-8, D, density=3000)
    top = axisymmetric(1 - 18 / 13)  # I₃/I₁ = 2a²/(a² + c²)
    np.testing.assert_allclose(particle.body().inertia, top.inertia, rtol=4e-16)
    np.testing.assert_array_equal(particle.body().dipole, top.dipole)


def log_tau0(c):
    return jnp.log(Particle.spheroid(1e-8, c, D, mass=1e-20).tau0())


SLOPES = jax.jit(lambda c: (jax.grad(log_tau0)(c), jax.jacfwd(log_tau0)(c)))


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_the_unit_has_derivatives(ratio):
    # I₁ = m(a² + c²)/5 at either side of the sphere, and at the sphere
    c = 1e-8 * ratio
    for slope in SLOPES(c):
        close(c * slope, -2 * ratio**2 / (1 + ratio**2), 1e-13)


def test_the_motion_does_not_depend_on_the_unit():
    particle = Particle(1e-18, MOMENTS, [1e-20, 2e-20, 2e-20])
    w = 0.05 * np.array([0.6, -0.3, 0.7]) / float(particle.tau0())
    close(acceleration(particle, None, w), acceleration(particle, [1.0, 2.0, 3.0], w), 1e-13)


@pytest.mark.parametrize("shape", [(), (4,), (3,), (4, 3), (2, 4, 3)])
@pytest.mark.parametrize("axis", [None, Z])
def test_scalars_and_vectors_go_there_and_back(shape, axis):
    given = RNG.normal(size=shape)
    for there, back in (CUBOID.omega, CUBOID.angular_velocity), (CUBOID.tau, CUBOID.seconds):
        found = back(there(given, axis), axis)
        assert found.shape == shape
        np.testing.assert_allclose(found, given, rtol=1e-15)
    # every component by the same factor
    close(CUBOID.omega(given, axis), given * float(CUBOID.tau0(axis)), 1e-15)


def test_results_of_runs_become_SI_values():
    omega_inf = [1e-20, 0.0, -3e-20, np.nan]
    expected = np.array(omega_inf) / float(CUBOID.tau0())
    close(CUBOID.angular_velocity(omega_inf), expected, 1e-15)
    assert np.isnan(CUBOID.seconds(np.nan))
    close(CUBOID.omega("1 GHz"), CUBOID.omega(SPEED), 1e-15)
    whole, half = CUBOID.braking_time([SPEED, SPEED / 2], Z)
    close([whole, half / 4], CUBOID.braking_time("1 GHz", Z), 1e-14)
    # one value for each particle of a batch, or all values for all of them
    spheres = jax.jit(jax.vmap(lambda density: Particle.sphere(1e-8, D, density=density)))
    grains = spheres(np.array([1000.0, 2000.0, 4000.0, 8000.0]))
    factors = np.array([1.0, 2.0, 4.0, 8.0])
    each = jax.jit(jax.vmap(Particle.angular_velocity))(grains, np.array(omega_inf))
    first = float(Particle.sphere(1e-8, D, density=1000).tau0())
    close(each, omega_inf * factors / first, 1e-14)
    close(grains.angular_velocity(omega_inf), np.outer(factors, omega_inf) / first, 1e-14)


def test_braking_time_without_an_axis():
    sphere = Particle.sphere(1e-8, [1e-27, 2e-27, 3e-27], density=2000)
    close(sphere.braking_time(1e9), sphere.braking_time(1e9, Z), 1e-14)
    turn = rotation()  # a top with its dipole along the symmetry axis
    inertia = turn @ np.diag([3e-34, 3e-34, 2e-34]) @ turn.T
    along = Particle(1e-18, inertia, turn @ [0, 0, 1e-26])
    close(along.braking_time(1e9), along.braking_time(1e9, turn @ [3, 4, 0]), 1e-14)
    # traced, the moments that differ are known to nobody
    times = jax.jit(lambda particle: particle.braking_time(1e9))
    assert np.isfinite(times(along))
    for dipole in [1e-26, 0, 0], [1e-26, 0, 1e-26]:
        particle = Particle(1e-18, inertia, turn @ dipole)
        assert np.isnan(times(particle))
        with pytest.raises(ValueError, match="`axis` must be given where moments about axes acr"):
            particle.braking_time(1e9)


def test_an_ellipsoid_by_quadrature():
    semi_axes, density = np.array([1e-8, 2e-8, 4e-8]), 3000
    # a product rule, exact for the polynomials below, on the unit ball
    nodes, weights = np.polynomial.legendre.leggauss(6)
    radii, azimuths = (nodes + 1) / 2, 2 * np.pi * np.arange(8) / 8
    r, u, phi = np.meshgrid(radii, nodes, azimuths, indexing="ij")
    across = np.sqrt(1 - u**2)
    ball = r * np.array([across * np.cos(phi), across * np.sin(phi), u])
    weight = (weights / 2)[:, None, None] * weights[None, :, None] * r**2 * (2 * np.pi / 8)
    points = ball.reshape(3, -1) * semi_axes[:, None]
    masses = density * np.prod(semi_axes) * weight.ravel()
    second = (masses * points) @ points.T
    made = Particle.ellipsoid(semi_axes, D, density=density)
    close(made.mass, masses.sum(), 1e-13)
    expected = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(made.inertia, expected, rtol=1e-13, atol=1e-14 * second[2, 2])


def test_the_shapes_agree():
    spheroid = Particle.spheroid(2e-8, 3e-8, D, density=3000)
    in_cgs = 1e3 * CUBOID.mass, 1e7 * CUBOID.inertia, CUBOID.dipole / (1e18 * DEBYE)
    for a, b in (
        (spheroid, Particle.ellipsoid([2e-8, 2e-8, 3e-8], D, density=3000)),
        (Particle.sphere(2e-8, D, density=3000), Particle.spheroid(2e-8, 2e-8, D, density=3000)),
        (spheroid, Particle.spheroid(2e-8, 3e-8, D, mass=spheroid.mass)),
        (ROD, Particle.rod(3e-8, 1e-8, D, mass=ROD.mass)),
        (CUBOID, Particle.gaussian(*in_cgs, radius=1e2 * CUBOID.radius)),
    ):
        for name in ("mass", "inertia", "dipole", "radius"):
            close(getattr(a, name), getattr(b, name), 1e-14)


@pytest.mark.parametrize(
    ("made", "farthest"),
    [
        (Particle.sphere(2e-8, D, density=1), [0, 2e-8, 0]),
        (Particle.spheroid(2e-8, 1e-8, D, density=1), [2e-8, 0, 0]),
        (Particle.spheroid(2e-8, 3e-8, D, density=1), [0, 0, 3e-8]),
        (Particle.ellipsoid([2e-8, 5e-8, 3e-8], D, density=1), [0, 5e-8, 0]),
        (CUBOID, [0.5e-8, 1e-8, 1.5e-8]),
        (Particle.rod(6e-8, 2e-8, D, density=1), [0, 2e-8, 3e-8]),
    ],
)
def test_the_rim(made, farthest):
    close(made.radius, np.linalg.norm(farthest), 1e-15)
    # v = Ω × ρ: no faster about any axis, and as fast about one across the farthest distance
    omegas = SPEED * np.array([*RNG.normal(size=(4, 3)), np.cross(farthest, [1e8, 2e8, 3e8])])
    v = np.linalg.norm(np.cross(omegas, farthest), axis=1) / c
    bounds = np.asarray(made.rim_speed(omegas))
    assert np.all(bounds >= v * (1 - 1e-15))
    close(bounds[-1], v[-1], 1e-14)
    close(made.rim_speed("1 GHz"), made.rim_speed([0, SPEED, 0]), 1e-15)
    close(made.rim_speed(SPEED), SPEED * np.linalg.norm(farthest) / c, 1e-14)


def test_the_rim_of_batches():
    spheres = jax.jit(jax.vmap(lambda radius: Particle.sphere(radius, D, density=2000)))
    grains = spheres(np.array([1e-8, 3e-8]))
    close(grains.rim_speed("1 GHz"), SPEED * np.array([1e-8, 3e-8]) / c, 1e-15)
    assert grains.rim_speed(np.ones((5, 3))).shape == (2, 5)
    slope = jax.jit(jax.grad(lambda omega: CUBOID.rim_speed(omega)))(np.zeros(3))
    np.testing.assert_array_equal(slope, np.zeros(3))


def test_a_particle_as_text():
    grain = Particle(1e-18, np.diag([4e-34, 2e-34, 3e-34]), [0, 100 * DEBYE, 0])
    moments = "moments=(4e-34, 2e-34, 3e-34) kg m²"  # about the body axes
    assert repr(grain) == f"Particle(mass=1e-18 kg, {moments}, dipole=100 D along (0, 1, 0))"
    turned = Particle(1e-18, [[3e-34, 1e-34, 0], [1e-34, 3e-34, 0], [0, 0, 3e-34]], [0, 0, DEBYE])
    assert "moments=(2e-34, 3e-34, 4e-34) kg m², dipole=1 D along (0, 0, 1)" in repr(turned)
    assert repr(CUBOID).endswith(", radius=1.87083e-08 m)")
    spheres = jax.jit(jax.vmap(lambda mass: Particle.sphere(1e-8, grain.dipole, mass=mass)))
    assert repr(spheres(np.array([1e-20, 5e-20]))) == (
        "Particle(2 particles, mass=1e-20 to 5e-20 kg, least moment=4e-37 to 2e-36 kg m², "
        "largest moment=4e-37 to 2e-36 kg m², dipole=100 D, radius=1e-08 m)"
    )
    traced = []
    jax.jit(lambda particle: traced.append(repr(particle)))(grain)
    assert "f64[3,3]" in traced[0]


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
    (lambda: Particle(1, MOMENTS, D).omega(np.inf), "angular_velocity", "be finite", "is inf"),
    (lambda: Particle(1, MOMENTS, D).omega("1"), "angular_velocity", "be a number with", "is '1'"),
    (lambda: Particle(1, MOMENTS, D).angular_velocity("1"), "omega", "be a real number", "is '1'"),
    (lambda: Particle(1, MOMENTS, D).tau(np.nan), "seconds", "be finite", "is nan"),
    (lambda: Particle(1, MOMENTS, D).braking_time(1.0), "axis", "be given where", "is None"),
    (lambda: Particle(1, MOMENTS, D).rim_speed(1.0), "radius", "be given to the", "is None"),
    (lambda: Particle(1, MOMENTS, D, radius=-1), "radius", "be positive", "is -1.0"),
    (lambda: Particle(1e-18, MOMENTS, D, radius=1e-9), "radius", "be at least", "is 1e-09"),
    (lambda: CUBOID.rim_speed(-1.0), "angular_velocity", "not be negative", "is -1.0"),
    (lambda: CUBOID.rim_speed([1.0, 2.0]), "angular_velocity", "have shape (3,)", "has shape"),
    (lambda: Particle.spheroid(1, -1, D, mass=1), "c", "be positive", "is -1.0"),
    (lambda: Particle.ellipsoid([1, 1], D, mass=1), "semi_axes", "have shape (3,)", "has shape"),
    (lambda: Particle.ellipsoid([1, 1, 0], D, mass=1), "semi_axes", "be positive", "has 0"),
    (lambda: Particle(1, MOMENTS, D).braking_time(0, Z), "speed", "be positive", "is 0.0"),
    (lambda: CUBOID.seconds([[1], [1, 2]]), "tau", "be a real", "is [[1], [1, 2]]"),
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


# Magnets


def test_a_magnet_radiates_as_the_dipole_m_over_c():
    moment = [0.0, 3e-16, 4e-16]
    magnet = Particle.magnetic(4e-18, 1e-33 * np.eye(3), moment, radius=5e-8)
    light = 299792458.0
    permeability = 4e-7 * np.pi  # to 1e-9
    close(magnet.tau0(), permeability * 25e-32 / (6 * np.pi * light**3) / 1e-33, 1e-9)
    shape = shapes.Sphere(np.array(5e-8))
    solid = Particle.magnetic(4e-18, shape.inertia(4e-18), moment, shape=shape)
    ball = Particle.sphere(5e-8, magnetic_dipole(moment), mass=4e-18)
    for name in ("mass", "inertia", "dipole", "radius"):
        close(getattr(solid, name), getattr(ball, name), 1e-14)


def test_the_neutron_star_in_the_crab_nebula():
    period, slowing = 0.0334, 4.2e-13
    star = Particle.magnetic(2.8e30, 1e38 * np.eye(3), [3.79e27, 0.0, 0.0])
    spin = 2 * np.pi / period
    # Ω̇ = −τ₀Ω³, so that Ṗ/P = τ₀Ω².
    close(star.tau0() * spin**2, slowing / period, 2e-3)
    close(star.tau0(), 3.553e-16, 2e-3)
    close(star.omega(spin), 6.68e-14, 2e-3)
    close(star.braking_time(spin), 2520 * 3.15576e7, 2e-3)


@pytest.mark.parametrize(
    ("degrees", "index"), [(20, 18.097264340826), (45, 5.0), (60, 11 / 3), (80, 3.0621824)]
)
def test_braking_index_of_an_inclined_sphere(degrees, index):
    """Davis and Goldstein: ΩΩ̈/Ω̇² = 3 + 2cot²α, while Ω cos α stays."""
    equation = Reduced(Body(np.eye(3), [0.0, 0.0, 1.0]), order=1)
    alpha = np.deg2rad(degrees)
    omega = 1e-3 * jnp.array([np.sin(alpha), 0.0, np.cos(alpha)])

    def slowing(omega):
        return omega @ equation(0.0, omega) / jnp.linalg.norm(omega)

    rate = equation(0.0, omega)
    first, second = jax.jvp(slowing, (omega,), (rate,))
    close(1e-3 * second / first**2, index, 1e-7)
    close(rate[2], 0.0, 1e-18)
