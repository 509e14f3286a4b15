"""Bisection with a fixed number of halvings, which can be traced and batched."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Bound = Float[Array, "*lanes"]


def bisect(
    passed: Callable[[Bound], Bool[Array, "*lanes"]], low: Bound, high: Bound, halvings: int
) -> tuple[Bound, Bound]:
    """Enclose the point at which `passed` turns from False to True, in a bracket halved n times.

    The result has no useful derivative: add a step of Newton's method to get one.

    Args:
        passed: whether x lies at or above that point; False where its values are NaN.
        low: a lower bound.
        high: an upper bound, of the same shape.
        halvings: the number n of halvings.

    Returns:
        The lower and the upper bound, (high − low)/2ⁿ apart.
    """

    def halve(_: Any, bracket: tuple[Bound, Bound]) -> tuple[Bound, Bound]:
        low, high = bracket
        middle = (low + high) / 2
        above = passed(middle)
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    return jax.lax.fori_loop(0, halvings, halve, (low, high))
