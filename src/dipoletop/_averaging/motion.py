"""The slow motion in time: energy, angular momentum and h of a body that radiates weakly.

A motion has one stage or two, before and after it crosses the separatrix. On each, s and ln L² are
integrals over the parameter y of `slow_flow`. Time follows from dt = ds/(2κL²): the unknown
u = 2κL²t obeys du/ds = 1 − ru and is bounded, so neither t nor L² can over- or underflow.

An adaptive Runge–Kutta method chooses the knots in y and integrates from one to the next. Between
two knots the integrands are polynomials through Chebyshev nodes (collocation).

At the last y the motion has come to a zero x* of F or to an axis, and L² obeys dL²/dt = −2κr*L⁴
exactly: L² = L²ₑ/(1 + 2κr*L²ₑ(t − tₑ)), which is constant where r* = 0. A body with two equal
moments that comes to its equator continues to approach it as a power of L².
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.bisection import root
from .._base.chebyshev import chebyshev_sum, collocation_rule
from .._base.guards import safe_divisor
from .._base.integration import integrated
from .._base.types import Real
from .slow_flow import FARTHEST, SMALLEST, Bound, Interval, Side, interval_of

RTOL = 1e-13  # of the quadratures
MAX_STEPS = 1200
FIRST_STEP = 0.01  # of y
NODES = 16  # of collocation between two knots
HALVINGS = 60
LATEST = 750.0  # ln t, larger than of any floating-point number


class State(NamedTuple):
    """The integrals along y."""

    s: Real
    """∫2κL²dt."""
    log: Real
    """ln L²/L₀²."""
    u: Real
    """2κL²t."""

    @property
    def log_time(self) -> Real:
        """The logarithm of t, in units of 1/(2κL₀²)."""
        return jnp.log(self.u) - self.log


class Piece(NamedTuple):
    """The motion between two knots, by Chebyshev coefficients."""

    y: Float[Array, "n"]
    state: State

    def at(self, part: Real) -> tuple[Real, State]:
        """Return y and the state at a fraction of the way, 0 ≤ part ≤ 1."""
        y, *state = (chebyshev_sum(x, 2 * part - 1) for x in (self.y, *self.state))
        return y, State(*state)


class Stage(eqx.Module):
    """The motion on one side of the separatrix."""

    interval: Interval
    knots: Float[Array, "K"]
    """Values of y, filled up with ∞."""
    states: State
    """The states at the knots, which are on the trailing axis."""
    last: Int[Array, ""]
    """The index of the last knot."""
    failed: Bool[Array, ""]

    @property
    def limit(self) -> Bound:
        """The end of the interval to which the motion leads."""
        rises = self.knots[self.last] > 0
        ends = self.interval.low, self.interval.high
        return jax.tree.map(lambda low, high: jnp.where(rises, high, low), *ends)

    @property
    def reaches_separatrix(self) -> Bool[Array, ""]:
        """Whether it leads to the separatrix."""
        return (self.knots[self.last] > 0) & ~self.interval.high.is_zero

    @property
    def end(self) -> State:
        """The state at the last knot."""
        return self.knot(self.last)

    def knot(self, index: Int[Array, ""]) -> State:
        """Return the state at a knot."""
        return State(*(values[index] for values in self.states))

    def piece(self, index: Int[Array, ""]) -> Piece:
        """Return the motion after the knot of this index."""
        index = jnp.clip(index, 0, jnp.maximum(self.last - 1, 0))
        first, start = self.knots[index], self.knot(index)
        length = jnp.where(self.last > 0, self.knots[index + 1] - first, 0.0)
        rule = collocation_rule(NODES)
        integrate = length * rule.integrals
        y = first + length * rule.nodes
        pace, r = jax.vmap(self.interval.pace)(y)
        change = -integrate @ (r * pace)
        u = (start.u + integrate @ (pace * jnp.exp(-change))) * jnp.exp(change)
        values = y, start.s + integrate @ pace, start.log + change, u
        y, *state = (jnp.asarray(rule.coefficients) @ x for x in values)
        return Piece(y, State(*state))


class FromFirstStep(diffrax.PIDController):
    """The usual controller, which begins with `FIRST_STEP`.

    A first step among the arguments of `diffeqsolve` is checked by a callback to Python, and JAX
    does not keep a program with a callback in its cache on disk.
    """

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order: Any):
        """Return the first step and the initial state of the controller (diffrax's interface)."""
        return super().init(terms, t0, t1, y0, FIRST_STEP, args, func, error_order)


def stage_from(side: Side, z: Real, initial: State, moves: Bool[Array, ""]) -> Stage:
    """Compute the motion from z = logit x to the end of its interval; its start if it rests."""
    interval = interval_of(side, z)
    start = interval.parameter(z)
    pace, _ = interval.pace(start)
    end = jnp.where(pace > 0, jnp.maximum(start, FARTHEST), jnp.minimum(start, -FARTHEST))

    def field(y: Any, state: Array, args: Any) -> Array:
        pace, r = interval.pace(y)
        _, log, u = state
        # Where x comes to its end far more slowly than L² falls, u = 1/r makes the system stiff.
        counts = log > jnp.log(jnp.maximum(u, SMALLEST)) - LATEST
        return pace * jnp.stack([jnp.ones_like(r), -r, jnp.where(counts, 1 - r * u, 0.0)])

    solution = integrated(
        field,
        (start, jnp.where(moves, end, start)),
        jnp.stack(initial),
        FromFirstStep(RTOL, RTOL),
        MAX_STEPS,
        saveat=diffrax.SaveAt(t0=True, steps=True),
    )
    last = solution.stats["num_accepted_steps"]
    failed = ~diffrax.is_successful(solution.result)
    return Stage(interval, solution.ts, State(*solution.ys.T), last, failed)


class Point(NamedTuple):
    """The slow motion at a time."""

    high: Bool[Array, "*times"]
    """Whether L moves round the axis of the smallest moment, rather than of the largest."""
    x: Real
    rest: Real
    """1 − x."""
    log: Real
    """ln L²/L₀²."""


class SlowMotion(eqx.Module):
    """A slow motion from t = 0 on; times are in the unit 1/(2κL₀²)."""

    starts_high: Bool[Array, ""]
    stages: Stage
    """Two, on the leading axis; the second is empty unless the motion crosses."""
    crosses: Bool[Array, ""]
    """Whether it crosses the separatrix."""

    @property
    def final(self) -> Stage:
        """The stage in which it ends."""
        return self.stage(self.crosses.astype(int))

    @property
    def ends_high(self) -> Bool[Array, ""]:
        """Whether it ends on the side of the axis of the smallest moment."""
        return self.starts_high ^ self.crosses

    @property
    def failed(self) -> Bool[Array, ""]:
        """Whether a quadrature ran out of steps."""
        return jnp.any(self.stages.failed)

    def stage(self, index: Any) -> Stage:
        """Return the first or the second stage."""
        return jax.tree.map(lambda leaf: leaf[index], self.stages)

    def at(self, log_time: Real) -> Point:
        """Compute the motion at t = exp(log_time)."""
        second = self.crosses & (log_time > self.stage(0).end.log_time)
        stage = self.stage(second.astype(int))
        reached = jnp.where(jnp.isfinite(stage.knots), stage.states.log_time, jnp.inf)
        piece = stage.piece(jnp.searchsorted(reached, log_time) - 1)
        zero = jnp.zeros_like(log_time)
        part = root(lambda part: piece.at(part)[1].log_time - log_time, zero, zero + 1, HALVINGS)
        y, state = piece.at(part)
        x, rest = stage.interval.position(y)
        limit = stage.limit
        r, _ = stage.interval.side.rates(limit.x, limit.rest)
        # After the last knot 2κL²ₑ(t − tₑ) = uₑ(t/tₑ − 1), and dy = −d ln L²/(r ds/dy).
        later = state.u * jnp.expm1(jnp.maximum(log_time - state.log_time, 0.0))
        fall = -jnp.log1p(r * later)
        pace, _ = stage.interval.pace(y)
        farther = fall / safe_divisor(r * pace)
        rest = jnp.where(stage.reaches_separatrix, rest * jnp.exp(farther), rest)
        return Point(self.starts_high ^ second, x, rest, state.log + fall)


def motion_from(side: Side, starts_high: Bool[Array, ""], z: Real) -> SlowMotion:
    """Compute the motion from z = logit x on a side.

    A body with two equal moments has no other side: its separatrix is the equator, where L is
    across the symmetry axis, and a motion that leads there ends there.
    """
    has_other_side = side.moments[1] != side.moments[0]

    def next_stage(carry: Any, _: Any) -> Any:
        side, z, state, moves = carry
        stage = stage_from(side, z, state, moves)
        arrives = moves & stage.reaches_separatrix & has_other_side
        return (side.other, jnp.full_like(z, FARTHEST), stage.end, arrives), (stage, arrives)

    zero = jnp.zeros_like(z)
    carry = side, z, State(zero, zero, zero), jnp.asarray(True)
    _, (stages, arrives) = jax.lax.scan(next_stage, carry, jnp.arange(2))
    return SlowMotion(starts_high, stages, arrives[0])
