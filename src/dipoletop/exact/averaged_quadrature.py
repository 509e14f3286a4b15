"""The averaged transverse top by quadrature, for `exact.averaged` and `exact.averaged_time`.

With u = ω⊥², v = ω₃², ξ = u/v, a = 1 + 2δ, b = 1 + δ³ the averaged equations (4.13)–(4.14) give

    ξ′ = ξv(aξ + b)/(1−δ),    d ln v/d ln ξ = −[(2+δ)ξ + 2]/(aξ + b).

So ξ is monotonic in time: it tends to ∞ or, if a < 0, to ξ* = −b/a, and v is a closed function of
ξ, (4.16):

    ln v/v₀ = −q ln ξ/ξ₀ + p ln[(aξ + b)/(aξ₀ + b)],   q = 2/b,   p = δ(1−δ)(3+3δ+δ²)/(ab),

with p corrected (the paper's (4.19) is in error). The orbit is parametrised by x ∈ [0, ∞),
logarithmic in both limits: ξ = ξ₀eˣ if a ≥ 0; otherwise ξ/(ξ* − ξ) grows like eˣ below ξ*, and
ξ − ξ* falls like e⁻ˣ above. Time is then a smooth integral over x, by Gauss' rule on each panel of
a mesh, and the x of a given time is found by bisection in its panel and a step of Newton's method.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_divisor
from .._base.linalg import running_sums
from .._base.roots import bisect

PANELS = 400
POINTS, WEIGHTS = (x / 2 for x in np.polynomial.legendre.leggauss(16))
HALVINGS = 45  # halvings of a panel in search of a time
FAR = 30.0  # x from which eˣ ≫ 1
SLOWEST = 0.5  # (u + v)′ ≤ −SLOWEST (u + v)² for every δ

Scalar = Float[Array, ""]
Scalars = Float[Array, "*n"]


class Point(NamedTuple):
    """A point of the orbit; logarithms, because u, v and ξ may overflow or underflow."""

    log_u: Scalars
    """ln u/u₀."""
    log_v: Scalars
    """ln v/v₀."""
    dtau_dx: Scalars


class AveragedOrbit(NamedTuple):
    """A solution, given by its δ and its initial values u₀ > 0, v₀ > 0."""

    delta: Scalar
    u: Scalar
    v: Scalar
    prolate: bool = False
    """Whether it is known beforehand that 0 < δ < 1, so that only one form need be compiled."""

    @property
    def a(self) -> Scalar:
        """1 + 2δ."""
        return 1 + 2 * self.delta

    @property
    def b(self) -> Scalar:
        """1 + δ³; 0 for a disc."""
        return 1 + self.delta**3

    @property
    def direction(self) -> Scalar:
        """aξ₀ + b, which has the sign of ξ′."""
        return self.a * self.u / self.v + self.b

    def point(self, x: Scalars) -> Point:
        """Return the point at the parameter x ≥ 0."""
        if self.prolate:
            return _unbounded(self, x)
        falls, constant = self.direction < 0, self.direction == 0
        which = jnp.where(falls, 0, jnp.where(constant, 1, jnp.where(self.a < 0, 2, 3)))
        return jax.lax.switch(which, (_falling, _constant, _rising, _unbounded), self, x)

    def parameter(self, xi: Scalar) -> Scalar:
        """Return x at which u/v = ξ; negative or NaN if the orbit does not reach ξ."""
        along = jnp.log(xi * self.v / self.u)
        ratio = jnp.log((self.a * xi + self.b) / self.direction)
        return jnp.where(self.direction < 0, -ratio, jnp.where(self.a < 0, along - ratio, along))

    def upper_bound(self, time: Scalar) -> Scalar:
        """Bound x at `time` from above: dx/dτ ≤ 3(u + v)/(1−δ), and SLOWEST bounds u + v."""
        growth = jnp.log1p(SLOWEST * (self.u + self.v) * time)
        return 3 / (1 - self.delta) / SLOWEST * growth


def _falling(orbit: AveragedOrbit, x: Scalars) -> Point:
    """Return the point for ξ > ξ*, with ξ − ξ* ~ e⁻ˣ, by a form of (4.16) that allows b → 0."""
    d, a, b, xi0 = orbit.delta, orbit.a, orbit.b, orbit.u / orbit.v
    log_xi = jnp.log1p(orbit.direction / (a * xi0) * jnp.expm1(-x))
    lag = -jnp.expm1(-x) / (a * xi0 * jnp.exp(log_xi))
    near = b * lag > -0.5
    near_lag = jnp.where(near, lag, 0.0)
    log_ratio = jnp.where(near, _log1p_over(b, near_lag), -(x + log_xi) / jnp.where(b > 0, b, 1.0))
    log_v = (d * (1 - d) * (3 + 3 * d + d**2) * log_ratio - (2 + d) * log_xi) / a
    log_u, u, _ = _u_and_v(orbit, log_xi, log_v)
    return Point(log_u, log_v, -(1 - d) / (a * u))


def _constant(orbit: AveragedOrbit, x: Scalars) -> Point:
    """Return the point for ξ = ξ*, with v ~ e⁻ˣ."""
    rate = ((2 + orbit.delta) * orbit.u + 2 * orbit.v) / (1 - orbit.delta)
    return Point(-x, -x, jnp.exp(x) / rate)


def _rising(orbit: AveragedOrbit, x: Scalars) -> Point:
    """Return the point for ξ < ξ*, with ξ/(ξ* − ξ) ~ eˣ."""
    a, b = orbit.a, orbit.b
    log_ratio = _log1p_over(-a, orbit.u / orbit.v * jnp.expm1(x) / b)
    log_xi = x + a * log_ratio
    log_v = _log_v(orbit, log_xi, log_ratio)
    log_u, _, v = _u_and_v(orbit, log_xi, log_v)
    return Point(log_u, log_v, (1 - orbit.delta) / (b * v))


def _unbounded(orbit: AveragedOrbit, x: Scalars) -> Point:
    """Return the point for a ≥ 0, with ξ = ξ₀eˣ."""
    a, b, direction = orbit.a, orbit.b, orbit.direction
    near = _log1p_over(a, orbit.u / orbit.v * jnp.expm1(jnp.minimum(x, FAR)) / direction)
    far = (x + jnp.log1p(b * jnp.expm1(-x) / direction)) / jnp.where(a > 0, a, 1.0)
    log_v = _log_v(orbit, x, jnp.where(x > FAR, far, near))
    log_u, u, v = _u_and_v(orbit, x, log_v)
    return Point(log_u, log_v, (1 - orbit.delta) / (a * u + b * v))


def _log_v(orbit: AveragedOrbit, log_xi: Scalars, log_ratio: Scalars) -> Scalars:
    """Compute (4.16) from ln ξ/ξ₀ and `log_ratio` = ln[(aξ + b)/(aξ₀ + b)]/a, finite for a → 0."""
    d = orbit.delta
    return (d * (1 - d) * (3 + 3 * d + d**2) * log_ratio - 2 * log_xi) / orbit.b


def _u_and_v(
    orbit: AveragedOrbit, log_xi: Scalars, log_v: Scalars
) -> tuple[Scalars, Scalars, Scalars]:
    """Return ln u/u₀, u and v."""
    log_u = log_xi + log_v
    return log_u, orbit.u * jnp.exp(log_u), orbit.v * jnp.exp(log_v)


def _log1p_over(c: Scalar, z: Scalars) -> Scalars:
    """Compute ln(1 + cz)/c, which is z at c = 0."""
    divisor = safe_divisor(c)
    return jnp.where(c == 0, z, jnp.log1p(divisor * z) / divisor)


def integrals(orbit: AveragedOrbit, low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
    """Compute ∫dτ and ∫√v dτ, the angle over −δ, between two parameters x of one panel."""
    width = high - low
    point = orbit.point(low + width * (POINTS + 0.5))
    w3 = jnp.sqrt(orbit.v) * jnp.exp(point.log_v / 2)
    return width * jnp.sum(WEIGHTS * point.dtau_dx), width * jnp.sum(WEIGHTS * point.dtau_dx * w3)


def mesh(orbit: AveragedOrbit, last: Scalar) -> tuple[Scalars, Scalars, Scalars]:
    """Return x from 0 to `last`, denser near 0, and τ and ∫√v dτ from 0 to each x."""
    xs = jnp.expm1(jnp.linspace(0.0, 1.0, PANELS + 1) * jnp.log1p(last))
    times, angles = jax.vmap(lambda x, y: integrals(orbit, x, y))(xs[:-1], xs[1:])
    return xs, running_sums(times), running_sums(angles)


def solve(orbit: AveragedOrbit, times: Scalars) -> tuple[Point, Scalars]:
    """Return the points at `times`, shape (T,), and ∫√v dτ up to each; NaN at negative times."""
    latest = jnp.max(jnp.where(times >= 0, times, 0.0))
    xs, ends, _ = mesh(orbit, orbit.upper_bound(latest))
    enough = xs[jnp.clip(jnp.searchsorted(ends, latest) + 1, 0, PANELS)]
    xs, ends, angles = mesh(orbit, enough)  # the first mesh is far too long, hence too coarse

    def at_time(time: Scalar) -> tuple[Point, Scalar]:
        k = jnp.clip(jnp.searchsorted(ends, time, side="right") - 1, 0, PANELS - 1)

        def excess(x: Scalar) -> Scalar:
            return ends[k] + integrals(orbit, xs[k], x)[0] - time

        def late(x: Scalar) -> Bool[Array, ""]:
            return excess(x) >= 0

        low, high = bisect(late, xs[k], xs[k + 1], HALVINGS)
        # A step of Newton's method gives the last digits and the derivatives.
        near = jax.lax.stop_gradient((low + high) / 2)
        x = near - excess(near) / orbit.point(near).dtau_dx
        return orbit.point(x), angles[k] + integrals(orbit, xs[k], x)[1]

    return jax.vmap(at_time)(times)
