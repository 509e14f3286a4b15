"""The radiation torque against its definition d × d⃛ and against the balance laws.

The motion is an arbitrary smooth rotation, given by its Taylor series: none of the body-frame
formulas under test is used to obtain what they are compared with.
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


def product(a, b):
    """Of two Taylor series of matrices, to the order that both have."""
    return np.stack(
        [sum(a[i] @ b[k - i] for i in range(k + 1)) for k in range(min(map(len, (a, b))))]
    )


def rate(a):
    """Time derivative of a Taylor series."""
    return a[1:] * np.arange(1, len(a)).reshape(-1, *[1] * (a.ndim - 1))


def rotation(quaternion):
    """R, from body to lab, as a series: a quaternion polynomial in time, normalised."""
    terms = len(quaternion)
    # The matrix is quadratic in the quaternion: that of a sum of powers, by polarisation.
    turn, square = np.zeros((terms, 3, 3)), np.zeros(terms)
    for i, p in enumerate(quaternion):
        for j, q in enumerate(quaternion[: terms - i]):
            cross = np.cross(np.eye(3), q[1:]).T
            turn[i + j] += (p[0] * q[0] - p[1:] @ q[1:]) * np.eye(3)
            turn[i + j] += 2 * (np.outer(p[1:], q[1:]) + p[0] * cross)
            square[i + j] += p @ q
    for k in range(terms):  # divided by |q|²
        turn[k] = (turn[k] - sum(square[i] * turn[k - i] for i in range(1, k + 1))) / square[0]
    return turn


@jax.jit
def formulas(body, omega, first, second):
    """Every quantity of the module, and how those that balance change."""

    def along(quantity):
        return jax.jvp(lambda *x: quantity(body, *x), (omega, first), (first, second))

    return {
        "derivatives": radiation.dipole_derivatives(body, omega, first),
        "torque": radiation.radiation_torque(body, omega, first, second),
        "power": radiation.radiated_power(body, omega, first),
        "gyroscopic": radiation.gyroscopic_torque(body, omega),
        "energy": along(lambda body, w, _: radiation.kinetic_energy(body, w)),
        "momentum": along(lambda body, w, _: radiation.angular_momentum(body, w)),
        "lent energy": along(radiation.schott_energy),
        "lent momentum": along(radiation.schott_angular_momentum),
    }


def both_sides(body, turn):
    """For one motion at one time: pairs (formula, definition or balance law)."""
    spin = product(turn.transpose(0, 2, 1), rate(turn))  # the matrix of Ω×
    np.testing.assert_allclose(spin, -spin.transpose(0, 2, 1), atol=1e-12)
    omega = spin[:, [2, 0, 1], [1, 2, 0]]
    rates = [series[0] for series in (omega, rate(omega), rate(rate(omega)))]
    found = jax.tree.map(np.asarray, formulas(body, *map(jnp.asarray, rates)))
    dipole = turn @ np.asarray(body.dipole)
    d0, d1, d2, d3 = dipole[:4] * np.array([1.0, 1.0, 2.0, 6.0])[:, None]
    r, turning = turn[0], turn[1]
    first, second = found["derivatives"]
    torque, power = found["torque"], found["power"]
    euler = np.asarray(body.inertia) @ rates[1] + found["gyroscopic"]

    def lab_rate(name):  # of a vector given in body axes
        vector, change = found[name]
        return turning @ vector + r @ change

    return {
        "first derivative": (r @ first, d1),
        "second derivative": (r @ second, d2),
        "torque": (r @ torque, np.cross(d0, d3)),
        "power": (power, d2 @ d2),
        "energy balance": (rates[0] @ torque, found["lent energy"][1] - power),
        "angular momentum balance": (r @ torque, lab_rate("lent momentum") - np.cross(d1, d2)),
        "Euler's equation": (r @ euler, lab_rate("momentum")),
        "rate of energy": (found["energy"][1], rates[0] @ euler),
        "no torque along the dipole": (torque @ body.dipole, 0.0),
    }


@pytest.fixture(scope="module")
def pairs():
    motions = RNG.normal(size=(MOTIONS, 5, 4))
    return [both_sides(random_body(RNG), rotation(motion)) for motion in motions]


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
