"""Derivatives of what is an invariant of some motions, but not of those beside them."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..._base.types import Real

HUGE = 1e-6  # the part of the largest number that stands for infinity: 0 times it is 0


def infinity(dtype: Any) -> float:
    """In place of infinity: 1e302, or the like."""
    return HUGE * float(jnp.finfo(dtype).max)


def infinite(derivative: Array) -> Bool[Array, "..."]:
    """Whether a derivative is that, times some change: no other is so large."""
    return jnp.abs(derivative) > infinity(derivative.dtype) ** 0.5


@jax.custom_jvp
def invariant(value: Real, off: Real) -> Real:
    """A value that holds where `off` is 0, with a jump or a kink there.

    Derivatives are infinite along changes that move `off`, second ones if either change does, or
    both together; else they are those of the value.
    """
    return value


@invariant.defjvp
def _(primals: Any, tangents: Any) -> tuple[Real, Real]:
    (value, off), (change, moved) = primals, tangents
    # Here off = 0; but differentiated again it is not.
    return value, change + infinity(value.dtype) * (moved + off)
