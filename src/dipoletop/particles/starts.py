"""Starts: the angular velocity of a body that rotates with a given frequency."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.batches import over_batch
from .._base.checks import concrete, finite, instance, on_host, positive, where_valid
from .._base.compiling import compiled_soon
from .._base.linalg import dot, length, matvec, scale, solve, trace
from .._base.refusals import refuse
from ..bodies import Body
from .particle import Particle
from .units import LIGHT, speed_in_rad

FASTEST_RIM = 0.1
"""The largest speed of a point of a particle over the speed of light."""


def start(
    body: Any, spin: Any, *, momentum: Any = None, axis: Any = None
) -> Float[Array, "*batch 3"]:
    """Compute Ω with rotation frequency L·Ω/L = `spin`, along a direction of L or of Ω.

    For a direction l of L = IΩ it is Ω = s I⁻¹l/(l·I⁻¹l), for a direction n of Ω it is
    Ω = s n |In|/(n·In), with s the spin. About a principal axis s = |Ω|.

    Args:
        body: a particle, or a dimensionless body. `jax.vmap` makes a batch of either.
        spin: for a particle in rad/s, or a text such as "1 GHz" (`angular_speed`); for a body
            dimensionless; positive, shape () or (B,).
        momentum: direction of L in body axes, shape (3,) or (B, 3), of any length except 0; or else
        axis: direction of Ω, of the same form.

    Returns:
        For a particle Ω in rad/s, for a body the dimensionless ω₀; in body axes, shape (3,) or
        (B, 3). `Particle.omega` converts the former to a dimensionless start.

    Raises:
        ValueError: a `spin` that is not positive, or a text for a dimensionless body; a direction
            of zero; neither or both directions given; batches of different sizes.

    Example:
        >>> import dipoletop as dt
        >>> body = dt.box(12.0, [1, 2, 3], dipole=[1, 0, 0])  # diag(13, 10, 5)
        >>> start(body, 0.1, axis=[0, 0, 2]).tolist()
        [0.0, 0.0, 0.1]
        >>> omega0 = start(body, 0.1, momentum=[13, 10, 0])  # then Ω is along (1, 1, 0)
        >>> print(omega0 / omega0[0])
        [1. 1. 0.]
    """
    instance("body", body, Body | Particle, "be a Body or a Particle")
    if (momentum is None) == (axis is None):
        was = "neither is" if momentum is None else "both are"
        refuse("momentum", "be given or else `axis`", was)
    name = "axis" if momentum is None else "momentum"
    direction = finite(name, axis if momentum is None else momentum, (3,))
    nonzero = (on_host(direction) != 0).any(axis=-1)
    direction = where_valid(name, direction, nonzero, "not be zero")
    speed = _spin(body, spin)
    if speed.ndim == 1 and direction.ndim == 2 and speed.shape != direction.shape[:1]:
        must = f"have the batch size {speed.size} of `spin`"
        refuse(name, must, f"has {len(direction)}")
    batch = jnp.broadcast_shapes(speed.shape, direction.shape[:-1])
    speed, direction = jnp.broadcast_to(speed, batch), jnp.broadcast_to(direction, (*batch, 3))
    return _start(body, speed, direction, name == "momentum")


def _spin(body: Body | Particle, spin: Any) -> Float[Array, "*batch"]:
    """Return a positive spin, in the units of the body."""
    if isinstance(body, Body):
        if isinstance(spin, str):
            refuse("spin", "be a number, since a Body has no unit of time", f"is {spin!r}")
        return positive("spin", spin)
    speed = speed_in_rad("spin", spin)
    return where_valid("spin", speed, on_host(speed) > 0, "be positive")


@over_batch(lambda body: body.dipole.ndim - 1)
@compiled_soon
def _start(
    body: Body | Particle,
    spin: Float[Array, "*batch"],
    direction: Float[Array, "*batch 3"],
    of_momentum: bool,
) -> Float[Array, "*all 3"]:
    """Return `start` of one body."""
    # In SI units the determinant would be near 1e-120, so I is divided by its trace.
    inertia = body.inertia / trace(body.inertia)

    def along(s: Float[Array, ""], vector: Float[Array, "3"]) -> Float[Array, "3"]:
        n = vector / length(vector)
        if of_momentum:
            omega = solve(inertia, n)
            return scale(s / dot(n, omega), omega)
        momentum = matvec(inertia, n)
        return scale(s * length(momentum) / dot(n, momentum), n)

    return jnp.vectorize(along, signature="(),(n)->(n)")(spin, direction)


def refuse_relativistic(name: str, body: Any, omega: Float[Array, "*batch 3"]) -> None:
    """Refuse a known rotation of a particle of known radius whose rim is relativistic."""
    if not isinstance(body, Particle) or body.radius is None or not concrete(body, omega):
        return
    speed = np.max(np.linalg.norm(np.asarray(omega), axis=-1))
    rim = float(speed * body.radius / LIGHT)
    if rim > FASTEST_RIM:
        must = f"have a rim slower than {FASTEST_RIM} c, since the theory is not relativistic"
        refuse(name, must, f"makes it {rim:.2g} c")
