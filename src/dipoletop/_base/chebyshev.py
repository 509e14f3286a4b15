"""Chebyshev collocation in integral form.

A function is represented by its values at n Chebyshev nodes. The polynomial of degree n − 1 through
these values is integrated exactly, so an equation y′ = f(y) becomes y = y₀ + A f(y) at the nodes.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .types import Real


class CollocationRule(NamedTuple):
    """The nodes, and two matrices that act on the values at them."""

    nodes: np.ndarray
    """The n nodes, from 0 to 1, shape (n,)."""
    integrals: np.ndarray
    """The matrix A from values to the integrals from 0 to each node, shape (n, n)."""
    coefficients: np.ndarray
    """The matrix from values to Chebyshev coefficients on [−1, 1], shape (n, n)."""


@functools.cache
def collocation_rule(n: int) -> CollocationRule:
    """Return the rule with n Chebyshev nodes of the second kind on [0, 1]."""
    x = -np.cos(np.pi * np.arange(n) / (n - 1))
    polynomial = np.polynomial.chebyshev
    coefficients = np.linalg.inv(polynomial.chebvander(x, n - 1))
    sums = [polynomial.chebval(x, polynomial.chebint(row, lbnd=-1)) for row in np.eye(n)]
    return CollocationRule((x + 1) / 2, np.stack(sums, axis=1) @ coefficients / 2, coefficients)


def chebyshev_sum(coefficients: Float[Array, "n"], t: Real) -> Real:
    """Return the sum of cᵢTᵢ(t), −1 ≤ t ≤ 1, by Clenshaw's recurrence."""

    def step(carry: tuple[Real, Real], coefficient: Real) -> tuple[tuple[Real, Real], None]:
        first, second = carry
        return (coefficient + 2 * t * first - second, first), None

    zero = jnp.zeros_like(t)
    (first, second), _ = jax.lax.scan(step, (zero, zero), coefficients[:0:-1])
    return coefficients[0] + t * first - second
