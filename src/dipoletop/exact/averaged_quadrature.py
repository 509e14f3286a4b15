"""The averaged transverse top, solved by quadrature: what `exact.averaged` rests on.

With u = ω⊥², v = ω₃², ξ = u/v, a = 1 + 2δ, b = 1 + δ³ the averaged equations (4.13)–(4.14) give

    ξ′ = ξv(aξ + b)/(1−δ),    d ln v/d ln ξ = −[(2+δ)ξ + 2]/(aξ + b),

so ξ runs one way, to ∞ or, if a < 0, to ξ* = −b/a, and v is a closed function of it, (4.16). The
way is measured by an x ≥ 0 without end, logarithmic at both ends, so that time is a smooth
integral over x, and x at a given time the root of an increasing function.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

PANELS = 400
POINTS, WEIGHTS = (x / 2 for x in np.polynomial.legendre.leggauss(16))
HALVINGS = 45  # of a panel, in search of a time
FAR = 30.0  # eˣ ≫ 1
SLOWEST = 0.5  # (u + v)′ ≤ −SLOWEST (u + v)², whatever δ

One = Float[Array, ""]
Many = Float[Array, "*n"]


class Point(NamedTuple):
    """A point of the way; logarithms, because u, v and ξ may leave the range of numbers."""

    log_u: Many
    """ln u/u₀."""
    log_v: Many
    """ln v/v₀."""
    pace: Many
    """dτ/dx."""


class Orbit(NamedTuple):
    """One solution, by its shape and start, u₀ > 0, v₀ > 0."""

    delta: One
    u: One
    v: One

    @property
    def a(self) -> One:
        """1 + 2δ."""
        return 1 + 2 * self.delta

    @property
    def b(self) -> One:
        """1 + δ³; 0 for a disc."""
        return 1 + self.delta**3

    @property
    def edge(self) -> One:
        """aξ₀ + b, whose sign says which way ξ runs."""
        return self.a * self.u / self.v + self.b

    def at(self, x: Many) -> Point:
        """The point at x ≥ 0."""
        falls, stays = self.edge < 0, self.edge == 0
        which = jnp.where(falls, 0, jnp.where(stays, 1, jnp.where(self.a < 0, 2, 3)))
        return jax.lax.switch(which, (_falling, _fixed, _rising, _open), self, x)

    def way(self, xi: One) -> One:
        """X where u/v = ξ; negative or not a number where the motion does not come by."""
        along, ratio = jnp.log(xi * self.v / self.u), jnp.log((self.a * xi + self.b) / self.edge)
        return jnp.where(self.edge < 0, -ratio, jnp.where(self.a < 0, along - ratio, along))

    def farthest(self, time: One) -> One:
        """An x that is not reached before `time`: dx/dτ ≤ 3(u + v)/(1−δ), and u + v falls."""
        growth = jnp.log1p(SLOWEST * (self.u + self.v) * time)
        return 3 / (1 - self.delta) / SLOWEST * growth


def _falling(orbit: Orbit, x: Many) -> Point:
    """ξ > ξ*: ξ − ξ* falls like e⁻ˣ. (4.16) in a form that holds for b → 0, too."""
    d, a, b, start = orbit.delta, orbit.a, orbit.b, orbit.u / orbit.v
    log_xi = jnp.log1p(orbit.edge / (a * start) * jnp.expm1(-x))
    lag = -jnp.expm1(-x) / (a * start * jnp.exp(log_xi))
    near = b * lag > -0.5
    safe = jnp.where(near, lag, 0.0)
    edge = jnp.where(near, _log1p_over(b, safe), -(x + log_xi) / jnp.where(b > 0, b, 1.0))
    log_v = (d * (1 - d) * (3 + 3 * d + d**2) * edge - (2 + d) * log_xi) / a
    log_u, u, _ = _values(orbit, log_xi, log_v)
    return Point(log_u, log_v, -(1 - d) / (a * u))


def _fixed(orbit: Orbit, x: Many) -> Point:
    """ξ = ξ*: v falls like e⁻ˣ."""
    rate = ((2 + orbit.delta) * orbit.u + 2 * orbit.v) / (1 - orbit.delta)
    return Point(-x, -x, jnp.exp(x) / rate)


def _rising(orbit: Orbit, x: Many) -> Point:
    """ξ < ξ*: ξ/(ξ* − ξ) grows like eˣ."""
    a, b = orbit.a, orbit.b
    edge = _log1p_over(-a, orbit.u / orbit.v * jnp.expm1(x) / b)
    log_xi = x + a * edge
    log_v = _power(orbit, log_xi, edge)
    log_u, _, v = _values(orbit, log_xi, log_v)
    return Point(log_u, log_v, (1 - orbit.delta) / (b * v))


def _open(orbit: Orbit, x: Many) -> Point:
    """A ≥ 0: ξ = ξ₀eˣ grows without end."""
    a, b, edge = orbit.a, orbit.b, orbit.edge
    near = _log1p_over(a, orbit.u / orbit.v * jnp.expm1(jnp.minimum(x, FAR)) / edge)
    far = (x + jnp.log1p(b * jnp.expm1(-x) / edge)) / jnp.where(a > 0, a, 1.0)
    log_v = _power(orbit, x, jnp.where(x > FAR, far, near))
    log_u, u, v = _values(orbit, x, log_v)
    return Point(log_u, log_v, (1 - orbit.delta) / (a * u + b * v))


def _power(orbit: Orbit, log_xi: Many, edge: Many) -> Many:
    """(4.16): ln v/v₀ = −q ln ξ/ξ₀ + ap·edge, edge = ln[(aξ + b)/(aξ₀ + b)]/a.

    q = 2/b and, correcting the paper, p = δ(1−δ)(3+3δ+δ²)/(ab).
    """
    d = orbit.delta
    return (d * (1 - d) * (3 + 3 * d + d**2) * edge - 2 * log_xi) / orbit.b


def _values(orbit: Orbit, log_xi: Many, log_v: Many) -> tuple[Many, Many, Many]:
    """Ln u/u₀, u, v."""
    log_u = log_xi + log_v
    return log_u, orbit.u * jnp.exp(log_u), orbit.v * jnp.exp(log_v)


def _log1p_over(c: One, z: Many) -> Many:
    """ln(1 + cz)/c; z at c = 0."""
    safe = jnp.where(c == 0, 1.0, c)
    return jnp.where(c == 0, z, jnp.log1p(safe * z) / safe)


def passed(orbit: Orbit, start: One, end: One) -> tuple[One, One]:
    """Between two x, not far from each other: the time ∫dτ, and ∫√v dτ, the angle over −δ."""
    width = end - start
    point = orbit.at(start + width * (POINTS + 0.5))
    turn = jnp.sqrt(orbit.v) * jnp.exp(point.log_v / 2)
    return width * jnp.sum(WEIGHTS * point.pace), width * jnp.sum(WEIGHTS * point.pace * turn)


def mesh(orbit: Orbit, farthest: One) -> tuple[Many, Many, Many]:
    """X from 0 to `farthest`, finer at the start, and the time and ∫√v dτ up to each."""
    xs = jnp.expm1(jnp.linspace(0.0, 1.0, PANELS + 1) * jnp.log1p(farthest))
    times, turns = jax.vmap(lambda x, y: passed(orbit, x, y))(xs[:-1], xs[1:])
    return xs, _sums(times), _sums(turns)


def _sums(parts: Float[Array, "n"]) -> Float[Array, "n+1"]:
    """Of the parts before each point of the mesh."""
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(parts)])


def solve(orbit: Orbit, times: Many) -> tuple[Point, Many]:
    """The points at `times` ≥ 0, shape (T,), and ∫√v dτ up to each; NaN at times that are none."""
    last = jnp.max(jnp.where(times >= 0, times, 0.0))
    xs, ends, _ = mesh(orbit, orbit.farthest(last))
    enough = xs[jnp.clip(jnp.searchsorted(ends, last) + 1, 0, PANELS)]
    xs, ends, turns = mesh(orbit, enough)  # the bound was too far, and so the mesh too wide

    def one(time: One) -> tuple[Point, One]:
        k = jnp.clip(jnp.searchsorted(ends, time, side="right") - 1, 0, PANELS - 1)

        def lack(x: One) -> One:
            return ends[k] + passed(orbit, xs[k], x)[0] - time

        def halved(_: Any, bracket: tuple[One, One]) -> tuple[One, One]:
            low, high = bracket
            middle = (low + high) / 2
            early = lack(middle) < 0
            return jnp.where(early, middle, low), jnp.where(early, high, middle)

        low, high = jax.lax.fori_loop(0, HALVINGS, halved, (xs[k], xs[k + 1]))
        # Newton's step makes up for the rest, and carries the derivatives.
        near = jax.lax.stop_gradient((low + high) / 2)
        x = near - lack(near) / orbit.at(near).pace
        return orbit.at(x), turns[k] + passed(orbit, xs[k], x)[1]

    return jax.vmap(one)(times)
