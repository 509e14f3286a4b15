"""When the outcome of a general body is certain: any inertia tensor, any dipole, every level.

Written in the frame (n, a, b): n along the dipole, a and b the principal directions across it
if n is a principal axis. Lengths of time and inertia are J_d = n·In and 1/|w|, w = n·Ω, so that
a = J_a/J_d, b = J_b/J_d, μ = |d|²|w|/J_d, and y = (x_a, ±x_b)/|w| with the sign of w (a reflection
of the body that keeps the dipole). At every level

    ẏ = ℓ(μ) y + (cubic and higher, odd in y),      ẇ/w = g y_a y_b exactly,   g = a − b.

Why these tests are sound, and where: the balance law d/dt(E − d₁·d₂) = −|d₂|² is exact for the
full equation, and holds for the reduced levels up to terms smaller by |d|²|Ω|/J. There a motion
ends where d₂ = 0 for ever: at rest, or, if n is a principal axis, on the line Ω ∥ n. `REACH`
bounds |d|²|Ω|/J where that is used; it limits the level, and says nothing of how fast a top
has to be. What no test decides stays undecided.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._linalg import Vec, cross, dot, inverse, matvec, scale
from .._types import Outcome, Real, Stop, Vector, Verdict
from ..bodies import Body
from . import _regions

Flag = Bool[Array, "*lanes"]
Two = tuple[Real, Real, Real, Real]
"""A 2×2 matrix by rows."""
Form = tuple[Real, Real, Real]
"""A symmetric 2×2 matrix: 11, 12, 22."""

REACH = 0.2  # |d|²|Ω| tr(I⁻¹) up to which the balance law holds well enough at the reduced levels
CUBIC = 3.0  # |cubic terms of ẋ_i| ≤ 3 |d|²|x|²|x_i|/J_i at order 1, by J_a ≤ J_b + J_d and so on
HIGHER = 2.0  # what the other levels add to that, as a factor, for |d|²|Ω|/J within REACH
GRID = 16  # nodes on which the slow flow is searched for a barrier
SAME = 4096  # two moments, or two directions, are equal if they differ by so many roundings


class Frame(NamedTuple):
    """A state seen from the dipole."""

    strength: Real
    """|d|²."""
    size: Real
    """|Ω|."""
    w: Real
    """n·Ω."""
    x: tuple[Real, Real]
    """Components of Ω along a and b."""
    moments: tuple[Real, Real, Real]
    """J_d, J_a, J_b."""
    principal: Flag
    """Whether n is a principal axis, to rounding."""


def verdict(equation: Any, y: Vector) -> Verdict:
    """What `Reduced` or `SemiReduced` of any body say of the state y.

    Args:
        equation: has a `body` and, if it is a reduced equation, an `order`.
        y: Ω, shape (3,) or (3, B).

    Returns:
        RESIDUAL where a Lyapunov function of the line shows that it attracts y; STOP where no
        line can attract y, or where the slow flow has a barrier before it; never certified.
    """
    body, order = equation.body, getattr(equation, "order", None)
    frame = seen_from_dipole(body, y)
    jd, ja, jb = frame.moments
    same = _rounding(y) * (jd + ja + jb)
    across = (jnp.abs(ja - jd) <= same) | (jnp.abs(jb - jd) <= same)
    round_ = jnp.abs(ja - jb) <= same  # the dipole lies on a symmetry axis

    near = _reach(body, frame) <= REACH
    caught, value, error = _residual(frame, order)
    keeps = round_ & (frame.w != 0) & (near if order is not None and order > 1 else True)
    spin = _axis_spin(frame)
    middle = _unstable_line(frame, order) & near
    walled = _behind_barrier(frame) & near
    stop = ~frame.principal & near | frame.principal & (spin | ~round_ & (middle | walled))
    residual = frame.principal & ~stop & (keeps | caught)
    kind = jnp.where(frame.principal & (spin | middle & _ends_on_axis(frame)), Stop.AXIS, Stop.TUMBLING)

    outcome = jnp.where(stop, Outcome.STOP, jnp.where(residual, Outcome.RESIDUAL, 0))
    general = Verdict(
        outcome,
        jnp.where(stop, 0.0, jnp.where(residual, jnp.where(keeps, frame.w, value), jnp.nan)),
        jnp.zeros_like(stop),
        jnp.where(stop, kind, Stop.NONE),
        jnp.where(stop | keeps, 0.0, error),
    )
    degenerate = frame.principal & across & ~round_
    return _select(degenerate, _transverse(frame, order), general)
