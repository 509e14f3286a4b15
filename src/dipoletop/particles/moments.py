"""Moments of inertia for units and braking times."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import concrete, finite, on_host, or_nan, where_valid
from .._base.linalg import dot, length, matvec, trace
from .._base.refusals import refuse


def middle(inertia: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Return the middle one of the principal moments."""
    # A power of two brings I near 1 and changes no digit.
    _, exponent = jnp.frexp(trace(inertia))
    unit = jax.lax.stop_gradient(jnp.ldexp(1.0, exponent))
    return unit * jnp.linalg.eigvalsh(inertia / unit)[1]


def about(axis: Any, inertia: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Return n·In, with n the direction of `axis`."""
    axis = finite("axis", axis, (3,), batch=False)
    axis = where_valid("axis", axis, (on_host(axis) != 0).any(), "not be zero")
    n = axis / length(axis)
    return dot(n, matvec(inertia, n))


def across(dipole: Float[Array, "3"], inertia: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Return the moment about the axes across the dipole, if it is the same about all of them."""
    n = dipole / length(dipole)
    along = dot(n, matvec(inertia, n))
    moment = (trace(inertia) - along) / 2
    projector = n[:, None] * n[None, :]
    rest = inertia - along * projector - moment * (jnp.eye(3) - projector)
    valid = jnp.max(jnp.abs(rest)) <= 1e-12 * trace(inertia)
    if concrete(valid) and not valid:
        refuse("axis", "be given where moments about axes across the dipole differ", "is None")
    return or_nan(moment, valid)


def stable_axis(dipole: Float[Array, "3"], inertia: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Return the unit vector across the dipole about which the moment is largest."""
    n = dipole / length(dipole)
    project = jnp.eye(3) - n[:, None] * n[None]
    _, axes = jnp.linalg.eigh(project @ (inertia / trace(inertia)) @ project)
    return axes[:, 2]
