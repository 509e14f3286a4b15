"""The radiation torque against its definition d × d⃛ and against the balance laws.

The motion is an arbitrary smooth rotation, and every time derivative is automatic: none of the
body-frame formulas under test is used to obtain what they are compared with.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop import radiation
from dipoletop.bodies import Body, axisymmetric, from_charges

RNG = np.random.default_rng(11)
MOTIONS = 12
LANES = 6


def random_body(rng):
    """A body without any symmetry, its dipole along no principal axis."""
    masses, positions = rng.uniform(0.5, 1.5, 6), rng.normal(size=(6, 3))
    return from_charges(masses, positions, rng.normal(size=6))


def rate(f):
    """Time derivative of f(t)."""
    return lambda t: jax.jvp(f, (t,), (jnp.ones_like(t),))[1]


def rotation(coefficients):
    """R(t), from body to lab: a quaternion polynomial in t, normalised."""

    def matrix(t):
        q = coefficients @ t ** jnp.arange(5.0)
        w, x, y, z = q / jnp.sqrt(jnp.sum(q**2))
        return jnp.stack(
            [
                jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
                jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
                jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
            ]
        )

    return matrix


@jax.jit
def both_sides(body, coefficients, t):
    """For one motion at one time: pairs (formula, definition or balance law)."""
    turn = rotation(coefficients)

    def omega(t):  # Ω from Rᵀ dR/dt, the matrix of Ω×
        spin = turn(t).T @ rate(turn)(t)
        return jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])

    def dipole(t):
        return turn(t) @ body.dipole

    def torque(t):
        rates = omega(t), rate(omega)(t), rate(rate(omega))(t)
        return radiation.radiation_torque(body, *rates)

    def of_motion(quantity):
        return lambda t: quantity(body, omega(t), rate(omega)(t))

    r, d1, d2 = turn(t), rate(dipole)(t), rate(rate(dipole))(t)
    first, second = of_motion(radiation.dipole_derivatives)(t)
    lab_momentum = lambda t: turn(t) @ radiation.angular_momentum(body, omega(t))  # noqa: E731
    lent = lambda t: turn(t) @ of_motion(radiation.schott_angular_momentum)(t)  # noqa: E731
    energy = lambda t: radiation.kinetic_energy(body, omega(t))  # noqa: E731
    euler = body.inertia @ rate(omega)(t) + radiation.gyroscopic_torque(body, omega(t))
    power = of_motion(radiation.radiated_power)
    return {
        "first derivative": (r @ first, d1),
        "second derivative": (r @ second, d2),
        "torque": (r @ torque(t), jnp.cross(dipole(t), rate(rate(rate(dipole)))(t))),
        "power": (power(t), jnp.sum(d2**2)),
        "energy balance": (
            jnp.sum(omega(t) * torque(t)),
            rate(of_motion(radiation.schott_energy))(t) - power(t),
        ),
        "angular momentum balance": (r @ torque(t), rate(lent)(t) - jnp.cross(d1, d2)),
        "Euler's equation": (r @ euler, rate(lab_momentum)(t)),
        "rate of energy": (rate(energy)(t), jnp.sum(omega(t) * euler)),
        "no torque along the dipole": (jnp.sum(torque(t) * body.dipole), 0.0),
    }


@pytest.fixture(scope="module")
def pairs():
    found = []
    for _ in range(MOTIONS):
        coefficients = jnp.asarray(RNG.normal(size=(4, 5)))
        found.append(both_sides(random_body(RNG), coefficients, jnp.asarray(RNG.uniform(-1, 1))))
    return found


@pytest.mark.parametrize(
    "law",
    [
        "first derivative",
        "second derivative",
        "torque",
        "power",
        "energy balance",
        "angular momentum balance",
        "Euler's equation",
        "rate of energy",
        "no torque along the dipole",
    ],
)
def test_holds_along_any_motion(pairs, law):
    for motion in pairs:
        formula, truth = motion[law]
        scale = np.linalg.norm(motion["torque"][1]) + np.linalg.norm(truth)
        np.testing.assert_allclose(formula, truth, rtol=0, atol=1e-11 * scale)


def test_energy_and_angular_momentum_are_sums_over_the_masses():
    masses, positions = RNG.uniform(1, 2, 5), RNG.normal(size=(5, 3))
    omega = jnp.asarray(RNG.normal(size=3))
    body = from_charges(masses, positions, RNG.normal(size=5))
    rho = positions - np.average(positions, axis=0, weights=masses)
    velocity = np.cross(omega, rho)
    np.testing.assert_allclose(
        radiation.kinetic_energy(body, omega), np.sum(masses[:, None] * velocity**2) / 2, rtol=1e-13
    )
    np.testing.assert_allclose(
        radiation.angular_momentum(body, omega), masses @ np.cross(rho, velocity), rtol=1e-12
    )


def test_uniform_rotation_radiates_by_larmor():
    # a dipole at the angle θ to the axis: |d₂|² = |d|² Ω⁴ sin²θ, and no energy is lent
    angle, speed = 0.7, 1.3
    body = Body(jnp.eye(3), [2 * np.sin(angle), 0, 2 * np.cos(angle)])
    omega, rest = jnp.array([0.0, 0.0, speed]), jnp.zeros(3)
    power = radiation.radiated_power(body, omega, rest)
    np.testing.assert_allclose(power, 4 * speed**4 * np.sin(angle) ** 2, rtol=1e-14)
    assert radiation.schott_energy(body, omega, rest) == pytest.approx(0, abs=1e-14)


def test_plane_rotator_feels_equation_2_2():
    w, w1, w2 = 0.3, -1.1, 0.7
    z = jnp.array([0.0, 0.0, 1.0])
    torque = radiation.radiation_torque(axisymmetric(0.3), w * z, w1 * z, w2 * z)
    np.testing.assert_allclose(torque, (w2 - w**3) * z, atol=1e-15)


@pytest.mark.parametrize("one_body", [True, False])
@pytest.mark.parametrize(
    ("name", "rates"),
    [
        ("angular_momentum", 1),
        ("kinetic_energy", 1),
        ("gyroscopic_torque", 1),
        ("dipole_derivatives", 2),
        ("radiated_power", 2),
        ("schott_energy", 2),
        ("schott_angular_momentum", 2),
        ("radiation_torque", 3),
    ],
)
def test_lanes_equal_single_tops(name, rates, one_body):
    quantity = getattr(radiation, name)
    bodies = [random_body(RNG)] * LANES if one_body else [random_body(RNG) for _ in range(LANES)]
    block = (
        bodies[0] if one_body else jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *bodies)
    )
    motion = jnp.asarray(RNG.normal(size=(rates, 3, LANES)))
    together = quantity(block, *motion)
    one_by_one = [quantity(bodies[i], *motion[..., i]) for i in range(LANES)]
    expected = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *one_by_one)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13), together, expected
    )


def test_a_block_of_bodies_in_one_motion():
    bodies = [random_body(RNG) for _ in range(LANES)]
    block = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *bodies)
    motion = jnp.asarray(RNG.normal(size=(3, 3)))
    expected = jnp.stack([radiation.radiation_torque(b, *motion) for b in bodies], axis=-1)
    np.testing.assert_allclose(
        radiation.radiation_torque(block, *motion), expected, rtol=1e-13, atol=1e-13
    )
