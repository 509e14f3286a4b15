"""Derivatives of a value that is conserved only on a lower-dimensional set.

On the set ω₃ = 0 of order 1, for example, ω∞ = ω₁; next to it ω∞ is another function, which may
jump at the set or have a kink there. So ω∞ has derivatives along the set, but none across it. With
a function F that is 0 on the set and changes across it, the change of ω∞ is taken to be

    dω∞ = d(value) + H dF,   H = 10⁻⁶ of the largest number, in place of infinity.

The directional derivative is then d(value) if dF = 0, and of the size of H otherwise
(`infinite`). H stands for infinity, since ∞·0 would be NaN along the set.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..._base.types import Real

LARGE = 1e-6  # H over the largest number: sums of such derivatives do not overflow


def infinity(dtype: Any) -> float:
    """Return the number H that stands for infinity: 1e302, or 1e32 in single precision."""
    return LARGE * float(jnp.finfo(dtype).max)


def infinite(derivative: Array) -> Bool[Array, "..."]:
    """Return whether a derivative is H times some change: no other derivative is above √H."""
    return jnp.abs(derivative) > infinity(derivative.dtype) ** 0.5


@jax.custom_jvp
def piecewise_conserved(value: Real, off: Real) -> Real:
    """Return `value`, for `off` = 0, with a derivative H along changes of `off`.

    A second derivative is infinite if either change moves `off`, or both together do.
    """
    return value


@piecewise_conserved.defjvp
def _(primals: Any, tangents: Any) -> tuple[Real, Real]:
    (value, off), (change, moved) = primals, tangents
    # `off` is 0 here, but differentiated again it is not.
    return value, change + infinity(value.dtype) * (moved + off)
