"""Estimated errors of averages over free rotation: what is radiated within one period."""

import jax
import jax.numpy as jnp

from .._base.guards import safe_divisor, safe_sqrt
from .._base.types import Real
from .free_rotation import averages, period
from .motion import SlowMotion, Stage
from .principal_axes import FreeRotation
from .slow_flow import Side, from_logit

ERROR = 1.0
"""The estimated error over the part of L² that is radiated within one period; measured."""
QUADRATURE = 1e-12
"""The relative error of the quadratures."""
LONGEST = 5.0
"""The largest K of an estimate: K is infinite on the separatrix, which is crossed only once."""
SOME_KNOTS = 64
"""The number of knots of a stage at which the loss is evaluated."""


def estimated_error(rotation: FreeRotation, on_path: Real, weakness: Real) -> Real:
    """Return the largest part of L² that is radiated within one period, which averaging neglects.

    Periods are long next to the separatrix, above all if two moments are nearly equal. A needle
    leaves the slow flow before its periods become long.

    Args:
        rotation: where the motion begins.
        on_path: the largest `loss` on its path.
        weakness: κL₀/J₃².
    """
    on_path = jnp.where(rotation.is_needle, 0.0, on_path)
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


def loss(side: Side, x: Real, rest: Real, log: Real) -> Real:
    """Compute the part of L² that is radiated within one period, over 2κL₀, at ln L²/L₀² = log."""
    r, _ = side.rates(x, rest)
    return r * period(side.moments, x, rest, LONGEST) * jnp.exp(log / 2)


def largest_loss(motion: SlowMotion) -> Real:
    """Return the largest `loss` of a motion, at some of its knots."""

    def largest(stage: Stage) -> Real:
        some = jnp.arange(SOME_KNOTS) * stage.last // (SOME_KNOTS - 1)
        x, rest = jax.vmap(stage.interval.position)(stage.knots[some])
        of_knots = jax.vmap(lambda *at: loss(stage.interval.side, *at))
        return jnp.max(of_knots(x, rest, stage.states.log[some]))

    first, second = jax.vmap(largest)(motion.stages)
    return jnp.maximum(first, jnp.where(motion.crosses, second, 0.0))


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
