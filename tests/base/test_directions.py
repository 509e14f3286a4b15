"""Directions spread over a sphere: their moments are those of isotropic ones."""

import numpy as np

from dipoletop._base.directions import spread_directions


def test_moments_are_isotropic():
    n = 400
    x = spread_directions(n)
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(np.mean(x, axis=0), 0, atol=1 / n)
    np.testing.assert_allclose(x.T @ x / n, np.eye(3) / 3, atol=1 / n)
    np.testing.assert_allclose(np.mean(x**4, axis=0), 1 / 5, atol=1 / n)
    # No two of them are closer than the spiral is wide.
    cosines = x @ x.T - 2 * np.eye(n)
    assert np.max(np.arccos(np.max(cosines, axis=1))) < 2 * np.sqrt(4 * np.pi / n)
    assert np.min(np.arccos(np.max(cosines, axis=1))) > 0.7 * np.sqrt(4 * np.pi / n)
