"""Attitudes of a body: unit quaternions, and how they follow from an angular velocity.

Quaternions have their scalar part first and their components on axis 0. q takes vectors from body
axes to the laboratory: v_lab = q∘v∘q*. So dq/dτ = ½ q∘(0, ω), with ω in body axes.

The integrated variable is a turn (p, θ), five numbers, with a fixed unit vector n of the body:

    q = q₀ ∘ p ∘ (cos ½θ, n sin ½θ),    dθ/dτ = n·ω,    dp/dτ = ½ p∘(0, R(ω − (n·ω)n)),

with R the rotation by θ about n. If ω lies along n, as at the end of a residual rotation about the
dipole, p is constant and θ is a plain integral, so the steps can be as long as for ω alone. The
equation for p is linear, so an error of |p| never changes the rotation; p is divided by |p| when an
attitude is read.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import finite, where_valid
from .linalg import components, cross, dot, scale
from .types import Vector

Quaternion = Float[Array, "4 *#lanes"]
"""(cos ½θ, n sin ½θ) for a rotation by θ about the unit vector n; lanes (if any) behind."""
Turn = Float[Array, "5 *#lanes"]
"""(p, θ)."""

NORM_TOLERANCE = 1e-6  # of the norm of a given attitude, which is then normalised


def unit_quaternion(name: str, value: Any) -> Float[Array, "4"]:
    """Return a given attitude, normalised; refuse one that is not a unit quaternion."""
    q = finite(name, value, (4,), batch=False)
    norm = jnp.sqrt(jnp.sum(q**2))
    must = f"be a unit quaternion, of norm 1 within {NORM_TOLERANCE:g}"
    q = where_valid(name, q, jnp.abs(norm - 1) <= NORM_TOLERANCE, must)
    return normalised(q)


def normalised(q: Quaternion) -> Quaternion:
    """Return q/|q|."""
    parts = components(q)
    norm = jnp.sqrt(sum(part**2 for part in parts))
    return jnp.stack([part / norm for part in parts])


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p∘q: the rotation q, then p."""
    u, v = p[1:], q[1:]
    scalar = p[0] * q[0] - dot(u, v)
    return jnp.concatenate([scalar[None], scale(p[0], v) + scale(q[0], u) + cross(u, v)])


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return q∘v∘q* for a unit quaternion q."""
    u = q[1:]
    twice = 2 * cross(u, v)
    return v + scale(q[0], twice) + cross(u, twice)


def quaternion_rate(q: Quaternion, omega: Vector) -> Quaternion:
    """Return ½ q∘(0, ω)."""
    return product(q, jnp.concatenate([jnp.zeros_like(omega[:1]), omega / 2]))


def no_turn(like: Array) -> Float[Array, "5"]:
    """Return the turn at the start of a motion, p = 1 and θ = 0."""
    return jnp.zeros(5, like.dtype).at[0].set(1.0)


def turned_across(axis: Vector, theta: Array, omega: Vector) -> tuple[Array, Vector]:
    """Return n·ω, and R(ω − (n·ω)n): the parts of ω that drive θ and p."""
    along = dot(axis, omega)
    across = omega - scale(along, axis)
    return along, scale(jnp.cos(theta), across) + scale(jnp.sin(theta), cross(axis, across))


def turn_rate(turn: Turn, axis: Vector, omega: Vector) -> Turn:
    """Return the rate of (p, θ)."""
    along, across = turned_across(axis, turn[4], omega)
    return jnp.concatenate([quaternion_rate(turn[:4], across), along[None]])


def attitude_after(turn: Turn, axis: Vector) -> Quaternion:
    """Return the unit quaternion of a turn."""
    half = turn[4] / 2
    twist = jnp.concatenate([jnp.cos(half)[None], scale(jnp.sin(half), axis)])
    return normalised(product(turn[:4], twist))
