"""Zeros in brackets: by bisection, and by ITP, which needs fewer evaluations; both can be batched.

Source of ITP: I. F. D. Oliveira and R. H. C. Takahashi, "An enhancement of the bisection method
average performance preserving minmax optimality", ACM Trans. Math. Softw. 47, 5 (2020).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .guards import safe_divisor

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

    It lies in a bracket of width (high − low)/2ⁿ after n + 1 evaluations at most, and after some
    ten if the function is smooth. It is differentiated by the implicit function theorem.
    """

    def solve(function: Callable[[Bound], Bound], _: Bound) -> Bound:
        start, last = high - low, (high - low) / 2.0**halvings

        def is_wide(now: tuple[Array, ...]) -> Bool[Array, ""]:
            low, high, _, _, reach = now
            return jnp.any((high - low > smallest(low, high)) & (reach >= last))

        def smallest(low: Bound, high: Bound) -> Bound:
            ulps = 4 * float(jnp.finfo(low.dtype).eps) * jnp.maximum(jnp.abs(low), jnp.abs(high))
            return jnp.maximum(last, ulps)

        def narrow(now: tuple[Array, ...]) -> tuple[Array, ...]:
            low, high, under, over, reach = now
            width, middle = high - low, (low + high) / 2
            # Interpolation, in its distance from the middle.
            off = middle - (low - under * (width / safe_divisor(over - under)))
            # Truncation: nearer to the middle, so that the zero lies in the smaller part.
            nearer = jnp.maximum(width * (width / safe_divisor(5 * start)), smallest(low, high) / 2)
            off = jnp.sign(off) * jnp.maximum(jnp.abs(off) - nearer, 0.0)
            # Projection: no farther from it than the number of evaluations allows, and not outside.
            farthest = jnp.minimum(reach, width) - width / 2
            at = middle - jnp.clip(jnp.where(jnp.isfinite(off), off, 0.0), -farthest, farthest)
            value = function(at)
            above = value >= 0
            ends = jnp.where(above, low, at), jnp.where(above, at, high)
            return *ends, jnp.where(above, under, value), jnp.where(above, value, over), reach / 2

        first = low, high, function(low), function(high), start
        found = jax.lax.while_loop(is_wide, narrow, first)
        return (found[0] + found[1]) / 2

    def divide(slope_times: Callable[[Bound], Bound], value: Bound) -> Bound:
        slope = slope_times(jnp.ones_like(value))
        return value / jnp.where(slope == 0, 1.0, slope)

    return jax.lax.custom_root(function, low, solve, divide)
