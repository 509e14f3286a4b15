"""Starts with a given rotation frequency L·Ω/L."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop import axisymmetric
from dipoletop.particles import DEBYE, Particle, start

RNG = np.random.default_rng(24)
DIPOLE = 2400 * DEBYE * np.array([0.6, 0.0, 0.8])
SPEED = 2e9 * np.pi
BODY = axisymmetric(-0.2)


def turned(moments):
    """An inertia tensor with its principal axes at random."""
    axes, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    return axes @ np.diag(moments) @ axes.T


def frequency(inertia, omega):
    """L·Ω/L, by NumPy."""
    momentum = inertia @ omega
    return momentum @ omega / np.linalg.norm(momentum)


GRAIN = Particle(1e-18, turned([2e-40, 3e-40, 4e-40]), DIPOLE)


@pytest.mark.parametrize("moments", [[2, 3, 4], [1e-4, 1, 1], [1, 1, 1], [1, 1, 2]])
def test_the_spin_and_the_direction_are_those_given(moments):
    inertia = turned(np.array(moments) * 1e-40)
    grain = Particle(1e-18, inertia, DIPOLE)
    rounding = 1e-14 * moments[2] / moments[0]  # of I⁻¹
    for direction in RNG.normal(size=(3, 3)) * 1e3:
        unit = direction / np.linalg.norm(direction)
        by_momentum = np.asarray(start(grain, "1 GHz", momentum=direction))
        by_axis = np.asarray(start(grain, "1 GHz", axis=direction))
        for omega in by_momentum, by_axis:
            np.testing.assert_allclose(frequency(inertia, omega), SPEED, rtol=rounding)
        momentum = inertia @ by_momentum
        along = momentum / np.linalg.norm(momentum)
        np.testing.assert_allclose(along, unit, atol=rounding)
        np.testing.assert_allclose(by_axis / np.linalg.norm(by_axis), unit, atol=1e-15)


def test_about_a_principal_axis_the_spin_is_the_speed():
    grain = Particle.cuboid([3e-8, 2e-8, 1e-8], DIPOLE, density=2000)
    for axis in np.eye(3):
        for given in {"axis": axis}, {"momentum": axis}:
            np.testing.assert_allclose(start(grain, SPEED, **given), SPEED * axis, rtol=4e-16)


def test_the_units_of_a_body_are_those_of_its_particle():
    direction = [0.3, -0.5, 0.7]
    for axis in None, [1.0, 2.0, 3.0]:
        si = start(GRAIN, SPEED, momentum=direction)
        spin = GRAIN.omega(SPEED, axis)
        dimensionless = start(GRAIN.body(axis), spin, momentum=direction)
        np.testing.assert_allclose(GRAIN.omega(si, axis), dimensionless, rtol=1e-14)


def test_batches_and_derivatives():
    spins, directions = np.array([1e9, 2e9]), RNG.normal(size=(2, 3))
    one_by_one = [start(GRAIN, s, momentum=x) for s, x in zip(spins, directions, strict=True)]
    np.testing.assert_allclose(start(GRAIN, spins, momentum=directions), one_by_one, rtol=1e-14)
    same = jax.jit(jax.vmap(lambda s, x: start(GRAIN, s, momentum=x)))(spins, directions)
    np.testing.assert_allclose(same, one_by_one, rtol=1e-13)
    assert start(GRAIN, spins, axis=[0, 0, 1]).shape == (2, 3)
    spheres = jax.jit(jax.vmap(lambda density: Particle.sphere(1e-8, DIPOLE, density=density)))
    grains = spheres(np.array([1000.0, 2000.0, 3000.0]))
    np.testing.assert_allclose(start(grains, 2.0, axis=[0, 0, 1]), [[0, 0, 2]] * 3, rtol=1e-15)
    assert start(grains, spins, momentum=directions).shape == (3, 2, 3)
    # Ω is proportional to the spin, and does not change with the length of the direction
    by_spin = jax.jit(jax.jacobian(lambda s: start(GRAIN, s, momentum=directions[0])))(spins[0])
    np.testing.assert_allclose(by_spin, one_by_one[0] / spins[0], rtol=1e-14)
    slopes = jax.jit(jax.jacobian(lambda x: start(GRAIN, 1.0, momentum=x)))(directions[0])
    np.testing.assert_allclose(slopes @ directions[0], 0, atol=1e-14)
    assert np.linalg.norm(slopes) > 0.1


def test_a_traced_bad_start_is_nan_in_its_own_lane():
    spins = jnp.array([1.0, -1.0, 1.0])
    axes = jnp.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 0]])
    found = jax.vmap(lambda s, x: start(BODY, s, axis=x))(spins, axes)
    np.testing.assert_array_equal(np.isnan(found).any(axis=-1), [False, True, True])


Z = [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("make", "name", "text"),
    [
        (lambda: start(3, 1.0, axis=Z), "body", "be a Body or a Particle, but is 3"),
        (lambda: start(BODY, 1.0), "momentum", "be given or else `axis`, but neither is"),
        (lambda: start(BODY, 1.0, axis=Z, momentum=Z), "momentum", "be given or else `axis`, but"),
        (lambda: start(BODY, 0.0, axis=Z), "spin", "be positive, but is 0.0"),
        (lambda: start(GRAIN, "0 Hz", axis=Z), "spin", "be positive, but is 0.0"),
        (lambda: start(GRAIN, "1", axis=Z), "spin", "be a number with a unit among"),
        (lambda: start(BODY, "1 GHz", axis=Z), "spin", "be a number, since a Body has no unit"),
        (lambda: start(BODY, 1.0, axis=[0, 0, 0]), "axis", "not be zero, but has 0, 0, 0"),
        (lambda: start(BODY, 1.0, momentum=[1, 0]), "momentum", "have shape (3,), or one batch"),
        (
            lambda: start(BODY, [1.0, 2.0], axis=[Z] * 3),
            "axis",
            "have the batch size 2 of `spin`, but has 3",
        ),
    ],
)
def test_refusals(make, name, text):
    with pytest.raises(ValueError, match="^" + re.escape(f"Argument `{name}` must {text}")):
        make()
