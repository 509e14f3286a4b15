"""Vectors and 3×3 matrices against numpy, and that lanes broadcast."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop._base.linalg import cross, dot, inverse, matvec, scale, solve

RNG = np.random.default_rng(7)
LANES = 5
MATRICES = RNG.normal(size=(3, 3, LANES))
VECTORS = RNG.normal(size=(2, 3, LANES))

# each operation with the natural ranks of its operands and numpy's word for it
OPERATIONS = [
    (scale, (0, 1), lambda s, a: s * a),
    (dot, (1, 1), np.dot),
    (cross, (1, 1), np.cross),
    (matvec, (2, 1), np.matmul),
    (solve, (2, 1), np.linalg.solve),
    (inverse, (2,), np.linalg.inv),
]
CASES = [
    (operation, ranks, reference, batched)
    for operation, ranks, reference in OPERATIONS
    for batched in itertools.product([False, True], repeat=len(ranks))
]


@pytest.mark.parametrize(("operation", "ranks", "reference", "batched"), CASES)
def test_agrees_with_numpy_in_every_lane(operation, ranks, reference, batched):
    pools = {0: VECTORS[:, 0], 1: VECTORS, 2: np.stack([MATRICES, MATRICES])}
    operands = [pools[rank][place] for place, rank in enumerate(ranks)]
    given = [x if b else x[..., 0] for x, b in zip(operands, batched, strict=True)]
    result = operation(*map(jnp.asarray, given))
    lanes = [
        reference(*(x[..., lane if b else 0] for x, b in zip(operands, batched, strict=True)))
        for lane in range(LANES)
    ]
    expected = np.stack(lanes, axis=-1) if any(batched) else lanes[0]
    assert result.shape == expected.shape
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-13)
