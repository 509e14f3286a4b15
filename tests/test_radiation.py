"""The radiation torque against its definition d × d⃛ and against the balance laws.

The motion is an arbitrary smooth rotation, given by its Taylor series: none of the body-frame
formulas under test is used to obtain what they are compared with.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop import radiation
from dipoletop.bodies import from_charges

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


def test_all_laws_hold_along_any_motion():
    for motion in RNG.normal(size=(MOTIONS, 5, 4)):
        pairs = both_sides(random_body(RNG), rotation(motion))
        for law, (formula, truth) in pairs.items():
            scale = np.linalg.norm(pairs["torque"][1]) + np.linalg.norm(truth)
            np.testing.assert_allclose(formula, truth, rtol=0, atol=1e-11 * scale, err_msg=law)


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


def stacked(*parts):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *parts)


RATES = {
    **dict.fromkeys(("angular_momentum", "kinetic_energy", "gyroscopic_torque"), 1),
    **dict.fromkeys(("dipole_derivatives", "radiated_power", "schott_energy"), 2),
    **{"schott_angular_momentum": 2, "radiation_torque": 3},
}


@pytest.mark.parametrize("shared", ["body", "motion", "nothing"])
@pytest.mark.parametrize("name", RATES)
def test_lanes_equal_single_tops(name, shared):
    quantity, bodies = getattr(radiation, name), [random_body(RNG) for _ in range(LANES)]
    motions = jnp.asarray(RNG.normal(size=(RATES[name], 3, LANES)))
    if shared == "body":
        bodies = bodies[:1] * LANES
    if shared == "motion":
        motions = jnp.broadcast_to(motions[..., :1], motions.shape)
    together = quantity(
        bodies[0] if shared == "body" else stacked(*bodies),
        *(motions[..., 0] if shared == "motion" else motions),
    )
    expected = stacked(*(quantity(bodies[i], *motions[..., i]) for i in range(LANES)))
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13), together, expected
    )
