"""Regions of the transverse top from which the outcome is certain, and ω∞ inside them.

Each function takes δ and ω and returns a `Verdict`. Exact invariant sets come first. Shorthand
of the regions: u = ω₁² + ω₂², U = u + Mω₃², M = 1 + δ + δ², q = 2|δω₃|/U, and
S = sgn(ω₃)·2ω₁ω₂/u. On the residual side T = ω₂/ω₁, Z = ω₃/ω₁² and v = ω₁².
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._types import Outcome, Real, Stop, Vector, Verdict

Flag = Bool[Array, "*lanes"]


def _guarded(denominator: Real) -> Real:
    """1 in place of 0, so that no unused branch divides by it."""
    return jnp.where(denominator == 0, 1.0, denominator)


def _verdict(residual: Flag, stop: Flag, omega_inf: Real, certified: Flag, kind, error) -> Verdict:
    """Assemble; `stop` wins over `residual`, which the exact sets rely on."""
    outcome = jnp.where(
        stop, Outcome.STOP, jnp.where(residual, Outcome.RESIDUAL, Outcome.UNDECIDED)
    )
    value = jnp.where(stop, 0.0, jnp.where(residual, omega_inf, jnp.nan))
    kind = jnp.where(stop, kind, Stop.NONE)
    return Verdict(
        outcome.astype(int), value, certified & (residual | stop), kind.astype(int), error
    )


def first_order(delta: Real, w: Vector) -> Verdict:
    """Order 1, all proven, any amplitude: where a run of (4.2)–(4.4) may end."""
    d = delta
    w1, w2, w3 = w
    u = w1**2 + w2**2
    # Exact: ω₃ = 0 and δ = 0 keep ω₁; ω⊥ = 0 and ω₁ = ω₃ = 0 are axes of decaying spin.
    keeps = (w3 == 0) | (d == 0)
    axis = ((w1 == 0) & (w2 == 0)) | (keeps & (w1 == 0))

    narrow = jnp.where(d >= 0, 0.5, (1 + 2 * d) / (2 + d))
    low = (1 - d) * narrow / jnp.where(d >= 0, 1.0, 2 + d)
    flat = jnp.where(d >= 0, 2 * d * jnp.abs(w3) <= u, _within(d, w3, u, low))
    residual = (d > -0.5) & (w1 != 0) & (w2**2 <= narrow * u) & flat

    turning = (d <= -0.5) & (w3 != 0)
    stop = axis | turning | ((d > -0.5) & (d < 0) & _rotating_first_order(d, w, u))
    value, error = _residual_first_order(d, w)
    kind = jnp.where(axis, Stop.AXIS, Stop.ROTATING)
    value = jnp.where(keeps, w1, value)
    error = jnp.where(keeps, 0.0, error)
    sound = jnp.isfinite(u + jnp.abs(w3) + d)
    return _verdict((residual | keeps) & sound, stop & sound, value, sound, kind, error)


def _within(d: Real, w3: Real, u: Real, low: Real) -> Flag:
    """|ω₃| ≤ u √((1−δ)(1+2δ)) / (|δ|(2+δ)), squared; `low` = (1−δ)(1+2δ)/(2+δ)²."""
    return (d * w3) ** 2 <= low * u**2


def _rotating_first_order(d: Real, w: Vector, u: Real) -> Flag:
    """The proven region of the rotating stop, −1/2 < δ < 0."""
    w1, w2, w3 = w
    fast = (1 + d + d**2) * w3**2
    q = 2 * jnp.abs(d * w3) / _guarded(u + fast)
    swing = jnp.sign(w3) * 2 * w1 * w2 / _guarded(u)
    safe = jnp.where(q > 0, q, 1.0)
    level = jnp.log(safe) + swing / safe
    return (q > swing) & (q > 0) & (level > jnp.where(fast <= 0.8 * u, 1.0, 1.1))


def _residual_first_order(d: Real, w: Vector) -> tuple[Real, Real]:
    """ω∞ = ω₁ + δω₂ω₃/((1+β)ω₁²) − δ²ω₃²/(2β(1+β)ω₁³), β = (1+2δ)/(1−δ)."""
    w1, w2, w3 = w
    one = _guarded(w1)
    t, z = w2 / one, w3 / one**2
    beta = (1 + 2 * d) / (1 - d)
    beta = jnp.where(beta > 0, beta, 1.0)
    pull = d * z / (1 + beta)
    value = w1 * (1 + t * pull - pull * d * z / (2 * beta))
    return value, (jnp.abs(t) + jnp.abs(z)) ** 4


def semi_reduced(delta, w):
    return first_order(delta, w)


def higher_order(delta, w):
    return first_order(delta, w)
