"""Vectors and 3×3 matrices with their components on the leading axes.

Trailing axes (lanes) broadcast, so one line of physics serves a single top and a block of tops.
The operations are written out in components, because XLA fuses these and does not fuse batched
library calls on 3×3 matrices.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import namespace
from .types import Matrix, Real, Vector


def largest(components: Array) -> Real:
    """Return the largest component, by a chain of `maximum`; XLA:CPU does not vectorise `max`."""
    return functools.reduce(jnp.maximum, list(components))


def length(a: Vector) -> Real:
    """Return |a|, without underflow of the squares."""
    sizes = jnp.abs(a)
    most = largest(sizes)
    unit = jnp.where(most > 0, most, 1.0)
    squares = (sizes[0] / unit) ** 2 + (sizes[1] / unit) ** 2 + (sizes[2] / unit) ** 2
    return most * jnp.sqrt(squares)


def scale(s: Real, a: Vector) -> Vector:
    """Return s a."""
    return jnp.stack([s * a[0], s * a[1], s * a[2]])


def dot(a: Vector, b: Vector) -> Real:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a×b."""
    return jnp.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def matvec(m: Matrix, a: Vector) -> Vector:
    """Return m a."""
    return jnp.stack([dot(m[0], a), dot(m[1], a), dot(m[2], a)])


def trace(m: Matrix) -> Real:
    """Return the sum of the diagonal."""
    return m[0, 0] + m[1, 1] + m[2, 2]


def solve(m: Matrix, b: Vector) -> Vector:
    """Return the solution x of m x = b, by Cramer's rule (the written-out adjugate)."""
    r0, r1, r2 = cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])
    det = dot(m[0], r0)
    return jnp.stack([(r0[i] * b[0] + r1[i] * b[1] + r2[i] * b[2]) / det for i in range(3)])


def inverse(m: Matrix) -> Matrix:
    """Return the inverse of m."""
    rows = jnp.stack([cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])])
    return jnp.swapaxes(rows, 0, 1) / dot(m[0], rows[0])[None, None]


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
