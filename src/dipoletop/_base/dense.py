"""Systems of linear equations with some dozen unknowns, one after another on a CPU."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.custom_jvp
def solve(matrix: Float[Array, "m m"], sides: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """Solutions x of matrix x = sides.

    Of batches, too. `jnp.linalg.solve` must not have these on a CPU: XLA hands each to the threads
    that run the program and waits for them, on one of them, so that two at once wait for ever.
    """
    return jax.lax.platform_dependent(matrix, sides, cpu=_alone, default=jnp.linalg.solve)


@solve.defjvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    (matrix, sides), (turn, shift) = primals, tangents
    x = solve(matrix, sides)
    return x, solve(matrix, shift - jnp.matmul(turn, x, precision="highest"))


@jax.custom_batching.custom_vmap
def _alone(matrix: Array, sides: Array) -> Array:
    return jnp.linalg.solve(matrix, sides)


@_alone.def_vmap
def _(size: int, batched: list[bool], matrix: Array, sides: Array) -> tuple[Array, bool]:
    many, _ = batched
    if many:
        sides = jnp.broadcast_to(sides, (size, *sides.shape[-2:]))
        return jax.lax.map(lambda system: _alone(*system), (matrix, sides)), True
    beside = jnp.moveaxis(sides, 0, -1)  # of one matrix: more sides
    found = _alone(matrix, beside.reshape(len(matrix), -1))
    return jnp.moveaxis(found.reshape(beside.shape), -1, 0), True
