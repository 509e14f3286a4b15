"""Where a slow motion leads, and how much momentum it keeps, without its times.

For many bodies and starts at once: the signs of F on a fixed grid tell where a motion leads, and a
quadrature with fixed nodes gives ln L∞²/L₀² = −∫r(ds/dy)dy where that is residual rotation. No
number of steps depends on the case, so that lanes do not wait for each other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.bisection import root
from .._base.chebyshev import collocation_rule
from .._base.types import Real
from .principal_axes import FreeRotation
from .slow_flow import FARTHEST, HALVINGS, SPACING, Interval, Side, bound

PANELS = 24  # of the quadrature
NODES = 16  # on each


class Outline(NamedTuple):
    """Where a slow motion leads."""

    crosses: Bool[Array, ""]
    """Whether it crosses the separatrix."""
    ends_high: Bool[Array, ""]
    """The side on which it ends: that of the axis of J₁, or of J₃."""
    spins: Bool[Array, ""]
    """Whether it ends on an axis, rather than at a zero of F."""
    log: Real
    """ln L²/L₀² at the end if that is residual rotation, else −∞."""
    log_crossing: Real
    """ln L²/L₀² at the separatrix, 0 if it does not cross."""
    error: Real
    """Estimated error of `log`."""


def outline(rotation: FreeRotation) -> Outline:
    """Where the slow motion of a body with at least two different moments leads."""
    high, z = rotation.place
    side = rotation.side(high)
    rises = side.growth(z) > 0
    points, positive = side.sample()
    ahead = jnp.where(rises, points - z, z - points)
    reverses = positive != rises
    turns = jnp.any(reverses & (ahead > 0))
    has_other_side = side.moments[1] != side.moments[0]
    crosses = rises & ~turns & has_other_side
    _, beyond = side.other.sample()
    spins = jnp.where(crosses, ~jnp.any(beyond), ~rises & ~turns)
    ends_high = high ^ crosses
    axis = jnp.where(ends_high, 0, 2)
    residual = spins & (rotation.spin_decay(axis) == 0)
    behind = jnp.max(jnp.where(reverses & (ahead < 0), ahead, -jnp.inf))
    first = _log_lost(_open_interval(side, z, rises, behind), z, rises)
    second = _log_lost(_whole(side.other), jnp.full_like(z, FARTHEST), jnp.zeros_like(rises))
    logs, errors = jnp.stack([first, second]).T
    used = jnp.stack([jnp.ones_like(crosses), crosses])
    log = jnp.where(residual, jnp.sum(jnp.where(used, logs, 0.0)), -jnp.inf)
    error = jnp.where(residual, jnp.sum(jnp.where(used, errors, 0.0)), 0.0)
    return Outline(crosses, ends_high, spins, log, jnp.where(crosses, logs[0], 0.0), error)


def _open_interval(side: Side, z: Real, rises: Bool[Array, ""], behind: Real) -> Interval:
    """The interval in which a motion goes from z to the axis or to the separatrix.

    Args:
        side: the side of the separatrix.
        z: logit x.
        rises: whether x grows.
        behind: minus the distance of the nearest point behind z at which F has the other sign;
            there is a zero next to it, from which the motion comes. Infinite if there is none.
    """
    sign = jnp.where(rises, 1.0, -1.0)
    far = jnp.where(jnp.isfinite(behind), behind, 0.0)
    near = jnp.minimum(far + SPACING, 0.0)
    zero = z + sign * root(lambda at: sign * side.growth(z + sign * at), far, near, HALVINGS)
    zero = jnp.where(jnp.isfinite(behind), zero, -sign * jnp.inf)
    low = bound(side, jnp.where(rises, zero, -jnp.inf))
    high = bound(side, jnp.where(rises, jnp.inf, zero))
    return Interval(side, low, high)


def _whole(side: Side) -> Interval:
    """The interval from the axis to the separatrix."""
    infinite = jnp.full((), jnp.inf)
    return Interval(side, bound(side, -infinite), bound(side, infinite))


def _log_lost(interval: Interval, z: Real, rises: Bool[Array, ""]) -> Float[Array, "2"]:
    """The change of ln L² from z to the end of the interval, and its estimated error."""
    start = interval.parameter(z)
    end = jnp.where(rises, jnp.maximum(start, FARTHEST), jnp.minimum(start, -FARTHEST))
    rule = collocation_rule(NODES)
    length = (end - start) / PANELS

    def add(total: Array, index: Array) -> tuple[Array, None]:
        pace, r = jax.vmap(interval.pace)(start + length * (index + rule.nodes))
        change = -length * r * pace
        tail = jnp.asarray(rule.coefficients[-2:]) @ change
        return total + jnp.stack([rule.integrals[-1] @ change, jnp.sum(jnp.abs(tail))]), None

    total, _ = jax.lax.scan(add, jnp.zeros(2), jnp.arange(PANELS, dtype=start.dtype))
    return total
