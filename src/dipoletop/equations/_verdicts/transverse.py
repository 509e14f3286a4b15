"""Regions of the transverse top from which the outcome is certain, and ω∞ inside them.

Each public function takes δ and ω and returns a `Verdict`. Exact invariant sets come first. Outside
them there are three kinds of region, in the notation

    u = ω₁² + ω₂²,   M = 1 + δ + δ²,   U = u + Mω₃²,   p = u/U,   q = 2|δω₃|/U,
    S = sgn(ω₃)·2ω₁ω₂/u,   T = ω₂/ω₁,   Z = ω₃/ω₁²,   v = ω₁²,   D = 1 − δ + 4v.

Residual. The line ω₂ = ω₃ = 0 attracts a neighbourhood, a cone at order 1 and an ellipse in (T, Z)
at the semi-reduced level. Order 1 is proven for every amplitude; semi-reduced, the ellipse is
proven by interval branch and bound for v ≤ 10 and δ in [−1, −0.01] or [0.02, 0.99], and tested on
grids elsewhere. At order 1 with δ > 0 almost every start is residual (`almost_every_start`), so
outside the cone the outcome is certain, too, but ω∞ has no series there.

Rotating stop, δ < 0. Precession is so fast that the angle φ = atan2(ω₂, ω₁) turns for ever: q > S,
and ln q + S/q, at the semi-reduced level with a correction, is above a bound. Proven at order 1,
tested at the semi-reduced level.

Wobbling stop, δ > δ_c2, at the consistent levels only: φ swings round π/2, inside the stable
manifold of the saddle of the small-amplitude limit (`dipoletop.planar`). Tested.

Orders 2–4 and the full equation agree with the semi-reduced level up to O(ω²), so its regions are
also used for them at small amplitude. Tested.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._base.guards import safe_divisor
from ..._base.linalg import components, dot
from ..._base.types import Flag, Outcome, Real, Stop, Vector, Verdict
from ..levels import Level
from . import residual_series
from .nonsmooth import piecewise_conserved
from .residual_line import linear_part
from .residual_series import Series, line_coordinates, quadratic_term

WOBBLING_FROM = 0.7532357993909
"""δ_c2, above which the consistent levels have a stable wobbling cycle at small amplitude."""
STEEP_FROM = 0.6031006366136
"""δ above which |ω∞| near axis 3 is a power below 2 of the distance from it.

By (4.16) C = v ξ^q with v = ω₃² and ξ = u/v, so |ω∞|² ~ C^{1/(2−q+p)}, q and p the exponents
there: the power of √u is q/(2 − q + p).
"""
NEAR_LINE = 1e-4
"""T² + Z² up to which motions of the full equation, and of orders 2–4, near the residual line
decay where it is stable."""
STRONGEST = 1.0
"""|ω₁| up to which that was tested at orders 2–4, whose terms grow up to ω⁹."""


def has_boundary(delta: Any, level: Level) -> Any:
    """Return whether a basin boundary exists at a shape δ, so that a run may end in either way.

    Elsewhere runs are residual, except for starts on an axis and on a surface (section 4.2), and
    only the region of residual rotation ever decides. From order 2 on runs may also diverge.
    """
    if level in (Level.ORDER_1, Level.SEMI):
        return has_boundary_at_rest(delta, level)
    return (delta < 0) | (delta >= 0)


def has_boundary_at_rest(delta: Any, level: Level) -> Any:
    """Return whether a basin boundary exists among arbitrarily slow motions.

    There all consistent levels have the same outcomes.
    """
    stops = delta < 0
    return stops | (delta > WOBBLING_FROM) if level.consistent else stops


def _log_below(q: Real) -> Real:
    """Return a lower bound of ln q within 1e-5, in single precision, which XLA:CPU vectorises."""
    return jnp.log(safe_divisor(q).astype("float32")).astype(q.dtype) - 5e-6


def _q_and_s(d: Real, w: Vector, u: Real) -> tuple[Real, Real]:
    """Return the pair q, S."""
    w1, w2, w3 = components(w)
    q = 2 * jnp.abs(d * w3) / safe_divisor(u + (1 + d + d**2) * w3**2)
    return q, jnp.sign(w3) * 2 * w1 * w2 / safe_divisor(u)


def _decided(residual: Flag, stop: Flag, kind: Array, certified: Flag, series: Series) -> Verdict:
    """Return the verdict on a state; where both flags are set, as on exact sets, the stop wins.

    All neighbours of a state that stops also stop, so that the derivatives of ω∞ are 0, except
    perhaps on an axis.
    """
    inside = stop & (kind != Stop.AXIS)
    outcome = jnp.where(residual, Outcome.RESIDUAL, Outcome.UNDECIDED)
    outcome = jnp.where(stop, Outcome.STOP, outcome)
    omega_inf, error, slope = (jnp.where(inside, 0.0, x) for x in series)
    omega_inf = jnp.where(stop | residual, omega_inf, jnp.nan)
    kind = jnp.where(stop, kind, Stop.NONE)
    return Verdict(outcome.astype(int), omega_inf, certified, kind.astype(int), error, slope)


def _where_constant(exact: Flag, w1: Real, series: Series) -> Series:
    """Return the series with the value ω₁ where ω₁ is constant, and with its own derivatives.

    Far from the line the series is useless and may overflow: there ω₁ replaces all of it.
    """
    omega_inf, error, slope = series
    far = exact & ~(slope < 1)
    replaced = jnp.where(far, w1, omega_inf), jnp.where(exact, 0.0, error)
    return *replaced, jnp.where(far, jnp.inf, slope)


def _on_axis(axis: Flag, d: Real, w: Vector, series: Series, plane: Flag | bool = False) -> Series:
    """Set ω∞ = 0 on an axis of decaying spin, although its neighbours may keep rotating.

    Its derivatives are the derivatives of ω₁ where ω₁ is constant, at δ = 0 and in an invariant
    `plane` ω₃ = 0, and 0 on axis 3. On other axes there are none.
    """
    w1, w2, w3 = components(w)
    constant = (d == 0) | plane
    off = jnp.where(plane, w3, jnp.where(d > STEEP_FROM, w1**2 + w1 * w2 + w2**2, 0.0))
    zero = w1 - jax.lax.stop_gradient(w1)  # not −0
    value = piecewise_conserved(jnp.where(constant, zero, 0.0), jnp.where(d == 0, d * w2 * w3, off))
    omega_inf, error, slope = series
    return (
        jnp.where(axis, value, omega_inf),
        jnp.where(axis, 0.0, error),
        jnp.where(axis, jnp.where(constant | (w2 == 0) & (w3 != 0), 0.0, jnp.inf), slope),
    )


def almost_every_start(delta: Real, w: Vector) -> Flag:
    """Return which starts at order 1, 0 < δ < 1, are residual except for a set of measure 0.

    With A = ω² + δ(1+δ)ω₃² and B = (ω² + δ(2ω₁² − ω₂²))/(1−δ), which are positive,

        u′ = −2A sin²φ u,   ω₃′ = −Bω₃,   φ′ = −δω₃ − ½A sin 2φ.

    Both u and |ω₃| fall. If u has a limit above 0, then ω₃ → 0 and ω₂ → 0: the start is residual.
    Let now u → 0, off the invariant axes. Then ω₃ → 0, too, as ω₃′ ≤ −ω₃³/(1−δ) for ω₃ > 0.

    1. z = |ω₃|/u stays bounded. Where z is large, φ turns fast, and ln z, except for the small term
       −A sin 2φ/(2δω₃) and another one, falls like −∫A dτ times a positive number: averaged over φ
       (ln z)′ is −(1−δ)⁻¹(3δu/2 + δ³ω₃²), and ∫A dτ diverges.
    2. So ω₃²/u ≤ z²u → 0, and with dσ = u dτ the motion obeys, up to O(u), `planar` at order 1,
       F = (φ_σ, z_σ). Near (φ, z) = (π/2, 0) both eigenvalues are 1, so it leaves that
       neighbourhood for ever; where z is small elsewhere, it would enter the cone. So z stays
       above a positive number.
    3. There z⁻² has a finite integral, and it increases along the planar motion:
       div(z⁻²F) = 3δ cos²φ z⁻²/(1−δ). The measure u^(κ−1)·exp(κχ)·z⁻² du dφ dz, κ > 0 small and
       χ(φ, z) smooth with F·∇χ > 2 around φ = π/2, increases at a positive rate for small u. A set
       of finite measure that is mapped into itself cannot grow: its measure is 0.
    """
    w1, w2, w3 = components(w)
    return (delta > 0) & ((w1 != 0) | ((w2 != 0) & (w3 != 0)))


def first_order(delta: Real, w: Vector) -> Verdict:
    """Return the verdict of order 1, (4.2)–(4.4): every region is proven, for any amplitude."""
    d = delta
    w1, w2, w3 = components(w)
    u = w1**2 + w2**2
    finite = jnp.isfinite(u + jnp.abs(w3) + d)
    # Exact: ω₃ = 0 and δ = 0 keep ω₁; ω⊥ = 0 and ω₁ = ω₃ = 0 are axes of decaying spin.
    constant = (w3 == 0) | (d == 0)
    axis = (w1 == 0) & ((w2 == 0) | constant)

    # ω₂² ≤ κu and |δω₃| ≤ λu, κ = λ = ½ or, for δ < 0, (1+2δ)/(2+δ) and √(κ(1−δ)/(2+δ)).
    below = jnp.where(d >= 0, 2.0, 2 + d)
    above = jnp.where(d >= 0, 1.0, 1 + 2 * d)  # κ = above/below
    height = jnp.sqrt(jnp.where(d >= 0, 1.0, jnp.maximum(above, 0.0) * (1 - d)))  # λ = height/below
    # Compared unsquared, and not where squares underflow: 0 ≤ 0 would certify anything.
    flat = (below * jnp.abs(d * w3) <= u * height) & (u >= jnp.finfo(u.dtype).tiny)
    cone = (d > -0.5) & (w1 != 0) & (below * w2**2 <= above * u) & flat

    fast = (1 + d + d**2) * w3**2
    q, s = _q_and_s(d, w, u)
    measure = _log_below(q) + s / safe_divisor(q)
    precesses = (q > s) & (q > 0) & (measure > jnp.where(fast <= 0.8 * u, 1.0, 1.1))
    rotating = (d < 0) & ~constant & (precesses | (d <= -0.5))

    beyond = almost_every_start(d, w) & ~cone & ~constant
    pairs = zip(residual_series.first_order(d, w), (jnp.nan, jnp.inf, jnp.inf), strict=True)
    value, error, slope = (jnp.where(beyond, unknown, known) for known, unknown in pairs)
    omega_inf, error, slope = _where_constant(constant, w1, (value, error, slope))
    off = jnp.where((d <= -0.5) & (w3 == 0), w3, 0.0)  # all neighbours with ω₃ ≠ 0 stop
    omega_inf = piecewise_conserved(omega_inf, off)
    series = _on_axis(axis, d, w, (omega_inf, error, slope), w3 == 0)
    residual = cone | beyond | constant
    stop, residual = (axis | rotating) & finite, residual & finite
    kind = jnp.where(axis, Stop.AXIS, Stop.ROTATING)
    return _decided(residual, stop, kind, stop | residual, series)


class ShapeNumbers(NamedTuple):
    """The numbers in semi-reduced verdicts that depend on δ only."""

    quadratic: Real
    """δ/(2+δ), the factor of Q₂."""
    bound: Real
    """c(δ) of the region of residual rotation."""
    lag: Real
    """−3δ/(2(1−δ)), of the correction of the region of rotating stops."""
    edge: tuple[Real, Real, Real, Real]
    """c₀ … c₃ of the region of wobbling stops."""
    margin: Real
    """10/(1−δ), the margin of c₀ per u."""


def shape_numbers(d: Real) -> ShapeNumbers:
    """Return the numbers that depend on δ only."""
    size = jnp.abs(safe_divisor(d))
    bound = jnp.where(d < 0, jnp.minimum(1.75 / size**2, 17 / size), 3.3 / size)
    delta = jnp.where(d > WOBBLING_FROM, d, 0.9)  # any value at which the series is regular
    y = 1 - delta
    c0 = (0.725869 + y * (-0.512807147 + y * (-0.243160085 - 0.135716127 * y))) / y
    c0 = c0 * (1 - 3e-6)
    c2 = -(1 + delta) / (2 * delta**2 * y * c0)
    c3 = (4 * c2 + (2 + delta) / y * c0) / (3 * delta * c0)
    lag = -3 * d / (2 * (1 - d))
    return ShapeNumbers(d / (2 + d), bound, lag, (c0, -1 / delta, c2, c3), 10 / y)


def semi_reduced(delta: Real, w: Vector, numbers: ShapeNumbers | None = None) -> Verdict:
    """Return the semi-reduced verdict: residual (proven for most δ), or stop (tested).

    `numbers` are the `shape_numbers` of δ, or None.
    """
    d = delta
    numbers = shape_numbers(d) if numbers is None else numbers
    w1, w2, w3 = components(w)
    u = w1**2 + w2**2
    finite = jnp.isfinite(u + jnp.abs(w3) + d)
    # Exact: ω⊥ = 0 and ω₁ = ω₃ = 0 are axes of decaying spin; δ = 0 keeps ω₁.
    constant = d == 0
    axis = (w1 == 0) & ((w2 == 0) | (w3 == 0) | constant)
    line = (w2 == 0) & (w3 == 0) & (w1 != 0)

    residual = _residual_region(d, w, numbers.bound) & (w1**2 >= jnp.finfo(u.dtype).tiny)
    proven = (w1**2 <= 10) & (((d >= -1) & (d <= -0.01)) | ((d >= 0.02) & (d <= 0.99)))

    q, s = _q_and_s(d, w, u)
    p = u / safe_divisor(u + (1 + d + d**2) * w3**2)
    a = numbers.lag
    measure = _log_below(q) + p * (1 + a - 2 * a * p) * s / safe_divisor(q)
    precesses = (q > s) & (q > 0) & (measure >= jnp.maximum(0.88, 1.15 - jnp.abs(d)))
    rotating = (d < 0) & (u > 0) & precesses

    stop = (axis | rotating | _wobbling_region(d, w, numbers)) & finite
    residual = (residual | constant | line) & finite
    kind = jnp.where(axis, Stop.AXIS, jnp.where(d < 0, Stop.ROTATING, Stop.WOBBLING))
    certified = (stop & axis) | (residual & ~stop & (proven | constant | line))
    series = residual_series.semi_reduced(d, w, numbers.quadratic)
    series = _on_axis(axis, d, w, _where_constant(constant | line, w1, series))
    return _decided(residual, stop, kind, certified, series)._replace(size=jnp.abs(w1))


def _residual_region(d: Real, w: Vector, bound: Real) -> Flag:
    """Return whether D(T²+Z²) + [(1+2δ)T + (2v−δ(1−δ))Z]² + [(1−δ)Z − 2T]² ≤ c(δ)."""
    t, z, v = line_coordinates(w)
    first = (1 + 2 * d) * t + (2 * v - d * (1 - d)) * z
    second = (1 - d) * z - 2 * t
    return (1 - d + 4 * v) * (t**2 + z**2) + first**2 + second**2 <= bound


def _wobbling_region(d: Real, w: Vector, numbers: ShapeNumbers) -> Flag:
    """Return whether ω is inside the stable manifold of the saddle, near the section ω₁ = 0.

    The manifold crosses the section at z = ω₃/u = z_W(δ). Its Taylor series in the angle ε from
    there is c₀ + c₁ε + c₂ε² + c₃ε³ with c₀ = z_W and c₁ = −1/δ. A margin below it allows for the
    rest of the series and for the finite amplitude. z_W is a fit from below, within 6e-6 for
    δ ≤ 0.999.
    """
    w1, w2, w3 = components(w)
    u = w1**2 + w2**2
    c0, c1, c2, c3 = numbers.edge
    z = w3 / safe_divisor(u)
    # The angle from the section, by the series of arcsin; by symmetry its sign is relative to z's.
    sine = -w1 * jnp.sign(w2) * jnp.where(z < 0, -1.0, 1.0) / jnp.sqrt(safe_divisor(u))
    s2 = sine**2
    e = sine * (1 + s2 * (1 / 6 + s2 * (3 / 40 + s2 * (5 / 112 + s2 * 35 / 1152))))
    edge = c0 * (1 - 0.005 - numbers.margin * u - 0.3 * e**4) + e * (c1 + e * (c2 + e * c3))
    small = u <= 10 * (1 - d) * (d - WOBBLING_FROM)
    return (d > WOBBLING_FROM) & (u > 0) & small & (w1**2 <= 0.31 * u) & (jnp.abs(z) <= edge)


def full(delta: Real, w: Vector) -> Verdict:
    """Return the verdict on the physical branch, near the residual line at any amplitude.

    The line is stable at every ω₁ ≠ 0 and δ: the constant term of its characteristic polynomial,
    ω₁⁴, is positive. Tested only.
    """
    return _near_line(delta, w, Level.FULL, delta < 1)


def _near_line(d: Real, w: Vector, level: Level, decays: Flag) -> Verdict:
    """Return the verdict of `_at_small_amplitude`, or residual rotation next to a stable line.

    There T = ω₂/ω₁ and Z = ω₃/(ω₁ min(|ω₁|, 1)) decay if the line `decays`. Tested only.
    """
    q2 = quadratic_term(d, w, level)
    small = _at_small_amplitude(d, w, q2)
    w1, w2, w3 = components(w)
    divisor = safe_divisor(w1)
    distance = (w2 / divisor) ** 2 + (w3 / (divisor * jnp.minimum(jnp.abs(divisor), 1.0))) ** 2
    near = (small.outcome == Outcome.UNDECIDED) & (w1 != 0) & decays & (distance <= NEAR_LINE)
    outcome = jnp.where(near, Outcome.RESIDUAL, small.outcome)
    otherwise = small.omega_inf, small.error, small.slope
    pairs = zip(residual_series.full(w, q2), otherwise, strict=True)
    omega_inf, error, slope = (jnp.where(near, *pair) for pair in pairs)
    return Verdict(outcome, omega_inf, small.certified, small.stop, error, slope)


def _at_small_amplitude(d: Real, w: Vector, q2: Real) -> Verdict:
    """Return the semi-reduced regions at small amplitude, for a level whose Q₂ is `q2`.

    The levels agree there up to O(ω²), which the error of ω∞ includes.
    """
    square = dot(w, w)
    small = square <= 0.1 * jnp.where(d <= 0.3, 1.0, jnp.minimum(1.0, (1 - d) ** 2))
    semi = semi_reduced(d, w)
    series = residual_series.higher_order(d, w, q2)
    value, error, slope = _where_constant(jnp.asarray(semi.error == 0), components(w)[0], series)
    residual = small & (semi.outcome == Outcome.RESIDUAL)
    omega_inf = jnp.where(residual, value, jnp.where(small, semi.omega_inf, jnp.nan))
    return Verdict(
        jnp.where(small, semi.outcome, Outcome.UNDECIDED),
        omega_inf,
        jnp.zeros_like(small),
        jnp.where(small, semi.stop, Stop.NONE),
        jnp.where(residual, error, semi.error),
        jnp.where(residual, slope, semi.slope),
    )


def of_level(delta: Real, w: Vector, level: Level) -> Verdict:
    """Return the verdict of a reduced or semi-reduced level, or of the full one if ω is small."""
    if level is Level.SEMI:
        return semi_reduced(delta, w)
    if level is Level.ORDER_1:
        return first_order(delta, w)
    size = jnp.abs(components(w)[0])
    m11, m12, m21, m22 = linear_part(1 + 0 * delta, 1 - delta, size, level)
    stable = (m11 + m22 < 0) & (m11 * m22 > m12 * m21)
    return _near_line(delta, w, level, stable & (size <= STRONGEST))
