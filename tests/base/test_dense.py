"""Dense linear systems: against numpy in every kind of batch, and side by side without end."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop._base.dense import solve_dense

RNG = np.random.default_rng(8)
MATRICES = np.eye(6) + 0.3 * RNG.normal(size=(2, 3, 6, 6))
SIDES = RNG.normal(size=(2, 3, 6, 4))

BESIDE = """
import jax, jax.numpy as jnp
from dipoletop._base.dense import solve_dense
matrices = jnp.eye(96, dtype="float32") + 0.01 * jnp.arange(8.0)[:, None, None, None]
matrices = jnp.broadcast_to(matrices, (8, 4, 96, 96))
every = jax.jit(lambda matrices: [jax.vmap(solve_dense)(m, m[..., :7]) for m in matrices])
for _ in range(20):
    jax.block_until_ready(every(matrices))
"""


@pytest.mark.parametrize("batched", [(0, 0), (0, None), (None, 0)])
@pytest.mark.parametrize("twice", [False, True])
def test_agrees_with_numpy_in_every_batch(batched, twice):
    single = [x if b == 0 else x[:, 0] for x, b in zip((MATRICES, SIDES), batched, strict=True)]
    if not twice:
        single = [x[0] for x in single]
    many = jax.vmap(solve_dense, in_axes=batched)
    result = jax.jit(jax.vmap(many) if twice else many)(*single)
    whole = [x if b == 0 else x[..., None, :, :] for x, b in zip(single, batched, strict=True)]
    np.testing.assert_allclose(result, np.linalg.solve(*whole), rtol=1e-12, atol=1e-13)


def test_differentiates_twice_in_a_batch():
    def moved(t, matrix, side):
        return solve_dense(matrix + t * jnp.eye(6), side)

    def both(matrix, side):
        first = jax.jacfwd(moved)
        return first(0.0, matrix, side), jax.jacfwd(first)(0.0, matrix, side)

    first, second = jax.jit(jax.vmap(both))(MATRICES[0], SIDES[0])
    inverse = np.linalg.inv(MATRICES[0])
    slope = -inverse @ inverse @ SIDES[0]  # d/dt (M + t)⁻¹ = −(M + t)⁻²
    np.testing.assert_allclose(first, slope, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(second, -2 * inverse @ slope, rtol=1e-11, atol=1e-12)


@pytest.mark.system
def test_batches_that_one_program_solves_side_by_side_come_to_an_end():
    # (With `jnp.linalg.solve` they wait for each other, on machines with more than one core.)
    subprocess.run([sys.executable, "-c", BESIDE], check=True, timeout=300)
