"""A body and its angular velocity as seen from the dipole: axes, moments, symmetries.

The frame (n, a, b) has n along the dipole and a, b across it, so that a·Ib = 0. If n is a
principal axis, a and b are the two others, and the linear motion across n depends on the moments
J_a/J_d, J_b/J_d and on |d|²|w|/J_d only, with J_d = n·In and w = n·Ω.

Two symmetries change the fate of a state:

- J_a = J_b, the symmetry axis along the dipole: w is constant;
- J_d = J_a or J_d = J_b, the symmetry axis across the dipole: this is the transverse top, whose
  free precession vanishes on the residual line.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..._base.guards import rounding, safe_divisor, safe_sqrt
from ..._base.linalg import cross, dot, matvec, scale, trace
from ..._base.types import Flag, Real, Vector
from ...bodies import Body
from ..levels import Level

STILL = 8  # roundings of |Ω| or J up to which a component of Ω, or a moment's difference, is 0


class DipoleFrame(NamedTuple):
    """A body, and perhaps a state of it, seen from its dipole."""

    strength: Real
    """|d|²."""
    n: Vector
    """The direction of the dipole, d/|d|."""
    a: Vector
    b: Vector
    jd: Real
    """n·In."""
    ja: Real
    """a·Ia."""
    jb: Real
    """b·Ib."""
    jab: Real
    """a·Ib. It is 0, but has derivatives where J_a = J_b, since a and b are then arbitrary."""
    principal: Flag
    """Whether n is a principal axis, to rounding."""
    speed: Any = None
    """|Ω| of the state."""
    w: Any = None
    """n·Ω."""
    xa: Any = None
    """a·Ω."""
    xb: Any = None
    """b·Ω."""

    def of(self, omega: Vector) -> "DipoleFrame":
        """Return the frame with the state of an angular velocity."""
        w, xa, xb = dot(self.n, omega), dot(self.a, omega), dot(self.b, omega)
        return self._replace(speed=safe_sqrt(dot(omega, omega)), w=w, xa=xa, xb=xb)


def body_frame(body: Body) -> DipoleFrame:
    """Return the frame (n, a, b), right-handed, by one Jacobi rotation about n."""
    inertia, d = body.inertia, body.dipole
    strength = dot(d, d)
    n = scale(1 / jnp.sqrt(strength), d)
    # Start from the coordinate axis least along n: body axes across n then stay exact.
    least = jnp.argmin(jnp.abs(n), axis=0)
    e = jnp.stack([jnp.where(least == i, 1.0, 0.0) for i in range(3)])
    e = cross(n, e)
    e = scale(1 / jnp.sqrt(dot(e, e)), e)
    f = cross(n, e)
    ie, jf = matvec(inertia, e), matvec(inertia, f)
    half, mixed = (dot(e, ie) - dot(f, jf)) / 2, dot(e, jf)
    # Up to rounding any two directions across n are principal then.
    equal = jnp.abs(half) + jnp.abs(mixed) <= STILL * float(jnp.finfo(n.dtype).eps) * dot(e, ie)
    opposite = jnp.where(half < 0, -mixed, mixed)
    angle = jnp.arctan2(opposite, jnp.where(equal, 1.0, jnp.abs(half))) / 2
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    a = scale(cos, e) + scale(sin, f)
    b = scale(cos, f) - scale(sin, e)
    lever = matvec(inertia, n)
    jd, gain = dot(n, lever), mixed * jnp.tan(angle)
    off = lever - scale(jd, n)
    negligible = rounding(jd) * trace(inertia)
    return DipoleFrame(
        strength,
        n,
        a,
        b,
        jd,
        dot(e, ie) + gain,
        dot(f, jf) - gain,
        jnp.where(equal, mixed, 0.0),
        dot(off, off) <= negligible**2,
    )


def symmetry_axis(frame: DipoleFrame) -> tuple[Flag, Flag]:
    """Return whether the symmetry axis lies along the dipole, and else whether across it."""
    negligible = rounding(frame.w) * (frame.jd + frame.ja + frame.jb)
    along = jnp.abs(frame.ja - frame.jb) <= negligible
    equal_a = jnp.abs(frame.ja - frame.jd) <= negligible
    equal_b = jnp.abs(frame.jb - frame.jd) <= negligible
    return along, frame.principal & (equal_a | equal_b) & ~along


def spins_across(frame: DipoleFrame, axis_along: Flag) -> Flag:
    """Return whether Ω is 0 or along a principal axis across the dipole: a constant direction."""
    negligible = STILL * float(jnp.finfo(frame.w.dtype).eps) * frame.speed
    on_axis = axis_along | (jnp.abs(frame.xa) <= negligible) | (jnp.abs(frame.xb) <= negligible)
    return (jnp.abs(frame.w) <= negligible) & on_axis


def transverse_top(frame: DipoleFrame) -> tuple[Real, Real, Vector]:
    """Return δ, |d|²/J_d and Ω of a body with its symmetry axis across the dipole.

    Ω is in the axes of the transverse top, with axis 1 along the dipole and axis 3 along the
    symmetry axis. The dimensionless ω of the transverse top is |d|²Ω/J_d.
    """
    equal_a = jnp.abs(frame.ja - frame.jd) <= jnp.abs(frame.jb - frame.jd)
    j3 = jnp.where(equal_a, frame.jb, frame.ja)
    delta = jnp.maximum(1 - j3 / frame.jd, -1.0)
    across = jnp.where(equal_a, frame.xa, frame.xb), jnp.where(equal_a, frame.xb, -frame.xa)
    return delta, frame.strength / frame.jd, jnp.stack([frame.w, *across])


def stays_in_plane(delta: Real, omega: Vector, level: Level) -> Flag:
    """Return whether δ ≤ −1/2 and ω₁ is constant: in the plane ω₃ = 0 of order 1, (4.6)."""
    return (delta <= -0.5) & (omega[2] == 0) & (omega[0] != 0) & (level is Level.ORDER_1)


def constraints(body: Body, omega: Vector, level: Level) -> tuple[Vector, Vector]:
    """Return two vectors that vanish where the verdict on ω∞ holds; a variation must keep them 0.

    Both are dimensionless, in units of the body and of |Ω|. The first is d × Id: if it varies, the
    dipole leaves its principal axis, and there is no residual rotation. The second varies if the
    state leaves a set on which w is constant: w = 0 with J_a = J_b, or the plane of
    `stays_in_plane`.
    """
    frame = body_frame(body).of(omega)
    axis_along, axis_across = symmetry_axis(frame)
    no_spin = axis_along & frame.principal & spins_across(frame, axis_along)
    delta, _, top = transverse_top(frame)
    in_plane = axis_across & stays_in_plane(delta, top, level)
    speed, moments = safe_divisor(frame.speed), trace(body.inertia)
    d, unit, length = body.dipole, scale(1 / speed, omega), jnp.sqrt(frame.strength)
    lean = scale(1 / (frame.strength * moments), cross(d, matvec(body.inertia, d)))
    normal = jnp.where(no_spin, d, jnp.where(in_plane, cross(d, unit), 0.0))
    gyroscopic = cross(matvec(body.inertia, unit), unit)
    torque = dot(jax.lax.stop_gradient(normal), gyroscopic) / (length * moments)
    third = jnp.where(in_plane, top[2] / speed, 0.0)
    return lean, jnp.stack([torque, third, jnp.zeros_like(torque)])
