"""The slow flow: how radiation changes the free rotation of a body over many periods.

With h = 2E/L² and ds = 2κL²dt the averages over free rotation (`free_rotation`) give

    dx/ds = x F(x),   d ln L²/ds = −r(x),   x = (h − c)/Db,

on either side of the separatrix h = p₂. So x obeys an autonomous equation. It tends to a
stable zero of F, to the axis x = 0, or to the separatrix. F has the same sign on both sides of the
separatrix and vanishes there as 1/ln(1/(1 − x)) only, so x crosses it at a finite s, once.

Between two neighbouring zeros x₋ and x₊ of F (or the axis x₋ = 0, the separatrix x₊ = 1) a motion
is parametrised by y = ln (x − x₋)/(x₊ − x), which is monotonic in time. Then ds/dy is smooth and
bounded on the whole line: the logarithm at the separatrix and the exponential approach to a zero
become exponentially small terms. Near a zero x*, a polynomial represents F/(x − x*).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.chebyshev import chebyshev_sum, collocation_rule
from .._base.guards import safe_divisor
from .._base.linalg import components
from .._base.roots import root
from .._base.types import Real
from .free_rotation import averages, period

FARTHEST = 45.0  # |logit x| and |y| beyond which the rates are constant in double precision
SIMPLE = 20.0
"""|logit x| from which F has one zero at most. Near the axis F is linear in x; near the separatrix
K F is a constant and a multiple of (1 − x)K, which is monotonic."""
SPARSE, DENSE, MIDDLE = 0.5, 0.25, 8.0  # spacings beyond |logit x| = 8, and within
FAR = np.array([28.0, 36.0, FARTHEST])
GRID = np.concatenate(
    [
        -FAR[::-1],
        np.arange(-SIMPLE, -MIDDLE, SPARSE),
        np.arange(-MIDDLE, MIDDLE, DENSE),
        np.arange(MIDDLE, SIMPLE + SPARSE, SPARSE),
        FAR,
    ]
)
"""Values of logit x at which zeros of F are looked for."""
FOLD_ROUNDS = 8  # of parabolas to find an extremum
HALVINGS = 55
NODES = 8  # of the polynomial F/(x − x*) about a zero x*
LONGEST = 5.0  # largest K of a `loss`: K is infinite on the separatrix, which is crossed only once
SMALLEST = 1e-300  # 1 − x on the separatrix, where a symmetric body has 0/0
RADIUS = 0.05  # half width of the polynomial's interval over the distance of x* from 0 and 1


class Side(eqx.Module):
    """The slow flow on one side of the separatrix."""

    moments: Float[Array, "3"]
    """J_a, J_b, J_c: L moves round axis c; b is the middle one."""
    weights: Float[Array, "3"]
    """The squares of the direction cosines of the dipole, in the same order."""

    def rates(self, x: Real, rest: Real) -> tuple[Real, Real]:
        """Compute the rates r and F at x, with rest = 1 − x."""
        r, growth = averages(self.moments, x, rest)
        return self.weights @ r, self.weights @ growth

    def shape(self, x: Real, rest: Real) -> Real:
        """Compute the shape h = 2E/L² of the rotation at x, with rest = 1 − x."""
        _, jb, jc = components(self.moments)
        return rest / jc + x / jb

    def growth(self, z: Real) -> Real:
        """Compute the rate F at z = logit x."""
        return self.rates(*from_logit(z))[1]

    @property
    def other(self) -> "Side":
        """The side beyond the separatrix."""
        return Side(self.moments[::-1], self.weights[::-1])

    def loss(self, x: Real, rest: Real, r: Real, log: Real) -> Real:
        """Compute the part of L² that is radiated within one period, over 2κL₀.

        Args:
            x: the position.
            rest: 1 − x.
            r: the mean rate there.
            log: ln L²/L₀² there.
        """
        return r * period(self.moments, x, rest, LONGEST) * jnp.exp(log / 2)

    def sample(self, z: Real) -> tuple[Float[Array, "g"], Bool[Array, "g"], Bool[Array, ""]]:
        """Return points between which F changes sign at most once, and whether F > 0 there.

        An ascending grid of logit x is followed by the extrema of F between its points that
        may hide two zeros, filled up with the last value of the grid. The last result is whether
        F > 0 at z.
        """
        growths = jax.vmap(self.growth)(jnp.append(jnp.asarray(GRID), z))
        growth, here = growths[:-1], growths[-1]
        folds, extrema = self._folds(growth)
        points = jnp.append(jnp.asarray(GRID), folds)
        return points, jnp.append(growth, extrema) > 0, here > 0

    def _folds(self, growth: Float[Array, "G"]) -> tuple[Float[Array, "m"], Float[Array, "m"]]:
        """Return logit x and F of extrema of F next to 0, by parabolas through three points."""
        # At each inner point and at its two neighbours on either side.
        around = [growth[k : growth.size - 4 + k] for k in range(5)]
        size, sign = map(jnp.abs, around), list(map(jnp.sign, around))
        before, previous, here, following, after = size
        low = here < 0.5 * jnp.maximum(before, after)
        low &= (here <= previous) & (sign[2] == sign[1])
        low &= (here <= following) & (sign[2] == sign[3])
        # Take the first and the last of them; more than one was never seen.
        found, last = jnp.any(low), low.size - 1
        index = jnp.stack([jnp.argmax(low), last - jnp.argmax(low[::-1])]) + 2

        def nearer(_: Any, at: tuple[Array, ...]) -> tuple[Array, ...]:
            _, _, place, step = at
            points = jnp.stack([place - step, place, place + step])
            before, here, after = jax.vmap(jax.vmap(self.growth))(points)
            bend = before - 2 * here + after
            shift = (before - after) / (2 * safe_divisor(bend))
            return place, here, place + step * jnp.clip(shift, -1.0, 1.0), step / 4

        # A parabola leaves an error of the order of the step squared, below a fourth of the step.
        index = jnp.where(found, index, growth.size - 1)
        start = jnp.asarray(GRID)[index]
        first = start, growth[index], start, jnp.asarray(np.ediff1d(GRID, 0.0))[index]
        rounds = jnp.where(found, FOLD_ROUNDS, 0)
        place, extremum, _, _ = jax.lax.fori_loop(0, rounds, nearer, first)
        return place, extremum


class Bound(NamedTuple):
    """An end of the interval of x in which a motion stays."""

    x: Real
    rest: Real
    """1 − x, to its own relative accuracy."""
    r: Real
    """−d ln L²/ds there."""
    rates: Float[Array, "3 *any"]
    """The r of a dipole along each axis, in the order of the side."""
    is_zero: Bool[Array, "*any"]
    """Whether it is a zero of F, rather than the axis or the separatrix."""
    radius: Real
    """Half width of the interval on which the polynomial is used."""
    coefficients: Float[Array, "*any n"]
    """Chebyshev coefficients of F/(x − x*) on that interval."""

    def quotient(self, shift: Real) -> Real:
        """Compute F/(x − x*) at x = x* + shift."""
        return chebyshev_sum(self.coefficients, jnp.clip(shift / self.radius, -1.0, 1.0))


class Interval(eqx.Module):
    """The interval of x between two neighbouring zeros of F, and the parameter y on it."""

    side: Side
    low: Bound
    high: Bound

    @property
    def width(self) -> Real:
        """The length of the interval, x₊ − x₋."""
        low, high = self.low, self.high
        return jnp.where(high.x < 0.5, high.x - low.x, low.rest - high.rest)

    def limit(self, rises: Bool[Array, ""]) -> Bound:
        """Return the end to which a motion leads if x grows, or falls."""
        return jax.tree.map(lambda low, high: jnp.where(rises, high, low), self.low, self.high)

    def parameter(self, z: Real) -> Real:
        """Compute the parameter y at z = logit x."""
        x, rest = from_logit(z)
        above = jnp.where(x < 0.5, x - self.low.x, self.low.rest - rest)
        below = jnp.where(x < 0.5, self.high.x - x, rest - self.high.rest)
        return jnp.log(above) - jnp.log(below)

    def position(self, y: Real) -> tuple[Real, Real]:
        """Return the position x and 1 − x at y."""
        up, down = from_logit(y)
        return self.low.x + self.width * up, self.high.rest + self.width * down

    def pace(self, y: Real) -> tuple[Real, Real]:
        """Compute the pace ds/dy = (x₊ − x)(x − x₋)/((x₊ − x₋) x F), and r."""
        up, down = from_logit(y)
        x, rest = self.position(y)
        r, growth = self.side.rates(x, rest)
        near_low = self.low.is_zero & (y < 0) & (self.width * up < self.low.radius)
        near_high = self.high.is_zero & (y > 0) & (self.width * down < self.high.radius)
        # (x − x₋)/x is 1 where x₋ = 0.
        part = jnp.where(self.low.is_zero, self.width * up / x, 1.0)
        direct = part * down / jnp.where(near_low | near_high, 1.0, growth)
        by_low = down / (x * self.low.quotient(self.width * up))
        by_high = -up / (x * self.high.quotient(-self.width * down))
        return jnp.where(near_low, by_low, jnp.where(near_high, by_high, direct)), r


def interval_of(side: Side, z: Real, crossed: Bool[Array, ""]) -> tuple[Interval, Bool[Array, ""]]:
    """Compute the interval between neighbouring zeros of F that contains z = logit x.

    Also returns whether x grows there; it falls if the motion has just crossed the separatrix.
    """
    points, positive, rises = jax.lax.stop_gradient(side).sample(jax.lax.stop_gradient(z))
    rises &= ~crossed
    sign = jnp.where(rises, 1.0, -1.0)
    # In the direction of motion: the nearest points behind and ahead where F has the other sign.
    ahead, other = sign * (points - z), positive != rises
    nearest = jnp.min(jnp.where(other & (ahead > 0), ahead, jnp.inf))
    behind = jnp.max(jnp.where(other & (ahead < 0), ahead, -jnp.inf))
    reversals = jnp.stack([behind, nearest])
    found = jnp.isfinite(reversals)
    # The last points before them, or z.
    after = jnp.min(jnp.where(~other & (ahead > behind), ahead, 0.0))
    before = jnp.max(jnp.where(~other & (ahead < nearest), ahead, 0.0))
    low = jnp.where(found, jnp.stack([behind, before]), 0.0)
    high = jnp.where(found, jnp.stack([after, nearest]), 0.0)
    turned = jnp.stack([sign, -sign])

    def excess(at: Float[Array, "2"]) -> Float[Array, "2"]:
        return turned * jax.vmap(side.growth)(z + sign * at)

    zeros = z + sign * root(excess, low, high, HALVINGS)
    ends = jnp.sort(jnp.where(found, zeros, -turned * jnp.inf))
    both = jax.vmap(lambda z: bound(side, z))(ends)
    return Interval(side, *(Bound(*(leaf[k] for leaf in both)) for k in range(2))), rises


def bound(side: Side, z: Real) -> Bound:
    """Return the end of an interval at z = logit x: a zero of F, axis (−∞) or separatrix (∞)."""
    x, rest = from_logit(z)
    rest = jnp.maximum(rest, SMALLEST)
    is_zero = jnp.isfinite(z)
    radius = RADIUS * jnp.where(is_zero, jnp.minimum(x, rest), 1.0)
    rule = collocation_rule(NODES)
    shifts = radius * (2 * rule.nodes - 1)
    near = jnp.where(is_zero, x + shifts, 0.5), jnp.where(is_zero, rest - shifts, 0.5)
    each = jax.vmap(lambda *at: averages(side.moments, *at))
    rates, growths = each(jnp.append(near[0], x), jnp.append(near[1], rest))
    coefficients = jnp.asarray(rule.coefficients) @ (growths[:-1] @ side.weights / shifts)
    return Bound(x, rest, side.weights @ rates[-1], rates[-1], is_zero, radius, coefficients)


def from_logit(z: Real) -> tuple[Real, Real]:
    """Compute x of z = ln x/(1 − x), and 1 − x."""
    return jax.nn.sigmoid(z), jax.nn.sigmoid(-z)
