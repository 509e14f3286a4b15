"""The slow motion in time: energy, angular momentum and h of a body that radiates weakly.

A motion has one stage or two, before and after it crosses the separatrix. On each, ln L² is an
integral over the parameter y of `slow_flow`. Time follows from dt = ds/(2κL²): the unknown
u = 2κL²t obeys du/ds = 1 − ru and is bounded, so neither t nor L² can over- or underflow.

From one knot in y to the next, ln L² and u are polynomials through Chebyshev nodes (collocation).
The knots are so near to each other that the last coefficients are negligible, or of the size of
rounding.

At the last y the motion has come to a zero x* of F or to an axis, and L² obeys dL²/dt = −2κr*L⁴
exactly: L² = L²ₑ/(1 + 2κr*L²ₑ(t − tₑ)), which is constant where r* = 0. A body with two equal
moments that comes to its equator continues to approach it as a power of L².
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.bisection import root
from .._base.chebyshev import chebyshev_sum, collocation_rule
from .._base.dense import solve_dense
from .._base.guards import safe_divisor
from .._base.types import Real
from .slow_flow import FARTHEST, Bound, Interval, Side, interval_of

RTOL = 1e-13  # relative error of a panel
ROUNDED = 1e-4  # error below which it may be that of rounding
MOST_PANELS = 400
FIRST_LENGTH = 0.5  # of a panel, in y
SHORTEST = 1e-10
LOWEST = -1500.0  # ln L²/L₀² at which t exceeds any floating-point number by far
NODES = 16  # of collocation between two knots
HALVINGS = 60
REACH = 15.0
"""|y| from which r − r* counts as exp(−|y|): exp(−15) and the errors of the quadrature, which grow
as 1/L², then matter alike."""


class State(NamedTuple):
    """The integrals along y."""

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
    rises: Bool[Array, ""]
    """Whether y grows."""
    knots: Float[Array, "K"]
    """Values of y, filled up with ∞."""
    states: State
    """The states at the knots, which are on the trailing axis."""
    last: Int[Array, ""]
    """The index of the last knot."""
    failed: Bool[Array, ""]
    """Whether there are too many knots, or a rate is not a number."""
    error: Real
    """The estimated error of ln L², relative to its change if that is large."""

    @property
    def limit(self) -> Bound:
        """The end of the interval to which the motion leads."""
        return self.interval.limit(self.rises)

    @property
    def reaches_separatrix(self) -> Bool[Array, ""]:
        """Whether it leads to the separatrix."""
        return self.rises & ~self.interval.high.is_zero

    @property
    def end(self) -> State:
        """The state at the last knot."""
        return self.knot(self.last)

    @property
    def energies(self) -> Float[Array, "K"]:
        """The energies at the knots; 0 after the last one."""
        known = jnp.arange(self.knots.size) <= self.last
        return jnp.where(known, jax.vmap(self.energy)(self.knots, self.states), 0.0)

    def energy(self, y: Real, state: State) -> Real:
        """Return the energy in a state, in units of L₀²/J₃."""
        shape = self.interval.side.shape(*self.interval.position(y))
        return shape * jnp.exp(state.log) / 2

    def knot(self, index: Int[Array, ""]) -> State:
        """Return the state at a knot."""
        return State(*(values[index] for values in self.states))

    @property
    def settled(self) -> Int[Array, ""]:
        """The index of the first knot with |y| ≥ `REACH`, or of the last one."""
        reaches = jnp.where(self.rises, self.knots >= REACH, self.knots <= -REACH)
        return jnp.where(jnp.any(reaches), jnp.argmax(reaches), self.last)

    def piece(self, index: Int[Array, ""]) -> Piece:
        """Return the motion after the knot of this index."""
        index = jnp.clip(index.astype(self.last.dtype), 0, jnp.maximum(self.last - 1, 0))
        first, start = self.knots[index], self.knot(index)
        length = jnp.where(self.last > 0, self.knots[index + 1] - first, 0.0)
        y, states, _ = panel(self.interval, first, length, start)
        y, *state = (jnp.asarray(collocation_rule(NODES).coefficients) @ x for x in (y, *states))
        return Piece(y, State(*state))


class _Progress(NamedTuple):
    """The stage so far, and the next panel to try."""

    knots: Float[Array, "K"]
    states: State
    last: Int[Array, ""]
    length: Real
    """The length of the next panel."""
    before: Real
    """The error of the panel that was refused before it, else ∞."""
    rounding: Real
    """The error of the panel before it, if that came from rounding, else 0."""
    error: Real
    """The sum of the errors of all panels."""


def stage_from(side: Side, z: Real, initial: State, moves: Bool[Array, ""]) -> Stage:
    """Compute the motion from z = logit x to the end of its interval; its start if it rests."""
    interval = interval_of(side, z)
    start = interval.parameter(z)
    pace, _ = interval.pace(start)
    rises = pace > 0
    sign = jnp.where(rises, 1.0, -1.0)
    # A knot lies at `REACH`.
    reach, end = (sign * jnp.maximum(sign * start, at) for at in (REACH, FARTHEST))
    reach, end = (jnp.where(moves, at, start) for at in (reach, end))
    # On the way to a stop there is no need to go on when t exceeds any number.
    stops_there = interval.limit(rises).is_zero | ~rises | (side.moments[0] == side.moments[1])

    def ended(now: _Progress) -> Bool[Array, ""]:
        return (now.knots[now.last] == end) | (stops_there & (now.states.log[now.last] < LOWEST))

    def unfinished(now: _Progress) -> Bool[Array, ""]:
        known = now.length > 0  # not NaN
        return ~ended(now) & (now.last < MOST_PANELS) & known

    def advance(now: _Progress) -> _Progress:
        first = now.knots[now.last]
        goal = jnp.where(sign * first < sign * reach, reach, end)
        ends_here = jnp.abs(goal - first) <= now.length
        length = jnp.where(ends_here, goal - first, sign * now.length)
        here = State(*(values[now.last] for values in now.states))
        _, states, error = panel(interval, first, length, here)
        # Rounding leaves an error that does not fall with the length.
        only_rounding = (error > now.before / 4) | (error < 4 * now.rounding)
        only_rounding &= (error > RTOL) & (error < ROUNDED)
        accepted = (error <= RTOL) | only_rounding | (now.length < SHORTEST)
        factor = 0.9 * (RTOL / jnp.maximum(error, 1e-30)) ** (1 / NODES)
        factor = jnp.clip(factor, jnp.where(accepted, 1.1, 0.3), jnp.where(accepted, 2.0, 0.7))
        factor = jnp.where(only_rounding, 2.0, factor)
        place = jnp.where(accepted, now.last + 1, MOST_PANELS + 1)  # outside: nothing is set
        knot = jnp.where(ends_here, goal, first + length)
        following = jnp.abs(jax.lax.stop_gradient(length * factor))
        return _Progress(
            now.knots.at[place].set(knot, mode="drop"),
            State(
                *(
                    a.at[place].set(b[-1], mode="drop")
                    for a, b in zip(now.states, states, strict=True)
                )
            ),
            now.last + accepted.astype(now.last.dtype),
            jnp.where(accepted, jnp.maximum(following, now.length), following),
            jnp.where(accepted, jnp.inf, error),
            jnp.where(only_rounding, error, jnp.where(accepted, 0.0, now.rounding)),
            now.error + jnp.where(accepted, error, 0.0),
        )

    zero, infinite = jnp.zeros_like(start), jnp.full_like(start, jnp.inf)
    knots = jnp.full(MOST_PANELS + 1, jnp.inf, start.dtype).at[0].set(start)
    states = State(*(jnp.full_like(knots, jnp.inf).at[0].set(value) for value in initial))
    count = jnp.zeros((), int)
    begun = _Progress(knots, states, count, zero + FIRST_LENGTH, infinite, zero, zero)
    done = jax.lax.while_loop(unfinished, advance, begun)
    return Stage(interval, rises, done.knots, done.states, done.last, ~ended(done), done.error)


def panel(
    interval: Interval, first: Real, length: Real, start: State
) -> tuple[Float[Array, "n"], State, Real]:
    """Return y and the states at Chebyshev nodes behind a knot, and their relative error.

    The error is that of polynomials, by their last two coefficients.
    """
    rule = collocation_rule(NODES)
    y = first + length * rule.nodes
    pace, r = jax.vmap(interval.pace)(y)
    integrals, coefficients = jnp.asarray(rule.integrals), jnp.asarray(rule.coefficients)
    pace = length * pace
    fall = r * pace
    log = start.log - integrals @ fall
    # u = u₀ + ∫(1 − ru)ds, for (1 + |r ds|)u: ds may be large.
    scale = 1 / (1 + jnp.abs(fall))
    matrix = jnp.diag(scale) + integrals * (fall * scale)[None]
    sides = start.u + integrals @ pace
    u = scale * solve_dense(matrix, sides[:, None])[:, 0]

    def tail(values: Float[Array, "n"]) -> Real:
        return jnp.sum(jnp.abs(coefficients[-2:] @ values))

    size = jnp.maximum(1.0, jnp.max(jnp.abs(log - start.log)))
    error = jnp.maximum(tail(fall) / size, tail(u) / jnp.max(jnp.abs(u)))
    return y, State(log, u), jax.lax.stop_gradient(error)


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
        """Whether a quadrature has too many panels."""
        return jnp.any(self.stages.failed)

    @property
    def error(self) -> Real:
        """The estimated error of ln L²."""
        first, second = self.stages.error
        return first + jnp.where(self.crosses, second, 0.0)

    @property
    def energy(self) -> Real:
        """The first energy, in units of L₀²/J₃."""
        return self.stage(0).energies[0]

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

        def late(part: Real) -> Real:  # by u = L²t, which is near 0 at first, and has rounding
            state = piece.at(part)[1]
            return state.u - jnp.exp(state.log + log_time)

        part = root(late, zero, zero + 1, HALVINGS)
        y, state = piece.at(part)
        x, rest = stage.interval.position(y)
        limit = stage.limit
        # After the last knot 2κL²ₑ(t − tₑ) = uₑ(t/tₑ − 1), and dy = −d ln L²/(r ds/dy).
        end = stage.end.log_time
        later = jnp.where(
            log_time > end, state.u * jnp.expm1(jnp.maximum(log_time - end, 0.0)), 0.0
        )
        fall = -jnp.log1p(limit.r * later)
        pace, _ = stage.interval.pace(y)
        farther = fall / safe_divisor(limit.r * pace)
        rest = jnp.where(stage.reaches_separatrix, rest * jnp.exp(farther), rest)
        return Point(self.starts_high ^ second, x, rest, state.log + fall)

    def time_at(self, energy: Real) -> Real:
        """Return the time at which the energy has fallen to a value."""
        first = self.stage(0)
        second = self.crosses & (first.energies[first.last] > energy)
        stage = self.stage(second.astype(int))
        above = jnp.sum(stage.energies > energy)
        piece = stage.piece(above - 1)

        def lost(part: Real) -> Real:
            return energy - stage.energy(*piece.at(part))

        part = root(lost, jnp.zeros_like(energy), jnp.ones_like(energy), HALVINGS)
        y, state = piece.at(part)
        # After the last knot E falls as L² does, by 1 + r(t − tₑ)L²ₑ.
        r = stage.limit.r
        excess = jnp.maximum(stage.energy(y, state) / energy - 1, 0.0)
        late = above > stage.last
        later = jnp.where(late, excess / jnp.where(r > 0, r, 1.0), 0.0)
        return jnp.exp(-state.log) * (state.u + later)


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
    carry = side, z, State(zero, zero), jnp.asarray(True)
    _, (stages, arrives) = jax.lax.scan(next_stage, carry, jnp.arange(2))
    return SlowMotion(starts_high, stages, arrives[0])
