"""Cylindrical variables (ω⊥, ω₃, φ) of an angular velocity, and back."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import finite, not_negative
from .._base.compiling import compiled_soon
from .._base.linalg import components
from .._base.refusals import refuse
from .._base.types import Real, Vector


def cylindrical(w_perp: Any, w3: Any, phi: Any) -> Float[Array, "*batch 3"]:
    """Compute the angular velocity ω = (ω⊥ cos φ, ω⊥ sin φ, ω₃) in body axes.

    Args:
        w_perp: ω⊥ ≥ 0 across the symmetry axis, dimensionless.
        w3: ω₃ along the symmetry axis, dimensionless.
        phi: φ from the dipole, radians.

    Returns:
        Shape (3,), or (B, 3) for arguments of shape (B,).

    Raises:
        ValueError: ω⊥ < 0, or a value that is not finite. A traced one gives NaN.

    Example:
        >>> import dipoletop as dt
        >>> dt.cylindrical(w_perp=0.2, w3=0.1, phi=0.0)
        Array([0.2, 0. , 0.1], dtype=float64)
    """
    given = not_negative("w_perp", w_perp), finite("w3", w3), finite("phi", phi, unit="rad")
    if len({x.shape for x in given} - {()}) > 1:
        shapes = ", ".join(str(x.shape) for x in given)
        refuse("w_perp", "have, with `w3` and `phi`, one batch size", f"they have shapes {shapes}")
    return _by_start(*given)


@compiled_soon
def _by_start(w_perp: Real, w3: Real, phi: Real) -> Float[Array, "*batch 3"]:
    return jnp.moveaxis(from_cylindrical(w_perp, w3, phi), 0, -1)


def from_cylindrical(w_perp: Real, w3: Real, phi: Real) -> Vector:
    """Compute ω of cylindrical variables of equal shapes.

    At multiples of π/2 one component is exactly 0, because those planes decide outcomes.
    """
    w_perp, w3, phi = jnp.broadcast_arrays(w_perp, w3, phi)
    quarter = jnp.round(phi / (jnp.pi / 2))
    turned = quarter * (jnp.pi / 2)
    # A compiler may fuse product and difference, so that a rounding error would be left over. At a
    # multiple the rest is 0, but its derivative by φ is 1.
    zero = phi - jax.lax.stop_gradient(phi)
    rest = jnp.where(phi == turned, zero, phi - turned)
    cos, sin = jnp.cos(rest), jnp.sin(rest)
    quadrant = jnp.mod(quarter, 4)
    w1 = jnp.select([quadrant == 0, quadrant == 1, quadrant == 2], [cos, -sin, -cos], sin)
    w2 = jnp.select([quadrant == 0, quadrant == 1, quadrant == 2], [sin, cos, -sin], -cos)
    return jnp.stack([w_perp * w1, w_perp * w2, w3])


def to_cylindrical(omega: Vector) -> Vector:
    """Compute (ω⊥, ω₃, φ) of a Cartesian ω."""
    w1, w2, w3 = components(omega)
    return jnp.stack([jnp.hypot(w1, w2), w3, jnp.arctan2(w2, w1)])
