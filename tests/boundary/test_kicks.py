"""The smallest kick against many random smaller ones, and against a bisection."""

import jax.numpy as jnp
import numpy as np
import pytest
from slow_tops import DELTA, RESIDUAL, ROTATING

import dipoletop as dt
from dipoletop import boundary


@pytest.mark.slow
def test_no_smaller_kick_changes_the_fate():
    equation, start = dt.TransverseReduced(DELTA), np.array([0.15, 0.1, 0.12])
    least = boundary.minimal_kick(equation, start, directions=60, radii=12)
    assert tuple(least.fates) == (ROTATING, RESIDUAL)
    assert least.defect < 1e-6
    rng = np.random.default_rng(5)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    size = least.size * np.where(np.arange(500) < 400, 0.999, rng.uniform(size=500))
    kicks = np.concatenate([d * size[:, None], [0.999 * least.kick, least.kick]])
    w1, w2, w3 = (start + kicks).T

    def problem(w1, w2, w3):
        return equation, jnp.stack([w1, w2, w3])

    points = dt.Points(w1=w1, w2=w2, w3=w3)
    basin = dt.sweep(problem, points, rtol=1e-10, value="unchecked")
    np.testing.assert_array_equal(boundary.fate(basin), [ROTATING] * 501 + [RESIDUAL])


@pytest.mark.slow
def test_a_kick_along_one_component_is_a_bisection():
    equation, start = dt.TransverseReduced(DELTA), np.array([0.15, 0.1, 0.12])
    kick = boundary.minimal_kick(equation, start, components=[3], radii=12)
    found = boundary.bisect(
        lambda w3: (equation, jnp.stack([0.15, 0.1, w3])), {"w3": 0.12}, {"w3": 0.06}
    )
    np.testing.assert_allclose(kick.kick, [0.0, 0.0, found.after["w3"][0] - 0.12], rtol=1e-9)
    assert kick.defect == 0
