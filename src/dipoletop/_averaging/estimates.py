"""Estimated errors of averages over free rotation: by the loss within one period, by rounding."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_divisor, safe_sqrt
from .._base.linalg import components, dot
from .._base.types import Real
from .free_rotation import averages, gaps_of, period
from .motion import Point, SlowMotion
from .principal_axes import FreeRotation
from .slow_flow import from_logit

ERROR = 1.0
"""The estimated error over the part of L² that is radiated within one period; measured."""
QUADRATURE = 1e-12
"""The relative error of the quadratures."""
NARROW = 6.0
"""ln L₀/L∞ beyond which a motion may linger where F almost vanishes; measured."""


def estimated_error(rotation: FreeRotation, motion: SlowMotion, weakness: Real) -> Real:
    """Return the largest part of L² that is radiated within one period, which averaging neglects.

    Periods are long next to the separatrix, above all if two moments are nearly equal. A needle
    leaves the slow flow before its periods become long.

    Args:
        rotation: where the motion begins.
        motion: the slow motion.
        weakness: κL₀/J₃².
    """
    on_path = jnp.where(rotation.is_needle, 0.0, motion.loss)
    return jnp.maximum(start_error(rotation, weakness), ERROR * weakness * on_path / jnp.pi)


def start_error(rotation: FreeRotation, weakness: Real) -> Real:
    """Return the part of L² that is radiated within the first period.

    The mean rate of a dipole off the principal axes is r = Σnᵢ²rᵢ. But there are also oscillations
    in proportion to nᵢnⱼ, and the means of their products change r by an amount that does not
    fall with r. So the estimate uses (Σ|nᵢ|√rᵢ)⁴/r in place of r.
    """
    high, z = rotation.place
    side = rotation.side(high)
    x, rest = from_logit(z)
    parts = side.weights * averages(side.moments, x, rest)[0]
    rate = jnp.sum(safe_sqrt(parts)) ** 4 / safe_divisor(jnp.sum(parts))
    return ERROR * weakness * rate * period(side.moments, x, rest) / jnp.pi + QUADRATURE


def error_at(rotation: FreeRotation, point: Point, weakness: Real) -> Real:
    """Return the part of L² that is radiated within one period, at a point of a motion."""
    side, place = rotation.side(point.high), (point.x, point.rest)
    lost = side.loss(*place, side.rates(*place)[0], point.log)
    return ERROR * weakness * lost / jnp.pi


def error_of_phase(rotation: FreeRotation, weakness: Real) -> Real:
    """Return the error of a needle that is captured from a known phase.

    The plane of its motion neglects ω₃² beside ω⊥². While q = 2δ|ω₃|/ω⊥² falls to 1 the phase
    changes by about q.
    """
    omega = rotation.momentum / rotation.moments
    across = omega[1] ** 2 + omega[2] ** 2
    delta = 1 - rotation.moments[0] / rotation.moments[2]
    q = 2 * delta * jnp.abs(omega[0]) / (weakness * across)
    return weakness + q * omega[0] ** 2 / across


def rounding_error(rotation: FreeRotation, log: Real) -> Real:
    """Return the relative error of L∞/L₀ and of times by rounding of the inertia tensor.

    Rounding changes moments and their differences. L∞/L₀ and times depend on these by powers, and
    ln L∞/L₀ is a mean rate times a duration; it is in proportion to 1/δ for a nearly spherical
    needle, and to the distance to the power −½ where two zeros of F have just vanished, at which
    the motion lingers. Rounding also turns the principal axes: the start moves, and the mean loss
    r = Σnᵢ²rᵢ changes.

    Args:
        rotation: where the motion begins.
        log: ln L∞/L₀, −∞ for a stop.
    """
    rotation, log = jax.lax.stop_gradient((rotation, log))
    high, z = rotation.place
    side = rotation.side(high)
    x, rest = from_logit(z)
    rates, growths = averages(side.moments, x, rest)
    j1, j2, j3 = components(rotation.moments)
    gaps = jnp.stack([j2 - j1, j3 - j2])
    apart = j3 * jnp.max(jnp.where(gaps > 0, 1 / safe_divisor(gaps), 0.0))
    log = jnp.where(jnp.isfinite(log), jnp.abs(log), 0.0)
    steepness = 2 * log * jnp.where(rotation.is_needle, apart, 1 + (log / NARROW) ** 2)
    moved = rotation.rounding * (apart + j3 / j1 + steepness)
    # Of residual rotation, d ln L∞/dz = −½r dz/ds, dz/ds = F/(1 − x).
    slope = rest * dot(side.weights, rates) / safe_divisor(jnp.abs(dot(side.weights, growths)))
    shift = place_error(rotation, high) * (1 + jnp.where(log > 0, slope / 2, 0.0))
    return moved + shift + rate_error(rotation, high, rates)


def place_error(rotation: FreeRotation, high: Bool[Array, ""]) -> Real:
    """Return the error of z = logit x of the start by rounding, which turns the axes."""
    p13, p23, p12 = gaps_of(rotation.moments)
    zero = jnp.zeros_like(p12)
    inside = jnp.where(high, jnp.stack([zero, p12, p13]), jnp.stack([p13, p23, zero]))
    above = jnp.stack([p12, zero, -p23])
    # Ω is known to rounding, and L = IΩ.
    momentum = rotation.momentum
    error = rotation.moments * rotation.rounding_of(momentum / rotation.moments)

    def part(w: Float[Array, "3"]) -> Real:
        return 2 * dot(jnp.abs(w * momentum), error) / safe_divisor(jnp.abs(dot(w, momentum**2)))

    return part(inside) + part(above)


def rate_error(rotation: FreeRotation, high: Bool[Array, ""], rates: Float[Array, "3"]) -> Real:
    """Return the relative error of Σnᵢ²rᵢ by rounding, which turns the axes.

    Args:
        rotation: the dipole and its rounding.
        high: whether the rᵢ are in the order of the high side.
        rates: the rᵢ.
    """
    rotation, rates = jax.lax.stop_gradient((rotation, rates))
    n, rates = rotation.dipole, jnp.where(high, rates[::-1], rates)
    change = dot(rates, jnp.abs(n) * rotation.rounding_of(n))
    return 2 * change / safe_divisor(dot(rates, n**2))
