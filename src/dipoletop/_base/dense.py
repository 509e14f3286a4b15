"""Dense linear systems with some dozen unknowns; on a CPU a batch is solved in sequence.

`jnp.linalg.solve` must not have a batch on a CPU. With jaxlib 0.10 XLA runs independent operations
of a program on the threads of a pool. Each batched call of LAPACK hands its systems to the same
pool (`ParallelBatchMap`) and waits for them on one of its threads. If there are as many such calls
as threads, all wait for ever:

    m = jnp.broadcast_to(jnp.eye(96) + 0.01, (8, 4, 96, 96))
    jax.jit(lambda m: [jnp.linalg.solve(x, x[..., :7]) for x in m])(m)  # does not return

See https://github.com/jax-ml/jax/pull/39383, according to which later public versions of jaxlib
solve the systems of a batch in sequence, too.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.custom_jvp
def solve_dense(matrix: Float[Array, "m m"], sides: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """Return the solutions x of matrix x = sides; may be vmapped and differentiated."""
    return jax.lax.platform_dependent(matrix, sides, cpu=_one_by_one, default=jnp.linalg.solve)


@solve_dense.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    (matrix, sides), (matrix_dot, sides_dot) = primals, tangents
    x = solve_dense(matrix, sides)
    return x, solve_dense(matrix, sides_dot - jnp.matmul(matrix_dot, x, precision="highest"))


@jax.custom_batching.custom_vmap
def _one_by_one(matrix: Array, sides: Array) -> Array:
    return jnp.linalg.solve(matrix, sides)


@_one_by_one.def_vmap
def _(
    size: int, batched: list[bool], matrix: Float[Array, "..."], sides: Float[Array, "..."]
) -> tuple[Array, bool]:
    many_matrices, _ = batched
    if many_matrices:
        sides = jnp.broadcast_to(sides, (size, *sides.shape[-2:]))
        return jax.lax.map(lambda system: _one_by_one(*system), (matrix, sides)), True
    columns = jnp.moveaxis(sides, 0, -1)  # right-hand sides of a batch become columns
    x = _one_by_one(matrix, columns.reshape(len(matrix), -1))
    return jnp.moveaxis(x.reshape(columns.shape), -1, 0), True
