"""The course of a slow motion on one side of the separatrix, without times.

For many bodies and starts at once: the signs of F on a fixed grid show where a motion leads, and a
quadrature with fixed nodes gives ln L²/L₀² = −∫r(ds/dy)dy. The number of steps is the same in every
case, so that lanes do not wait for each other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.bisection import root
from .._base.chebyshev import collocation_rule
from .._base.types import Real
from .estimates import loss_at_rate
from .slow_flow import FARTHEST, HALVINGS, SPACING, Bound, Interval, Side, bound

PANELS = 24  # panels of the quadrature
NODES = 16  # nodes of each panel


class Course(NamedTuple):
    """A slow motion up to a zero of F, an axis or the separatrix."""

    rises: Bool[Array, "*n"]
    """Whether it leads away from the axis."""
    turns: Bool[Array, "*n"]
    """Whether it leads to a zero of F."""
    log: Real
    """The change of ln L²."""
    loss: Real
    """The largest `estimates.loss` on its way, for ln L²/L₀² = 0 at its start."""
    error: Real
    """Estimated error of `log`."""


def course(side: Side, z: Real, crossed: Bool[Array, ""]) -> Course:
    """Return the motion from z = logit x on a side, or that after it has crossed the separatrix."""
    side = jax.tree.map(lambda a, b: jnp.where(crossed, a, b), side.other, side)
    z = jnp.where(crossed, FARTHEST, z)
    rises = (side.growth(z) > 0) & ~crossed
    points, positive = side.sample()
    ahead = jnp.where(rises, points - z, z - points)
    reverses = positive != rises
    nearest = jnp.min(jnp.where(reverses & (ahead > 0), ahead, jnp.inf))
    behind = jnp.max(jnp.where(reverses & (ahead < 0), ahead, -jnp.inf))
    interval = _interval(side, z, rises, jnp.stack([behind, nearest]))
    return Course(rises, jnp.isfinite(nearest), *_way(interval, z, rises))


def _interval(
    side: Side, z: Real, rises: Bool[Array, ""], reversals: Float[Array, "2"]
) -> Interval:
    """Compute the interval between neighbouring zeros of F that contains z = logit x.

    Args:
        side: the side of the separatrix.
        z: logit x.
        rises: whether x grows.
        reversals: distances from z, in the direction of motion, of the nearest points behind and
            ahead at which F has the other sign; a zero is next to them. Infinite if there is none.
    """
    sign, found = jnp.where(rises, 1.0, -1.0), jnp.isfinite(reversals)
    to = jnp.where(found, reversals, 0.0)
    low = jnp.stack([to[0], jnp.maximum(to[1] - SPACING, 0.0)])
    high = jnp.stack([jnp.minimum(to[0] + SPACING, 0.0), to[1]])
    turned = jnp.stack([sign, -sign])

    def excess(at: Float[Array, "2"]) -> Float[Array, "2"]:
        return turned * jax.vmap(side.growth)(z + sign * at)

    zeros = z + sign * root(excess, low, high, HALVINGS)
    ends = jnp.sort(jnp.where(found, zeros, -turned * jnp.inf))
    both = jax.vmap(lambda z: bound(side, z))(ends)
    return Interval(side, *(Bound(*(leaf[k] for leaf in both)) for k in range(2)))


def _way(interval: Interval, z: Real, rises: Bool[Array, ""]) -> tuple[Real, Real, Real]:
    """Integrate from z = logit x to the end of the interval; return `log`, `loss` and `error`."""
    start = interval.parameter(z)
    end = jnp.where(rises, jnp.maximum(start, FARTHEST), jnp.minimum(start, -FARTHEST))
    rule = collocation_rule(NODES)
    length = (end - start) / PANELS

    def add(so_far: tuple[Real, Real, Real], index: Array) -> tuple[tuple[Real, Real, Real], None]:
        log, largest, error = so_far
        y = start + length * (index + rule.nodes)
        pace, r = jax.vmap(interval.pace)(y)
        change = -length * r * pace
        logs = log + rule.integrals @ change
        of_nodes = jax.vmap(lambda r, *at: loss_at_rate(r, interval.side, at[:2], at[2]))
        losses = of_nodes(r, *interval.position(y), logs)
        tail = jnp.asarray(rule.coefficients[-2:]) @ change
        largest = jnp.maximum(largest, jnp.max(losses))
        return (logs[-1], largest, error + jnp.sum(jnp.abs(tail))), None

    zero = jnp.zeros_like(start)
    way, _ = jax.lax.scan(add, (zero, zero, zero), jnp.arange(PANELS, dtype=start.dtype))
    return way
