"""Verdicts on a general body: any inertia tensor, any dipole, every level.

In the frame (n, a, b) of the dipole (`dipole_frame`), with moments in units of J_d, times in 1/|w|
and y = (x_a, ±x_b)/|w|, the motion across the residual line Ω = w n is (`residual_line`)

    y′ = ℓ(μ) y + odd terms from the third power on,   w′/w = g y_a y_b exactly,   μ = |d|²|w|/J_d.

A Lyapunov function shows residual rotation. Let P solve ℓᵀP + Pℓ = −1 at the present w, V = yᵀPy,
and V₀ its present value. Suppose that V ≤ V₀, and that w has changed by no more than a fraction η.
If −(ℓᵀP + Pℓ) ≥ ¾ in that range of w (checked at its ends), and the odd terms are at most a third
of that, then V′ ≤ −½|y|², hence ∫|y|² ≤ 2V₀, and the change of ln |w| is at most
½|g| ∫|y|² ≤ |g| V₀ = η. So each of the two bounds follows from the other, and both hold for all
later times: y → 0, and w tends to a limit within η of its present value.

The balance of energy shows a stop. d/dt(E − d₁·d₂) = −|d₂|², d₁ and d₂ the derivatives of d in
space, is exact for the full equation. At small amplitude it also holds for the reduced levels, up
to smaller terms. So a motion ends where d₂ = 0 for ever: at rest or, if n is a principal axis, on
the line. A
dipole off its principal axes always leads to a stop; on one, there is a stop if no stable part of
the line can be reached, because E is too small or because the slow flow has a barrier
(`slow_flow`). `SMALL` limits the amplitude up to which balance is used. The amplitude itself
decides nothing, however small it is, and what no test decides stays undecided. All this is tested,
not proven, so it is never certified.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._base.guards import safe_divisor, safe_sqrt
from ..._base.linalg import dot, inverse, scale
from ..._base.types import Flag, Outcome, Real, Stop, Vector, Verdict
from ...bodies import Body
from ..levels import Level
from . import residual_line as line
from . import transverse
from .dipole_frame import (
    DipoleFrame,
    body_frame,
    spins_across,
    stays_in_plane,
    symmetry_axis,
    transverse_top,
)
from .slow_flow import behind_barrier, ends_on_axis, flow_at_nodes

SMALL = 0.2  # |d|²|Ω|/J up to which the reduced levels keep the balance law well enough

WITHOUT_RUNAWAYS = (Level.ORDER_1, Level.SEMI)
"""Levels whose motions do not run away at any amplitude.

Motions of orders 2–4 run away at large amplitude. The full equation is treated like these: every
motion off its physical branch runs away, and beyond `SMALL` it is not known whether the branch
continues, nor has the bound of the odd terms been tested.
"""

ODD_TERMS = 3.0
"""The bound C of the odd terms of x′, at most C |d|²|x|³/min(J_a, J_b).

At order 1 those of x′_i are at most C |d|²|x|²|x_i|/J_i, because J_a ≤ J_b + J_d and so on. In
samples the former C is at most 1.0 at order 1 and 2.1 at the other levels, for orders 2–4 up to
`SMALL`.
"""
ODD_GROWTH = 6  # beyond `SMALL` C grows with this power of |Ω|: at order 4 the terms reach |Ω|⁹

DRIFT = 0.1  # largest η
DECAY = 0.75  # least eigenvalue of −(ℓᵀP + Pℓ) while w drifts
ODD_SHARE = 8.0  # 2|yᵀP·odd| ≤ ¼|y|² if this times |P|·(odd terms)/|y| is at most 1


class Attraction(NamedTuple):
    """Whether the residual line attracts a state, and to which point."""

    shown: Flag
    """Whether the Lyapunov function shows the attraction."""
    omega_inf: Real
    """The limit of w."""
    error: Real
    """Estimated error of `omega_inf`, relative."""
    slope: Real
    """Estimated error of its derivatives, relative."""


class SeenBody(NamedTuple):
    """All that a verdict needs of a body, the same for all its states."""

    frame: DipoleFrame
    weakness: Real
    """|d|²√tr(I⁻²); times |Ω| an amplitude not below |d|²|Ω|/J for any moment J."""
    flow: Array
    """The slow flow of h at some nodes."""


def seen(body: Body) -> SeenBody:
    """Return the numbers of a body that the verdicts on its states need."""
    rows = inverse(body.inertia)
    frame = body_frame(body)
    weakness = frame.strength * jnp.sqrt(sum(dot(rows[i], rows[i]) for i in range(3)))
    return SeenBody(frame, weakness, flow_at_nodes(frame))


def verdict(body: SeenBody, y: Vector, level: Level) -> Verdict:
    """Return the verdict on a state of the equation of any body.

    Args:
        body: the body, `seen` once for all states.
        y: Ω, shape (3,) or (3, B).
        level: the level of the equation; a state of the full one must be on the physical branch.

    Returns:
        RESIDUAL where a Lyapunov function shows that the residual line attracts y; STOP where no
        part of the line can attract y, or the slow flow has a barrier before it.
    """
    frame = body.frame.of(y)
    excess = body.weakness * frame.speed / SMALL
    axis_along, axis_across = symmetry_axis(frame)
    attraction = _attraction(frame, level, excess)
    trapped = behind_barrier(frame, body.flow)
    general = _of_general_body(frame, level, excess, (axis_along, trapped), attraction)
    top = _of_transverse_top(frame, level, attraction)
    return jax.tree.map(lambda a, b: jnp.where(axis_across, a, b), top, general)


def _of_general_body(
    frame: DipoleFrame, level: Level, excess: Real, flags: tuple[Flag, Flag], attraction: Attraction
) -> Verdict:
    """Return the verdict except for an axisymmetric body with its dipole across the axis.

    The flags: whether the symmetry axis lies along the dipole, and whether h is `behind_barrier`.
    """
    axis_along, behind = flags
    small = excess <= 1
    across = spins_across(frame, axis_along)
    w_constant = axis_along
    if level not in WITHOUT_RUNAWAYS:
        w_constant = w_constant & small
    settles = w_constant & (frame.w != 0)
    out_of_reach = small & _line_out_of_reach(frame, level)
    trapped = small & behind
    no_residual = across | (~settles & (out_of_reach | trapped))
    stop = jnp.where(frame.principal, no_residual, small)
    residual = frame.principal & ~stop & (settles | attraction.shown)
    on_axis = frame.principal & (across | (out_of_reach & ends_on_axis(frame)))
    zero = jnp.where(w_constant & across, frame.w - jax.lax.stop_gradient(frame.w), 0.0)  # not −0
    finite = jnp.isfinite(frame.speed + frame.jd + frame.ja + frame.jb + frame.strength)
    stop, residual = stop & finite, residual & finite
    outcome = jnp.where(residual, Outcome.RESIDUAL, Outcome.UNDECIDED)
    outcome = jnp.where(stop, Outcome.STOP, outcome)
    omega_inf = jnp.where(attraction.shown, attraction.omega_inf, frame.w)
    omega_inf = jnp.where(stop, zero, jnp.where(residual, omega_inf, jnp.nan))
    return Verdict(
        outcome,
        omega_inf,
        jnp.zeros_like(stop),
        jnp.where(stop, jnp.where(on_axis, Stop.AXIS, Stop.TUMBLING), Stop.NONE),
        jnp.where(stop | settles, 0.0, attraction.error),
        jnp.where(
            stop,
            jnp.where(across & ~w_constant, jnp.inf, 0.0),
            jnp.where(attraction.shown, attraction.slope, jnp.inf),
        ),
    )


def _of_transverse_top(frame: DipoleFrame, level: Level, attraction: Attraction) -> Verdict:
    """Return the verdict on an axisymmetric body with its dipole across the axis, by its regions.

    Their ω∞ is more accurate than in `attraction`, but is a function of δ only: the derivatives
    with respect to J_a and J_b are taken from `attraction`, where the line attracts.
    """
    delta, unit, omega = transverse_top(frame)
    top = transverse.of_level(delta, scale(unit, omega), level)
    in_plane = stays_in_plane(delta, omega, level)  # where the line attracts no state
    residual = top.outcome == Outcome.RESIDUAL
    differentiable = residual & (attraction.shown | in_plane)
    value = jnp.where(in_plane, frame.w, attraction.omega_inf)
    slope = jnp.where(in_plane, 0.0, attraction.slope)
    constant = jax.lax.stop_gradient
    with_derivatives = constant(top.omega_inf / unit) + (value - constant(value))
    return Verdict(
        top.outcome,
        jnp.where(differentiable, with_derivatives, top.omega_inf / unit),
        jnp.zeros_like(top.certified),
        jnp.broadcast_to(top.stop, top.outcome.shape),
        jnp.broadcast_to(top.error, top.outcome.shape),
        jnp.where(residual, jnp.where(differentiable, slope, jnp.inf), top.slope),
    )


def _attraction(frame: DipoleFrame, level: Level, excess: Real) -> Attraction:
    """Return whether a Lyapunov function shows that the line attracts the state (module docstring).

    The unit of y_b is s = `balancing_scale`, so that η = |g| s V₀.
    """
    w = safe_divisor(jnp.abs(frame.w))
    a, b, mu = frame.ja / frame.jd, frame.jb / frame.jd, frame.strength / frame.jd * w
    matrix = line.linear_part(a, b, mu, level)
    s = line.balancing_scale(matrix)
    y = frame.xa / w, jnp.sign(frame.w) * frame.xb / (w * s)
    linear = line.rescaled(matrix, s)
    stable = (linear[0] + linear[3] < 0) & (linear[0] * linear[3] > linear[1] * linear[2])
    unit, zero = jnp.ones_like(s), jnp.zeros_like(s)
    p = line.solve_lyapunov(linear, (unit, zero, unit))
    least, most = line.extreme_eigenvalues(p)
    v0 = line.quadratic_form(p, y)
    g = a - b
    eta = jnp.abs(g) * s * v0
    square = jnp.maximum(1.0, s**2) * v0 / jnp.where(least > 0, least, 1.0)  # bounds |x|²/w²
    growth = 1.0 if level in WITHOUT_RUNAWAYS else jnp.maximum(excess, 1.0) ** ODD_GROWTH
    odd = ODD_TERMS * growth * mu / jnp.minimum(a, b) * square
    shown = stable & (least > 0) & (eta <= DRIFT) & (ODD_SHARE * most * odd <= 1)
    for part in (1 - eta, 1 + eta):
        drifted = line.rescaled(line.linear_part(a, b, mu * part, level), s)
        shown = shown & (line.least_decay(drifted, p) * part >= DECAY)
    form = line.solve_lyapunov(linear, (zero, s / 2, zero))  # gS
    size = jnp.maximum(*map(jnp.abs, line.extreme_eigenvalues(form)))
    # The terms of fourth power in y that ω∞ = w(1 + yᵀSy) neglects, and their derivatives with
    # respect to y and to g.
    quartic = v0 * (eta * s / 2 + size * odd)
    slope = (4 * jnp.abs(g) / jnp.sqrt(safe_divisor(square)) + 1) * quartic
    # With J_ab ≠ 0, w′/w = g y_a y_b − (y_a² − y_b²) J_ab/J_d, where J_ab is taken times sgn w.
    tilt = jnp.sign(frame.w) * frame.jab / frame.jd
    tilted = line.solve_lyapunov(linear, (-tilt, zero, tilt * s**2))
    omega_inf = frame.w * (1 + g * line.quadratic_form(form, y) + line.quadratic_form(tilted, y))
    return Attraction(shown & (frame.w != 0), omega_inf, jnp.abs(g) * quartic, slope)


def _line_out_of_reach(frame: DipoleFrame, level: Level) -> Flag:
    """Return whether E is too small for a stable part of the line, for a dipole on the middle axis.

    The line is unstable while μ² + (1 − a)(1 − b) < 0, by the characteristic polynomial of the full
    equation; at the reduced levels it differs by a factor near 1 + μ. Energy bounds w by
    J_d w² ≤ 2E, except for the energy of the near field. Twice the μ allows for both.
    """
    a, b = frame.ja / frame.jd, frame.jb / frame.jd
    energy = frame.w**2 + a * frame.xa**2 + b * frame.xb**2
    mu = frame.strength * safe_sqrt(energy) / frame.jd
    m11, m12, m21, m22 = line.linear_part(a, b, mu, level)
    return (4 * mu**2 <= (a - 1) * (1 - b)) & (m11 * m22 < m12 * m21)
