"""Regions of the transverse top from which the outcome is certain, and ω∞ inside them.

Each public function takes δ and ω and returns a `Verdict`. Exact invariant sets come first.
Shorthand of the regions: u = ω₁² + ω₂², M = 1 + δ + δ², U = u + Mω₃², q = 2|δω₃|/U and
S = sgn(ω₃)·2ω₁ω₂/u. On the residual side T = ω₂/ω₁, Z = ω₃/ω₁² and v = ω₁².
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._base.guards import safe_divisor
from ..._base.types import Flag, Outcome, Real, Stop, Vector, Verdict
from ..levels import Level
from .nonsmooth import piecewise_conserved
from .residual_series import (
    Series,
    residual_first_order,
    residual_full,
    residual_higher_order,
    residual_semi_reduced,
    second_power,
)

WOBBLING_FROM = 0.7532357993909
"""δ above which the consistent levels have a stable wobbling cycle in the small-amplitude limit."""
STEEP_FROM = 0.6031006366136
"""δ above which |ω∞| beside axis 3 is a power below 2 of the distance from it.

By (4.16) C = v ξ^q with ξ = u/v, so |ω∞|² ~ C^{1/(2−q+p)}: the power of √u is q/(2 − q + p).
"""
BESIDE = 1e-4
"""T² + Z² up to which motions of the full equation beside the residual line decay."""


def _log(q: Real) -> Real:
    """A lower bound of ln q within 1e-5, in single precision, which XLA:CPU vectorises."""
    return jnp.log(safe_divisor(q).astype("float32")).astype(q.dtype) - 5e-6


def _swing(d: Real, w: Vector, u: Real) -> tuple[Real, Real]:
    """The pair q, S."""
    w1, w2, w3 = w
    q = 2 * jnp.abs(d * w3) / safe_divisor(u + (1 + d + d**2) * w3**2)
    return q, jnp.sign(w3) * 2 * w1 * w2 / safe_divisor(u)


def _verdict(residual: Flag, stop: Flag, kind: Array, certified: Flag, value: tuple) -> Verdict:
    """Put a verdict together; a stop wins over a residual, which the exact sets rely on.

    Where a top stops, so do its neighbours, and derivatives are 0: but perhaps not on an axis.
    """
    inside = stop & (kind != Stop.AXIS)
    outcome = jnp.where(
        stop, Outcome.STOP, jnp.where(residual, Outcome.RESIDUAL, Outcome.UNDECIDED)
    )
    omega_inf, error, slope = (jnp.where(inside, 0.0, x) for x in value)
    omega_inf = jnp.where(stop | residual, omega_inf, jnp.nan)
    kind = jnp.where(stop, kind, Stop.NONE)
    return Verdict(outcome.astype(int), omega_inf, certified, kind.astype(int), error, slope)


def _kept(exact: Flag, w1: Real, series: Series) -> Series:
    """The series, or ω₁ where that is constant; derivatives are those of the series even there."""
    omega_inf, error, slope = series
    far = exact & ~(slope < 1)  # where the series is of no use, and may overflow
    kept = jnp.where(far, w1, omega_inf), jnp.where(exact, 0.0, error)
    return *kept, jnp.where(far, jnp.inf, slope)


def _on_axis(axis: Flag, d: Real, w: Vector, value: Series, plane: Flag | bool = False) -> Series:
    """ω∞ = 0 on an axis of decaying spin; but neighbours may keep rotating.

    Its derivatives are those of ω₁ where that is constant, at δ = 0 and in an invariant `plane`
    ω₃ = 0, and 0 on axis 3. On other axes there are none.
    """
    w1, w2, w3 = w
    constant = (d == 0) | plane
    off = jnp.where(plane, w3, jnp.where(d > STEEP_FROM, w1**2 + w1 * w2 + w2**2, 0.0))
    zero = w1 - jax.lax.stop_gradient(w1)  # not −0
    at_rest = piecewise_conserved(
        jnp.where(constant, zero, 0.0), jnp.where(d == 0, d * w2 * w3, off)
    )
    omega_inf, error, slope = value
    return (
        jnp.where(axis, at_rest, omega_inf),
        jnp.where(axis, 0.0, error),
        jnp.where(axis, jnp.where(constant | (w2 == 0) & (w3 != 0), 0.0, jnp.inf), slope),
    )


def first_order(delta: Real, w: Vector) -> Verdict:
    """Order 1, (4.2)–(4.4): every region is proven, for any amplitude."""
    d = delta
    w1, w2, w3 = w
    u = w1**2 + w2**2
    finite = jnp.isfinite(u + jnp.abs(w3) + d)
    # Exact: ω₃ = 0 and δ = 0 keep ω₁; ω⊥ = 0 and ω₁ = ω₃ = 0 are axes of decaying spin.
    keeps = (w3 == 0) | (d == 0)
    axis = (w1 == 0) & ((w2 == 0) | keeps)

    # ω₂² ≤ κu and |δω₃| ≤ λu, κ = λ = ½ or, for δ < 0, (1+2δ)/(2+δ) and √(κ(1−δ)/(2+δ)).
    scale, share = jnp.where(d >= 0, 2.0, 2 + d), jnp.where(d >= 0, 1.0, 1 + 2 * d)
    height = jnp.sqrt(jnp.where(d >= 0, 1.0, jnp.maximum(share, 0.0) * (1 - d)))
    # Unsquared, and not where squares underflow: 0 ≤ 0 would certify anything.
    flat = (scale * jnp.abs(d * w3) <= u * height) & (u >= jnp.finfo(u.dtype).tiny)
    residual = (d > -0.5) & (w1 != 0) & (scale * w2**2 <= share * u) & flat

    fast = (1 + d + d**2) * w3**2
    q, swing = _swing(d, w, u)
    level = _log(q) + swing / safe_divisor(q)
    spins = (q > swing) & (q > 0) & (level > jnp.where(fast <= 0.8 * u, 1.0, 1.1))
    turning = (d < 0) & ~keeps & (spins | (d <= -0.5))

    value = _kept(keeps, w1, residual_first_order(d, w))
    alone = jnp.where((d <= -0.5) & (w3 == 0), w3, 0.0)  # all neighbours with ω₃ ≠ 0 stop
    value = _on_axis(axis, d, w, (piecewise_conserved(value[0], alone), *value[1:]), w3 == 0)
    stop, residual = (axis | turning) & finite, (residual | keeps) & finite
    return _verdict(
        residual, stop, jnp.where(axis, Stop.AXIS, Stop.ROTATING), stop | residual, value
    )


def semi_reduced(delta: Real, w: Vector) -> Verdict:
    """Semi-reduced level: residual (proven for most δ), rotating and wobbling stop (tested)."""
    d = delta
    w1, w2, w3 = w
    u = w1**2 + w2**2
    finite = jnp.isfinite(u + jnp.abs(w3) + d)
    # Exact: ω⊥ = 0 and ω₁ = ω₃ = 0 are axes of decaying spin; δ = 0 keeps ω₁.
    keeps = d == 0
    axis = (w1 == 0) & ((w2 == 0) | (w3 == 0) | keeps)
    line = (w2 == 0) & (w3 == 0) & (w1 != 0)

    residual = _residual_region(d, w) & (w1**2 >= jnp.finfo(u.dtype).tiny)
    proven = (w1**2 <= 10) & (((d >= -1) & (d <= -0.01)) | ((d >= 0.02) & (d <= 0.99)))

    q, swing = _swing(d, w, u)
    p = u / safe_divisor(u + (1 + d + d**2) * w3**2)
    a = -3 * d / (2 * (1 - d))
    level = _log(q) + p * (1 + a - 2 * a * p) * swing / safe_divisor(q)
    spins = (q > swing) & (q > 0) & (level >= jnp.maximum(0.88, 1.15 - jnp.abs(d)))
    turning = (d < 0) & (u > 0) & spins

    stop = (axis | turning | _wobbling_region(d, w)) & finite
    residual = (residual | keeps | line) & finite
    kind = jnp.where(axis, Stop.AXIS, jnp.where(d < 0, Stop.ROTATING, Stop.WOBBLING))
    certified = (stop & axis) | (residual & ~stop & (proven | keeps | line))
    value = _kept(keeps | line, w1, residual_semi_reduced(d, w))
    value = _on_axis(axis, d, w, value)
    return _verdict(residual, stop, kind, certified, value)


def _residual_region(d: Real, w: Vector) -> Flag:
    """D(T²+Z²) + [(1+2δ)T + (2v−δ(1−δ))Z]² + [(1−δ)Z − 2T]² ≤ c(δ)."""
    w1, w2, w3 = w
    one = safe_divisor(w1)
    t, z, v = w2 / one, w3 / one**2, w1**2
    size = jnp.abs(safe_divisor(d))
    bound = jnp.where(d < 0, jnp.minimum(1.75 / size**2, 17 / size), 3.3 / size)
    first = (1 + 2 * d) * t + (2 * v - d * (1 - d)) * z
    second = (1 - d) * z - 2 * t
    return (1 - d + 4 * v) * (t**2 + z**2) + first**2 + second**2 <= bound


def _wobbling_region(d: Real, w: Vector) -> Flag:
    """Inside the stable manifold of the saddle, near the section ω₁ = 0.

    The manifold crosses the section at z = ω₃/u = z_W(δ); `reach` is its Taylor series in the
    angle ε from there, less what the series leaves out and what a finite amplitude changes.
    z_W is a fit from below, within 6e-6 for δ ≤ 0.999.
    """
    w1, w2, w3 = w
    u = w1**2 + w2**2
    x = 1 - d
    room = jnp.where(d > WOBBLING_FROM, d, 0.9)  # any value at which the series is regular
    y = 1 - room
    crossing = (0.725869 + y * (-0.512807147 + y * (-0.243160085 - 0.135716127 * y))) / y
    crossing = crossing * (1 - 3e-6)
    c2 = -(1 + room) / (2 * room**2 * y * crossing)
    c3 = (4 * c2 + (2 + room) / y * crossing) / (3 * room * crossing)
    z = w3 / safe_divisor(u)
    # The angle from the section, by the series of arcsin; it counts against z, by symmetry.
    sine = -w1 * jnp.sign(w2) * jnp.where(z < 0, -1.0, 1.0) / jnp.sqrt(safe_divisor(u))
    s2 = sine**2
    e = sine * (1 + s2 * (1 / 6 + s2 * (3 / 40 + s2 * (5 / 112 + s2 * 35 / 1152))))
    reach = crossing * (1 - 0.005 - 10 * u / y - 0.3 * e**4) + e * (-1 / room + e * (c2 + e * c3))
    small = u <= 10 * x * (d - WOBBLING_FROM)
    return (d > WOBBLING_FROM) & (u > 0) & small & (w1**2 <= 0.31 * u) & (jnp.abs(z) <= reach)


def full(delta: Real, w: Vector) -> Verdict:
    """On the physical branch: as orders 2–4, and beside the residual line at any amplitude.

    There T = ω₂/ω₁ and Z = ω₃/(ω₁ min(|ω₁|, 1)) decay, for the line is stable at every ω₁ ≠ 0
    and δ: of its characteristic polynomial the constant term, ω₁⁴, is positive. Tested only.
    """
    d = delta
    own = second_power(d, w, Level.FULL)
    found = _small(d, w, own)
    one = safe_divisor(w[0])
    off = (w[1] / one) ** 2 + (w[2] / (one * jnp.minimum(jnp.abs(one), 1.0))) ** 2
    beside = (found.outcome == Outcome.UNDECIDED) & (w[0] != 0) & (off <= BESIDE)
    outcome = jnp.where(beside, Outcome.RESIDUAL, found.outcome)
    given = found.omega_inf, found.error, found.slope
    series = (jnp.where(beside, *each) for each in zip(residual_full(w, own), given, strict=True))
    omega_inf, error, slope = series
    return Verdict(outcome, omega_inf, found.certified, found.stop, error, slope)


def higher_order(delta: Real, w: Vector, level: Level) -> Verdict:
    """Orders 2–4 and full: the semi-reduced regions at small amplitude, tested only."""
    return _small(delta, w, second_power(delta, w, level))


def _small(d: Real, w: Vector, own: Real) -> Verdict:
    """A level whose Q₂ is `own`, at small amplitude.

    The levels agree there up to O(ω²), which the error of ω∞ includes.
    """
    size = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
    small = size <= 0.1 * jnp.where(d <= 0.3, 1.0, jnp.minimum(1.0, (1 - d) ** 2))
    found = semi_reduced(d, w)
    series = residual_higher_order(d, w, own)
    value, error, slope = _kept(jnp.asarray(found.error == 0), w[0], series)
    residual = small & (found.outcome == Outcome.RESIDUAL)
    omega_inf = jnp.where(residual, value, jnp.where(small, found.omega_inf, jnp.nan))
    return Verdict(
        jnp.where(small, found.outcome, Outcome.UNDECIDED),
        omega_inf,
        jnp.zeros_like(small),
        jnp.where(small, found.stop, Stop.NONE),
        jnp.where(residual, error, found.error),
        jnp.where(residual, slope, found.slope),
    )


def of_level(delta: Real, w: Vector, level: Level) -> Verdict:
    """The verdict of a level."""
    if level is Level.SEMI:
        return semi_reduced(delta, w)
    return first_order(delta, w) if level is Level.ORDER_1 else higher_order(delta, w, level)
