"""The slow flow: how radiation changes energy and angular momentum over many free rotations.

With h = 2E/L² and ds = 2κL² dt the averages over free rotation (`free_rotation`) give

    dx/ds = x F(x),   d ln L²/ds = −r(x),   h = c + x Db,

on each side of the separatrix h = 1/J₂. So x obeys a scalar law. It tends to a stable zero of F, to
the axis x = 0, or to the separatrix, which it reaches at finite s and crosses to the other side.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.bisection import bisect
from .._base.chebyshev import collocation_rule
from .._base.types import Real
from .free_rotation import averages

FARTHEST = 45.0  # |logit x| beyond which nothing changes in double precision
SPACING = 0.25  # of the grid in logit x on which zeros of F are looked for
HALVINGS = 60
NEAR = 1e-3  # part of the distance to other zeros within which F is a polynomial about a zero


class Side(eqx.Module):
    """The slow flow on one side of the separatrix."""

    moments: Float[Array, "3"]
    """J_a, J_b, J_c: c is the axis that L encloses, b the middle one."""
    shares: Float[Array, "3"]
    """Squares of the direction cosines of the dipole, in the same order."""

    def rates(self, x: Real, xc: Real) -> tuple[Real, Real]:
        """r and F at x; xc = 1 − x."""
        mean = averages(self.moments, x, xc)
        return self.shares @ mean.r, self.shares @ mean.growth

    def growth(self, z: Real) -> Real:
        """F at z = logit x."""
        return self.rates(*from_logit(z))[1]


def from_logit(z: Real) -> tuple[Real, Real]:
    """x and 1 − x, each to its own relative accuracy."""
    return jax.nn.sigmoid(z), jax.nn.sigmoid(-z)


def zeros(side: Side, most: int = 4) -> Float[Array, "most"]:
    """logit x of the zeros of F in (0, 1), ascending, filled up with +∞."""
    grid = jnp.arange(-FARTHEST, FARTHEST + SPACING, SPACING)
    positive = jax.vmap(side.growth)(grid) > 0
    changes = positive[1:] != positive[:-1]
    (where,) = jnp.nonzero(changes, size=most, fill_value=-1)
    low, high = grid[where], grid[where + 1]
    rising = positive[where + 1]

    def passed(z: Array) -> Array:
        return (jax.vmap(side.growth)(z) > 0) == rising

    low, high = bisect(passed, low, high, HALVINGS)
    fixed, z = jax.lax.stop_gradient((side, (low + high) / 2))
    slope = jax.vmap(jax.grad(fixed.growth))(z)
    root = z - (jax.vmap(side.growth)(z) - jax.lax.stop_gradient(jax.vmap(side.growth)(z))) / slope
    return jnp.where(where >= 0, root, jnp.inf)


NODES = 8  # of the polynomial F/ξ about a zero of F
RADIUS = 0.05  # half width of its interval, in units of the distance to the ends of (0, 1)
RTOL = 1e-13


class Neighbour(NamedTuple):
    """An end of the interval of x between zeros of F: a zero, or the axis or the separatrix."""

    x: Real
    xc: Real
    is_zero: Bool[Array, ""]
    radius: Real
    """Half width of the interval about the zero on which the polynomial holds."""
    series: Float[Array, "n"]
    """Chebyshev coefficients of F/(x − x*) on that interval."""


def _neighbour(side: Side, z: Real) -> Neighbour:
    x, xc = from_logit(z)
    is_zero = jnp.isfinite(z)
    radius = RADIUS * jnp.where(is_zero, jnp.minimum(x, xc), 1.0)
    rule = collocation_rule(NODES)
    shift = jnp.where(is_zero, radius, 0.0) * (2 * rule.nodes - 1)
    safe_x, safe_xc = jnp.where(is_zero, x, 0.5), jnp.where(is_zero, xc, 0.5)
    growth = jax.vmap(lambda d: side.rates(safe_x + d, safe_xc - d)[1])(shift)
    quotient = growth / jnp.where(is_zero, shift, 1.0)
    return Neighbour(x, xc, is_zero, radius, rule.coefficients @ quotient)


def _series(neighbour: Neighbour, shift: Real) -> Real:
    """F/(x − x*) by the series."""
    t = jnp.clip(shift / neighbour.radius, -1.0, 1.0)
    b1 = b2 = jnp.zeros_like(t)
    for c in neighbour.series[:0:-1]:
        b1, b2 = c + 2 * t * b1 - b2, b1
    return neighbour.series[0] + t * b1 - b2


class Stage(eqx.Module):
    """The motion on one side of the separatrix, from a start to the next zero of F or end."""

    side: Side
    low: Neighbour
    high: Neighbour
    width: Real
    start: Real
    """y₀."""
    rising: Bool[Array, ""]

    @classmethod
    def of(cls, side: Side, z0: Real) -> "Stage":
        roots = zeros(side)
        low = _neighbour(side, jnp.max(jnp.where(roots < z0, roots, -jnp.inf)))
        high = _neighbour(side, jnp.min(jnp.where(roots > z0, roots, jnp.inf)))
        width = jnp.where(high.x < 0.5, high.x - low.x, low.xc - high.xc)
        x, xc = from_logit(z0)
        above = jnp.where(x < 0.5, x - low.x, low.xc - xc)
        below = jnp.where(x < 0.5, high.x - x, xc - high.xc)
        return cls(side, low, high, width, jnp.log(above) - jnp.log(below), side.growth(z0) > 0)

    @property
    def end(self) -> Real:
        return jnp.where(
            self.rising, jnp.maximum(self.start, FARTHEST), jnp.minimum(self.start, -FARTHEST)
        )

    def position(self, y: Real) -> tuple[Real, Real]:
        up, down = from_logit(y)
        return self.low.x + self.width * up, self.high.xc + self.width * down

    def pace(self, y: Real) -> tuple[Real, Real]:
        """ds/dy and r."""
        up, down = from_logit(y)
        x, xc = self.position(y)
        r, growth = self.side.rates(x, xc)
        near_low = self.low.is_zero & (y <= 0) & (self.width * up < self.low.radius)
        near_high = self.high.is_zero & (y > 0) & (self.width * down < self.high.radius)
        by_low = down / (x * _series(self.low, self.width * up))
        by_high = -up / (x * _series(self.high, -self.width * down))
        # x/up is 1/width at the axis
        ratio = jnp.where(self.low.is_zero, x / up, self.width)
        direct = self.width * down / (ratio * jnp.where(near_low | near_high, 1.0, growth))
        return jnp.where(near_low, by_low, jnp.where(near_high, by_high, direct)), r

    def solve(self, initial: Array) -> Any:
        def field(y, state, args):
            _, _, u = state
            pace, r = self.pace(y)
            return pace * jnp.stack([jnp.ones_like(r), -r, 1 - r * u])

        return diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            self.start,
            self.end,
            None,
            initial,
            stepsize_controller=diffrax.PIDController(RTOL, RTOL),
            max_steps=1000,
            throw=False,
            saveat=diffrax.SaveAt(t1=True, dense=True),
        )


def lifted(moments, L):
    """Side (high?), z0 from the angular momentum in principal axes."""
    y = L**2 / jnp.sum(L**2)
    p12 = (moments[1] - moments[0]) / (moments[0] * moments[1])
    p23 = (moments[2] - moments[1]) / (moments[1] * moments[2])
    p13 = (moments[2] - moments[0]) / (moments[0] * moments[2])
    difference = p23 * y[2] - p12 * y[0]
    is_high = difference < 0
    # x Db of either side, and (1-x) Db
    low = p13 * y[0] + p23 * y[1]
    high = p13 * y[2] + p12 * y[1]
    num = jnp.where(is_high, high, low)
    return is_high, jnp.log(num) - jnp.log(jnp.abs(difference))


def ratio(moments, n2, L):
    """ln L∞²/L₀², through the separatrix; and the target z, and whether high."""
    is_high, z0 = lifted(moments, L)
    first = Side(jnp.where(is_high, moments[::-1], moments), jnp.where(is_high, n2[::-1], n2))
    second = Side(first.moments[::-1], first.shares[::-1])
    one = Stage.of(first, z0)
    a = one.solve(jnp.zeros(3))
    crosses = one.rising & ~one.high.is_zero
    two = Stage.of(second, jnp.asarray(FARTHEST))
    two = eqx.tree_at(lambda s: s.rising, two, jnp.asarray(False))
    b = two.solve(a.ys[-1])
    end = jnp.where(crosses, b.ys[-1], a.ys[-1])
    return end, is_high, crosses, one.rising, a.stats["num_steps"], b.stats["num_steps"]
