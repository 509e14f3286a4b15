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
    """Return a bracket, halved n times, of the point where `passed` turns from False to True.

    The result has no useful derivative: add a step of Newton's method to get one.

    Args:
        passed: function of x: whether x lies at or above that point; False for NaN.
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


def root(
    function: Callable[[Bound], Bound], low: Bound, high: Bound, halvings: int
) -> Float[Array, "*lanes"]:
    """Return the zero in each lane of a function, negative at `low` and positive at `high`.

    It is found by bisection, and differentiated by the implicit function theorem.
    """

    def solve(function: Callable[[Bound], Bound], _: Bound) -> Bound:
        below, above = bisect(lambda x: function(x) >= 0, low, high, halvings)
        return (below + above) / 2

    def divide(slope_times: Callable[[Bound], Bound], value: Bound) -> Bound:
        slope = slope_times(jnp.ones_like(value))
        return value / jnp.where(slope == 0, 1.0, slope)

    return jax.lax.custom_root(function, low, solve, divide)
