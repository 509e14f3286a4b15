"""Vectors and 3×3 matrices with their components on the leading axes.

Trailing axes (lanes) broadcast, so one line of physics serves a single top and a block of tops.
The operations are written out in components, because XLA fuses these and does not fuse batched
library calls on 3×3 matrices.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import namespace
from .types import Matrix, Real, Vector


def components(a: Any) -> Any:
    """Return the entries of a vector, or the rows of a matrix: one operation in a trace."""
    return jnp.unstack(a) if isinstance(a, jax.Array) else a


def largest(a: Array) -> Real:
    """Return the largest component, by a chain of `maximum`; XLA:CPU does not vectorise `max`."""
    return functools.reduce(jnp.maximum, components(a))


def length(a: Vector) -> Real:
    """Return |a|, without underflow of the squares."""
    sizes = jnp.abs(a)
    most = largest(sizes)
    unit = jnp.where(most > 0, most, 1.0)
    x, y, z = components(sizes)
    return most * jnp.sqrt((x / unit) ** 2 + (y / unit) ** 2 + (z / unit) ** 2)


def scale(s: Real, a: Vector) -> Vector:
    """Return s a."""
    return jnp.stack([s * x for x in components(a)])


def dot(a: Vector, b: Vector) -> Real:
    """Return a·b."""
    return _dot(components(a), components(b))


def cross(a: Vector, b: Vector) -> Vector:
    """Return a×b."""
    return jnp.stack(_cross(components(a), components(b)))


def matvec(m: Matrix, a: Vector) -> Vector:
    """Return m a."""
    a = components(a)
    return jnp.stack([_dot(components(row), a) for row in components(m)])


def trace(m: Matrix) -> Real:
    """Return the sum of the diagonal."""
    return m[0, 0] + m[1, 1] + m[2, 2]


def solve(m: Matrix, b: Vector) -> Vector:
    """Return the solution x of m x = b, by Cramer's rule (the written-out adjugate)."""
    rows, det = _adjugate(m)
    b = components(b)
    return jnp.stack([_dot(column, b) / det for column in zip(*rows, strict=True)])


def inverse(m: Matrix) -> Matrix:
    """Return the inverse of m."""
    rows, det = _adjugate(m)
    return jnp.stack([jnp.stack(column) for column in zip(*rows, strict=True)]) / det[None, None]


def _dot(a: Any, b: Any) -> Any:
    (a1, a2, a3), (b1, b2, b3) = a, b
    return a1 * b1 + a2 * b2 + a3 * b3


def _cross(a: Any, b: Any) -> list[Any]:
    (a1, a2, a3), (b1, b2, b3) = a, b
    return [a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1]


def _adjugate(m: Matrix) -> tuple[list[list[Any]], Any]:
    """Return the rows of the transposed adjugate of m, and the determinant."""
    r1, r2, r3 = (components(row) for row in components(m))
    rows = [_cross(r2, r3), _cross(r3, r1), _cross(r1, r2)]
    return rows, _dot(r1, rows[0])


def diagonal(*entries: Any) -> Any:
    """Return the diagonal matrix of these entries, its two axes behind any others.

    It is an array of NumPy if the entries are.
    """
    xp, zero = namespace(*entries), 0 * entries[0]
    rows = [[entry if i == j else zero for j in range(3)] for i, entry in enumerate(entries)]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def running_sums(values: Float[Array, "n"]) -> Float[Array, "n+1"]:
    """Return the sums of the first 0, 1, 2, … values."""
    return jnp.append(jnp.zeros(1, values.dtype), jnp.cumsum(values))
