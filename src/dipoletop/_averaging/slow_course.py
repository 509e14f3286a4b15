"""The end of a slow motion and the momentum that it keeps, without times.

For many bodies and starts at once: the signs of F on a fixed grid show where a motion leads, and a
quadrature with fixed nodes gives ln L∞²/L₀² = −∫r(ds/dy)dy for residual rotation. The number of
steps is the same in every case, so that lanes do not wait for each other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._base.bisection import root
from .._base.chebyshev import collocation_rule
from .._base.types import Real
from .estimates import loss
from .principal_axes import FreeRotation
from .slow_flow import FARTHEST, HALVINGS, SPACING, Interval, Side, bound

PANELS = 24  # panels of the quadrature
NODES = 16  # nodes of each panel


class Outline(NamedTuple):
    """The end of a slow motion."""

    crosses: Bool[Array, ""]
    """Whether it crosses the separatrix."""
    ends_high: Bool[Array, ""]
    """Whether it ends on the side of the axis of J₁, rather than of J₃."""
    spins: Bool[Array, ""]
    """Whether it ends on an axis, rather than at a zero of F."""
    log: Real
    """ln L²/L₀² at the end if that is residual rotation, else −∞."""
    loss: Real
    """The largest `estimates.loss` on its path."""
    error: Real
    """Estimated error of `log`."""


def outline(rotation: FreeRotation) -> Outline:
    """Return where the slow motion of a body with at least two different moments leads."""
    high, z = rotation.place
    side = rotation.side(high)
    rises = side.growth(z) > 0
    points, positive = side.sample()
    ahead = jnp.where(rises, points - z, z - points)
    reverses = positive != rises
    nearest = jnp.min(jnp.where(reverses & (ahead > 0), ahead, jnp.inf))
    behind = jnp.max(jnp.where(reverses & (ahead < 0), ahead, -jnp.inf))
    turns = jnp.isfinite(nearest)
    has_other_side = side.moments[1] != side.moments[0]
    crosses = rises & ~turns & has_other_side
    _, beyond = side.other.sample()
    spins = jnp.where(crosses, ~jnp.any(beyond), ~rises & ~turns)
    ends_high = high ^ crosses
    axis = jnp.where(ends_high, 0, 2)
    residual = spins & (rotation.spin_decay(axis) == 0)
    first = _way(_interval(side, z, rises, (behind, nearest)), z, rises)
    whole = Interval(side.other, *(bound(side.other, jnp.full((), x)) for x in (-jnp.inf, jnp.inf)))
    second = _way(whole, jnp.full_like(z, FARTHEST), jnp.zeros_like(rises))
    log = jnp.where(residual, first.log + jnp.where(crosses, second.log, 0.0), -jnp.inf)
    error = jnp.where(residual, first.error + jnp.where(crosses, second.error, 0.0), 0.0)
    # If a zero of F lies beyond the separatrix, `first.loss` also stands for the way to that zero.
    later = jnp.where(crosses & spins, second.loss * jnp.exp(first.log / 2), 0.0)
    return Outline(crosses, ends_high, spins, log, jnp.maximum(first.loss, later), error)


def _interval(
    side: Side, z: Real, rises: Bool[Array, ""], reversals: tuple[Real, Real]
) -> Interval:
    """Compute the interval between neighbouring zeros of F that contains z = logit x.

    Args:
        side: the side of the separatrix.
        z: logit x.
        rises: whether x grows.
        reversals: distances from z, in the direction of motion, of the nearest points behind and
            ahead at which F has the other sign; a zero is next to them. Infinite if there is none.
    """
    sign = jnp.where(rises, 1.0, -1.0)
    behind, ahead = (jnp.where(jnp.isfinite(x), x, 0.0) for x in reversals)

    def zero(turned: float, low: Real, high: Real) -> Real:
        return z + sign * root(
            lambda at: turned * sign * side.growth(z + sign * at), low, high, HALVINGS
        )

    before = zero(1.0, behind, jnp.minimum(behind + SPACING, 0.0))
    after = zero(-1.0, jnp.maximum(ahead - SPACING, 0.0), ahead)
    before = jnp.where(jnp.isfinite(reversals[0]), before, -sign * jnp.inf)
    after = jnp.where(jnp.isfinite(reversals[1]), after, sign * jnp.inf)
    low, high = jnp.minimum(before, after), jnp.maximum(before, after)
    return Interval(side, bound(side, low), bound(side, high))


class _Course(NamedTuple):
    """A part of a motion, up to an end of an interval."""

    log: Real
    """The change of ln L²."""
    error: Real
    """Its estimated error."""
    loss: Real
    """The largest `estimates.loss`, for ln L²/L₀² = 0 at its start."""


def _way(interval: Interval, z: Real, rises: Bool[Array, ""]) -> _Course:
    """Integrate from z = logit x to the end of the interval."""
    start = interval.parameter(z)
    end = jnp.where(rises, jnp.maximum(start, FARTHEST), jnp.minimum(start, -FARTHEST))
    rule = collocation_rule(NODES)
    length = (end - start) / PANELS

    def add(so_far: _Course, index: Array) -> tuple[_Course, None]:
        y = start + length * (index + rule.nodes)
        pace, r = jax.vmap(interval.pace)(y)
        change = -length * r * pace
        logs = so_far.log + rule.integrals @ change
        x, rest = interval.position(y)
        losses = jax.vmap(lambda *at: loss(interval.side, *at))(x, rest, logs)
        tail = jnp.asarray(rule.coefficients[-2:]) @ change
        return _Course(
            logs[-1],
            so_far.error + jnp.sum(jnp.abs(tail)),
            jnp.maximum(so_far.loss, jnp.max(losses)),
        ), None

    zero = jnp.zeros_like(start)
    way, _ = jax.lax.scan(add, _Course(zero, zero, zero), jnp.arange(PANELS, dtype=start.dtype))
    return way
