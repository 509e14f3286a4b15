"""Rounding, and arguments of divisions and square roots without an infinite value or derivative.

`jnp.where(x > 0, f(x), 0.0)` has a NaN derivative where f or f′ is infinite, although that branch
is not selected: the chain rule multiplies f′ = ∞ by 0. The argument must be replaced before f is
evaluated, see https://docs.jax.dev/en/latest/faq.html#gradients-contain-nan-where-using-where.
"""

import jax.numpy as jnp

from .types import Real

ULPS = 4096  # roundings up to which moments or directions count as equal


def rounding(like: Real) -> float:
    """Return the relative difference up to which numbers of this floating-point type are equal."""
    return ULPS * float(jnp.finfo(like.dtype).eps)


def beside(t: Real, side: int) -> Real:
    """Return the time t less (side −1) or plus (side 1) little more than its rounding."""
    limits = jnp.finfo(t.dtype)
    apart = jnp.maximum(4 * float(limits.eps) * jnp.abs(t), float(limits.tiny))
    return jnp.where(jnp.isfinite(t), t + side * apart, t)


def safe_divisor(x: Real) -> Real:
    """Return the divisor x, or 1 where x = 0: the caller selects another branch there."""
    return jnp.where(x == 0, 1.0, x)


def safe_sqrt(x: Real, otherwise: Real | float = 0.0) -> Real:
    """Return √x where x > 0, else `otherwise`, with the derivatives of the selected branch."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), otherwise)
