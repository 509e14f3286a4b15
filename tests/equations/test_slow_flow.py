"""The closed form of the slow flow, against averages over free rotation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

from dipoletop import Body, radiation
from dipoletop.equations._verdicts.dipole_frame import body_frame
from dipoletop.equations._verdicts.slow_flow import ends_on_axis, slow_flow
from dipoletop.equations.rigid import free_rotation


def averaged_flow(j, dipole, x):
    """Return dh/ds = h⟨R⟩ − ⟨Q⟩ at L² = 1 by Jacobi's functions; R = L·(d₁×d₂) and Q = |d₂|²."""
    p1, p2, p3 = 1 / np.array(j)
    h = p3 + (p2 - p3) * x
    m = (p1 - p2) * (h - p3) / ((p2 - p3) * (p1 - h))
    sn, cn, dn, _ = special.ellipj(4 * special.ellipk(m) * np.arange(64) / 64, m)
    momentum = np.stack(
        [
            np.sqrt((h - p3) / (p1 - p3)) * cn,
            np.sqrt((h - p3) / (p2 - p3)) * sn,
            np.sqrt((p1 - h) / (p1 - p3)) * dn,
        ]
    )
    omega = jnp.asarray(momentum / np.array(j)[:, None])
    body = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, 64)), Body(np.diag(j), dipole)
    )
    first, second = radiation.dipole_derivatives(body, omega, free_rotation(body, omega)[0])
    torque = np.mean(np.sum(momentum * np.cross(first, second, axis=0), axis=0))
    return h * torque - np.mean(np.sum(np.asarray(second) ** 2, axis=0))


@pytest.mark.parametrize("x", [0.05, 0.4, 0.9])
@pytest.mark.parametrize("j", [(0.5, 0.58, 1.0), (0.6, 0.8, 1.0)])
def test_slow_flow_is_the_average_over_free_rotation(j, x):
    p1, p2, p3 = 1 / np.array(j)
    node = [jnp.full((1,), value) for value in (p2 / p1, p3 / p1, x)]
    flow = slow_flow(*node)[0] * p1**4
    exact = averaged_flow(j, [1.0, 0.0, 0.0], x)
    np.testing.assert_allclose(flow, exact, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("largest", "falls"), [(1.2, False), (1.3, False), (1.36, True)])
def test_a_dipole_on_the_middle_axis_ends_in_a_spin_if_the_flow_falls_there(largest, falls):
    j, dipole = (0.55, 0.9, largest), [0.0, 1.0, 0.0]
    assert (averaged_flow(j, dipole, 1e-3) < 0) == falls
    frame = body_frame(Body(np.diag(j), dipole))
    assert bool(ends_on_axis(frame.of(jnp.array([0.1, 0.02, 0.3])))) == falls
