"""When the outcome of a general body is certain: any inertia tensor, any dipole, every level.

Written in the frame (n, a, b): n along the dipole, a and b the principal directions across it if
n is a principal axis. Moments are measured in J_d = n·In and times in 1/|w|, w = n·Ω, so that
a = J_a/J_d, b = J_b/J_d, μ = |d|²|w|/J_d and y = (x_a, ±x_b)/|w| with the sign of w (a reflection
of the body that keeps the dipole). At every level

    y′ = ℓ(μ) y + odd terms from the third power on,      w′/w = g y_a y_b exactly,   g = a − b.

The balance law d/dt(E − d₁·d₂) = −|d₂|² is exact for the full equation and holds for the reduced
levels up to terms smaller by |d|²|Ω|/J. Where these are small a motion ends where d₂ = 0 for ever:
at rest or, if n is a principal axis, on the line Ω ∥ n. `REACH` bounds |d|²|Ω|/J where that is
used: it limits the level, and does not decide by slowness. What no test decides stays undecided.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._base.linalg import cross, dot, inverse, matvec, scale, trace
from ..._base.types import Outcome, Real, Stop, Vector, Verdict
from ...bodies import Body
from ..levels import Level
from . import transverse as _regions
from .residual_line import (
    Form,
    Two,
    balancing,
    extremes,
    guarded,
    line,
    lyapunov,
    quadratic,
    root,
    scaled,
)

Flag = Bool[Array, "*#lanes"]
Nodes = Float[Array, "#nodes *#lanes"]
Found = tuple[Flag, Real, Real, Real]
"""Whether the line attracts a state; ω∞, its relative error, and that of its derivatives."""

REACH = 0.2  # |d|²|Ω|/J below which the reduced levels keep the balance law well enough
# |odd terms of x′_i| ≤ 3 |d|²|x|²|x_i|/J_i at order 1, because J_a ≤ J_b + J_d and so on; sampled,
# the largest is 1.0 at order 1 and 2.1 at the others (orders from 2 on: within REACH; beyond it
# times a power of the excess, as high as that of |Ω| at order 4 over the cube).
ODD, GROWTH = 3.0, 6
TAME = (Level.ORDER_1, Level.SEMI)  # of which no motion runs away at large amplitude
DRIFT = 0.1  # largest relative change of w that a residual region may allow
NODES = 16  # on which the slow flow is searched for a barrier
WAVER = 4.0  # the slow flow is exact up to this times |d|²|Ω|/J, measured in x and in f
SAME = 4096  # moments or directions that differ by so many roundings are the same


class Frame(NamedTuple):
    """A state seen from the dipole."""

    strength: Real
    """|d|²."""
    size: Real
    """|Ω|."""
    w: Real
    """n·Ω."""
    xa: Real
    """a·Ω."""
    xb: Real
    """b·Ω."""
    jd: Real
    """n·In."""
    ja: Real
    """a·Ia."""
    jb: Real
    """b·Ib."""
    jab: Real
    """a·Ib, which is 0; but where J_a = J_b, and no directions a and b are special, it may vary."""
    principal: Flag
    """Whether n is a principal axis, to rounding."""


def verdict(body: Body, y: Vector, level: Level) -> Verdict:
    """What an equation of any body says of the state y.

    Args:
        body: the body.
        y: Ω, shape (3,) or (3, B).
        level: that of the equation; the full one is on its physical branch.

    Returns:
        RESIDUAL where a Lyapunov function of the line shows that it attracts y; STOP where no
        line is left that could attract y, or the slow flow has a barrier before it.
    """
    frame = seen_from_dipole(body, y)
    reach = _reach(body, frame) / REACH
    round_about_n, round_across = _symmetry(frame)
    found = _residual(frame, level, reach)
    general = _general(frame, level, reach, round_about_n, found)
    return jax.tree.map(
        lambda one, two: jnp.where(round_across, one, two),
        _transverse(frame, level, found),
        general,
    )


def constraints(body: Body, omega: Vector, level: Level) -> tuple[Vector, Vector]:
    """What is 0, and has to stay so where the residual rotation depends on it.

    In units of the body and of |Ω|. First d × Id: with the dipole off its principal axis there is
    no residual rotation. Then what takes a state away from where alone w is constant, from w = 0
    with J_a = J_b, and from the plane of `_stays_in_plane`.
    """
    frame = seen_from_dipole(body, omega)
    round_about_n, round_across = _symmetry(frame)
    spin = round_about_n & frame.principal & _on_other_axis(frame, round_about_n)
    delta, _, top = _top(frame)
    plane = round_across & _stays_in_plane(delta, top, level)
    size, moments = guarded(frame.size), trace(body.inertia)
    d, unit, length = body.dipole, scale(1 / size, omega), jnp.sqrt(frame.strength)
    lean = scale(1 / (frame.strength * moments), cross(d, matvec(body.inertia, d)))
    axis = jnp.where(spin, d, jnp.where(plane, cross(d, unit), 0.0))  # n, or normal to the plane
    gyroscopic = cross(matvec(body.inertia, unit), unit)
    torque = dot(jax.lax.stop_gradient(axis), gyroscopic) / (length * moments)
    third = jnp.where(plane, top[2] / size, 0.0)
    return lean, jnp.stack([torque, third, jnp.zeros_like(torque)])


def _general(frame: Frame, level: Level, reach: Real, round_about_n: Flag, found: Found) -> Verdict:
    """The verdict but for an axisymmetric body with its dipole across the axis."""
    near = reach <= 1
    caught, value, error, slope = found
    spin = _on_other_axis(frame, round_about_n)
    steady = round_about_n  # then w is constant
    if level not in TAME:  # at large amplitude the others run away
        steady = steady & near
    keeps = steady & (frame.w != 0)
    middle = near & _no_stable_line(frame, level)
    held = near & _behind_barrier(frame)
    stop = jnp.where(frame.principal, spin | (~keeps & (middle | held)), near)
    residual = frame.principal & ~stop & (keeps | caught)
    axis = frame.principal & (spin | (middle & _ends_on_axis(frame)))
    zero = jnp.where(steady & spin, frame.w - jax.lax.stop_gradient(frame.w), 0.0)  # not −0
    sound = jnp.isfinite(frame.size + frame.jd + frame.ja + frame.jb + frame.strength)
    stop, residual = stop & sound, residual & sound
    return Verdict(
        jnp.where(stop, Outcome.STOP, jnp.where(residual, Outcome.RESIDUAL, Outcome.UNDECIDED)),
        jnp.where(stop, zero, jnp.where(residual, jnp.where(caught, value, frame.w), jnp.nan)),
        jnp.zeros_like(stop),
        jnp.where(stop, jnp.where(axis, Stop.AXIS, Stop.TUMBLING), Stop.NONE),
        jnp.where(stop | keeps, 0.0, error),
        jnp.where(stop, jnp.where(spin & ~steady, jnp.inf, 0.0), jnp.where(caught, slope, jnp.inf)),
    )


def seen_from_dipole(body: Body, omega: Vector) -> Frame:
    """The frame (n, a, b), right-handed, by one Jacobi rotation about n."""
    inertia, d = body.inertia, body.dipole
    strength = dot(d, d)
    n = scale(1 / jnp.sqrt(strength), d)
    # the coordinate axis least along n, so that an axis of the body stays one exactly
    least = jnp.argmin(jnp.abs(n), axis=0)
    e = jnp.stack([jnp.where(least == i, 1.0, 0.0) for i in range(3)])
    e = cross(n, e)
    e = scale(1 / jnp.sqrt(dot(e, e)), e)
    f = cross(n, e)
    ie, jf = matvec(inertia, e), matvec(inertia, f)
    half, mixed = (dot(e, ie) - dot(f, jf)) / 2, dot(e, jf)
    done = (half == 0) & (mixed == 0)
    turn = jnp.arctan2(jnp.where(half < 0, -mixed, mixed), jnp.where(done, 1.0, jnp.abs(half))) / 2
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    first = scale(cos, e) + scale(sin, f)
    second = scale(cos, f) - scale(sin, e)
    lever = matvec(inertia, n)
    jd, gain = dot(n, lever), mixed * jnp.tan(turn)
    off = lever - scale(jd, n)
    same = rounding(jd) * trace(inertia)
    return Frame(
        strength,
        root(dot(omega, omega)),
        dot(n, omega),
        dot(first, omega),
        dot(second, omega),
        jd,
        dot(e, ie) + gain,
        dot(f, jf) - gain,
        jnp.where(done, mixed, 0.0),
        dot(off, off) <= same**2,
    )


def _symmetry(frame: Frame) -> tuple[Flag, Flag]:
    """Whether J_a = J_b, and else whether the body is a top whose dipole lies across its axis."""
    same = rounding(frame.w) * (frame.jd + frame.ja + frame.jb)
    round_about_n = jnp.abs(frame.ja - frame.jb) <= same
    touches = (jnp.abs(frame.ja - frame.jd) <= same) | (jnp.abs(frame.jb - frame.jd) <= same)
    return round_about_n, frame.principal & touches & ~round_about_n


def rounding(like: Real) -> float:
    """The relative size of what counts as rounding of numbers like these."""
    return SAME * float(jnp.finfo(like.dtype).eps)


def _reach(body: Body, frame: Frame) -> Real:
    """|d|²|Ω|/J with 1/J = √tr(I⁻²), at least one over the smallest moment."""
    back = inverse(body.inertia)
    return frame.strength * frame.size * jnp.sqrt(sum(dot(back[i], back[i]) for i in range(3)))


def _residual(frame: Frame, level: Level, reach: Real) -> Found:
    """Whether a Lyapunov function shows that the line attracts the state.

    With V = yᵀPy, ℓᵀP + Pℓ = −1 at the present w, let V₀ be its present value. As long as
    V ≤ V₀ and w has changed by no more than a part η: V′ ≤ −½|y|². Then ∫|y|² ≤ 2V₀, which
    keeps the change of w below η = |g| s V₀: the two conditions hold each other up for ever.
    """
    one = guarded(jnp.abs(frame.w))
    a, b, mu = frame.ja / frame.jd, frame.jb / frame.jd, frame.strength * one / frame.jd
    matrix = line(a, b, mu, level)
    s = balancing(matrix)
    y = frame.xa / one, jnp.sign(frame.w) * frame.xb / (one * s)
    now = scaled(matrix, s)
    stable = (now[0] + now[3] < 0) & (now[0] * now[3] > now[1] * now[2])
    unit, none = jnp.ones_like(s), jnp.zeros_like(s)
    p = lyapunov(now, (unit, none, unit))
    low, high = extremes(p)
    v = quadratic(p, y)
    g = a - b
    eta = jnp.abs(g) * s * v
    square = jnp.maximum(1.0, s**2) * v / jnp.where(low > 0, low, 1.0)  # bounds |y|²
    largest = ODD if level in TAME else ODD * jnp.maximum(reach, 1.0) ** GROWTH
    odd = largest * mu / jnp.minimum(a, b) * square
    held = stable & (low > 0) & (eta <= DRIFT) & (8 * high * odd <= 1)
    for part in (1 - eta, 1 + eta):
        held = held & (_decay(scaled(line(a, b, mu * part, level), s), p) * part >= 0.75)
    form = lyapunov(now, (none, s / 2, none))  # gS
    size = jnp.maximum(*map(jnp.abs, extremes(form)))
    # What the fourth power of y adds, and its derivatives with respect to y and to g.
    quartic = v * (eta * s / 2 + size * odd)
    slope = (4 * jnp.abs(g) / jnp.sqrt(guarded(square)) + 1) * quartic
    # With J_ab ≠ 0, w′/w = g y_a y_b − (y_a² − y_b²) J_ab/J_d, but for the sign of w.
    tilt = jnp.sign(frame.w) * frame.jab / frame.jd
    tilted = lyapunov(now, (-tilt, none, tilt * s**2))
    value = frame.w * (1 + g * quadratic(form, y) + quadratic(tilted, y))
    return held & (frame.w != 0), value, jnp.abs(g) * quartic, slope


def _decay(m: Two, p: Form) -> Real:
    """Smallest eigenvalue of −(MᵀP + PM)."""
    m11, m12, m21, m22 = m
    return extremes(
        (
            -2 * (p[0] * m11 + p[1] * m21),
            -(p[0] * m12 + p[1] * (m11 + m22) + p[2] * m21),
            -2 * (p[1] * m12 + p[2] * m22),
        )
    )[0]


# --- stops ----------------------------------------------------------------------------------


def _on_other_axis(frame: Frame, round_about_n: Flag) -> Flag:
    """Spin about a principal axis across the dipole, or rest: the motion stays there."""
    none = 8 * float(jnp.finfo(frame.w.dtype).eps) * frame.size
    other = round_about_n | (jnp.abs(frame.xa) <= none) | (jnp.abs(frame.xb) <= none)
    return (jnp.abs(frame.w) <= none) & other


def _no_stable_line(frame: Frame, level: Level) -> Flag:
    """Dipole on the middle axis, and energy too small to reach a stable part of the line.

    The line is unstable while μ² + (1 − a)(1 − b) < 0 (physics of the full equation), which the
    reduced levels change by a factor near 1 + μ. Energy bounds w: J_d w² ≤ 2E, but for what the
    near field lends.
    """
    a, b = frame.ja / frame.jd, frame.jb / frame.jd
    energy = frame.w**2 + a * frame.xa**2 + b * frame.xb**2
    mu = frame.strength * root(energy) / frame.jd
    m11, m12, m21, m22 = line(a, b, mu, level)
    return (4 * mu**2 <= (a - 1) * (1 - b)) & (m11 * m22 < m12 * m21)


def _ends_on_axis(frame: Frame) -> Flag:
    """Dipole on the middle axis J₂: the stop is a spin about J₃ iff J₂J₁² < (J₃−J₂)(J₃−J₁)²."""
    low, high = jnp.minimum(frame.ja, frame.jb), jnp.maximum(frame.ja, frame.jb)
    return frame.jd * low**2 < (high - frame.jd) * (high - low) ** 2


def _behind_barrier(frame: Frame) -> Flag:
    """Dipole on the smallest moment, h = 2E/L² below a repeller of the slow flow.

    Averaged over free rotation dh/ds = f(h). Where f < 0 at some node between the state and the
    separatrix, h cannot rise; the distance in x and the depth of f leave room for what the
    average leaves out, which is of the order of |d|²|Ω|/J and falls with |Ω|.
    """
    a, b = frame.ja / frame.jd, frame.jb / frame.jd
    p2, p3 = 1 / jnp.minimum(a, b), 1 / jnp.maximum(a, b)
    momentum = frame.w**2 + (a * frame.xa) ** 2 + (b * frame.xb) ** 2
    h = (frame.w**2 + a * frame.xa**2 + b * frame.xb**2) / guarded(momentum)
    fine = float(jnp.finfo(h.dtype).eps) ** 0.5
    usable = (1 - p2 > fine) & (p2 - p3 > fine)
    p2, p3 = jnp.where(usable, p2, 0.8), jnp.where(usable, p3, 0.6)
    nodes = (jnp.arange(1, NODES + 1) / (NODES + 1)).astype(h.dtype)
    nodes = jnp.broadcast_to(nodes.reshape((NODES,) + (1,) * h.ndim), (NODES, *h.shape))
    waver = WAVER * frame.strength * frame.size / frame.jd
    barrier = _slow_flow(p2[None], p3[None], nodes) < -waver[None] / WAVER
    behind = nodes >= ((h - p3) / (p2 - p3) + waver)[None]
    return usable & jnp.any(barrier & behind, axis=0)


def _slow_flow(p2: Nodes, p3: Nodes, x: Nodes) -> Nodes:
    """The rate f = dh/ds, dipole on J₁, h = p₃ + (p₂ − p₃)x below the separatrix; p₁ = 1."""
    h = p3 + (p2 - p3) * x
    w = _ratio_e_k((1 - p2) * x / (1 - h))
    y1 = (
        h**2 * (p2 + p3 - 2 * p2 * p3)
        + h * (-2 * p2**2 + p2 * p3 - 2 * p3**2 + 2 * p2**2 * p3 + 2 * p2 * p3**2)
        + (p2 - p3) ** 2
        - (p2 * p3) ** 2
    )
    first = (p2 - h) * ((p2 - p3) ** 2 - p2 * p3**2 - h * p2 * (p2 - p3))
    return (1 - h) / (1 - p2) * (first - w * (p2 - p3) * y1 / (1 - p3))


def _ratio_e_k(m: Nodes) -> Nodes:
    """E(m)/K(m) = 1 − Σ 2ⁿ⁻¹cₙ² by the arithmetic-geometric mean, 0 ≤ m ≤ 0.99."""
    one, other, total, weight = jnp.ones_like(m), jnp.sqrt(1 - m), m / 2, 1.0
    for _ in range(6):
        half = (one - other) / 2
        one, other = (one + other) / 2, jnp.sqrt(one * other)
        total = total + weight * half**2
        weight = 2 * weight
    return 1 - total


# --- axisymmetric body, dipole across the axis ------------------------------------------------


def _transverse(frame: Frame, level: Level, found: Found) -> Verdict:
    """The regions of the transverse top, in its units: ω = |d|²Ω/J_d, δ = 1 − J₃/J_d.

    Its ω∞ is more exact than that of `found` but knows of no J_a ≠ J_d: the derivatives are
    those of `found`, where that is at hand.
    """
    delta, unit, omega = _top(frame)
    top = _regions.of_level(delta, scale(unit, omega), level)
    caught, value, _, slope = found
    plane = _stays_in_plane(delta, omega, level)  # there no state is caught
    residual = top.outcome == Outcome.RESIDUAL
    known = residual & (caught | plane)
    value, slope = jnp.where(plane, frame.w, value), jnp.where(plane, 0.0, slope)
    still = jax.lax.stop_gradient
    varied = still(top.omega_inf / unit) + (value - still(value))
    return Verdict(
        top.outcome,
        jnp.where(known, varied, top.omega_inf / unit),
        jnp.zeros_like(top.certified),
        jnp.broadcast_to(top.stop, top.outcome.shape),
        jnp.broadcast_to(top.error, top.outcome.shape),
        jnp.where(residual, jnp.where(known, slope, jnp.inf), top.slope),
    )


def _top(frame: Frame) -> tuple[Real, Real, Vector]:
    """δ, the unit of ω over that of Ω, and Ω about the dipole, across, and about the axis."""
    first = jnp.abs(frame.ja - frame.jd) <= jnp.abs(frame.jb - frame.jd)
    third = jnp.where(first, frame.jb, frame.ja)
    delta = jnp.maximum(1 - third / frame.jd, -1.0)
    across = jnp.where(first, frame.xa, frame.xb), jnp.where(first, frame.xb, -frame.xa)
    return delta, frame.strength / frame.jd, jnp.stack([frame.w, *across])


def _stays_in_plane(delta: Real, omega: Vector, level: Level) -> Flag:
    """At order 1 and δ ≤ −1/2 only what is in the plane ω₃ = 0 keeps rotating: ω₁ is constant."""
    return (delta <= -0.5) & (omega[2] == 0) & (omega[0] != 0) & (level is Level.ORDER_1)
