"""Ends of many motions at once: against those of single motions, and known classes of bodies."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dipoletop._averaging.laws import Needle, averaged_end
from dipoletop._averaging.untimed_ends import ends_of_many
from dipoletop._base.types import Outcome

RNG = np.random.default_rng(0)


def test_a_top_with_its_dipole_along_its_axis_keeps_that_part_of_its_momentum():
    moments = RNG.uniform(0.5, 1.0, (100, 3))
    moments[:, 1] = moments[:, 0]
    omegas = 1e-20 * RNG.normal(size=(100, 3))
    ends = ends_of_many(moments[:, :, None] * np.eye(3), np.tile([0.0, 0, 1], (100, 1)), omegas)
    momenta = moments * omegas
    ratios = np.abs(momenta[:, 2]) / np.linalg.norm(momenta, axis=1)
    np.testing.assert_allclose(ends.ratio, ratios, 1e-13)
    np.testing.assert_allclose(ends.omega_inf, omegas[:, 2], 1e-13)


@pytest.mark.slow
def test_ends_are_those_of_single_motions():
    """Panels that are not as short as times need them, and stages computed apart."""
    n = 60
    moments = np.sort(RNG.uniform(0.5, 1.0, (n, 3)))
    moments[:6, 1], moments[6:9, :2] = moments[:6, 0], moments[6:9, 2:]  # discs, spheres
    dipoles = np.eye(3)[RNG.integers(0, 3, n)]
    dipoles[20:30] += 1e-3 * RNG.normal(size=(10, 3))
    dipoles[30:40] = RNG.normal(size=(10, 3))
    omegas = RNG.normal(size=(n, 3)) * 10.0 ** RNG.uniform(-25, -3, (n, 1))
    omegas[10, 1:] = omegas[11, :2] = 0.0  # spins about principal axes
    omegas[12, 1:] *= 1e-9
    inertias = moments[:, :, None] * np.eye(3)
    many = ends_of_many(inertias, dipoles, omegas)
    variables = np.concatenate([inertias.reshape(n, 9), dipoles, omegas], axis=1)
    single = [
        averaged_end(jnp.asarray(row), jnp.asarray(np.float64(1)), Needle.NO) for row in variables
    ]
    for name, values in vars(many).items():
        expected = [np.asarray(getattr(one, name)) for one in single]
        known = ~np.isnan(values) | (name not in ("half_time", "lifetime"))
        # An error is taken at the knots, and that of one motion covers its times.
        rtol, atol = (0.3, 3e-7) if name == "error" else (1e-9, 0.0)
        found, expected = values[known], np.array(expected)[known]
        np.testing.assert_allclose(found, expected, rtol, atol, err_msg=name)


@pytest.mark.slow
def test_a_dipole_along_an_axis_is_along_it_in_any_frame():
    """Rounding of a turned body is no component across the axis, which would end in a stop."""
    turns = Rotation.random(60, random_state=1).as_matrix()
    inertia = np.einsum("nij,j,nkj->nik", turns, [1.0, 1.3, 1.8], turns)
    omega = turns @ np.array([3e-4, 2e-4, 1e-3])
    ends = ends_of_many((inertia + inertia.transpose(0, 2, 1)) / 2, 1.5 * turns[:, :, 2], omega)
    assert np.all(ends.outcome == Outcome.RESIDUAL)
