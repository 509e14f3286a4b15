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

import dataclasses
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


class Panels(NamedTuple):
    """A motion at the Chebyshev nodes from one knot to the next; a row for each panel."""

    y: Float[Array, "*panels n"]
    log: Float[Array, "*panels n"]
    u: Float[Array, "*panels n"]
    pace: Float[Array, "*panels n"]
    """ds/dy."""
    r: Float[Array, "*panels n"]


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
    rises: Bool[Array, "*n"]
    """Whether y grows."""
    start: Real
    """The first y."""
    begin: State
    last: Real
    """The last y."""
    end: State
    loss: Real
    """The largest `Side.loss` at a knot but the first, for ln L² = 0 at the start of the motion."""
    failed: Bool[Array, "*n"]
    """Whether there are too many panels, or a rate is not a number."""
    error: Real
    """The estimated error of ln L², relative to its change if that is large."""
    count: Int[Array, "*n"]
    """The number of panels; 0 only if this is no part of the motion."""
    panels: Panels | None
    """Filled up with ∞; None if times are not wanted."""

    @property
    def limit(self) -> Bound:
        """The end of the interval to which the motion leads."""
        return self.interval.limit(self.rises)

    @property
    def reaches_separatrix(self) -> Any:
        """Whether it leads to the separatrix."""
        return self.rises & ~self.interval.high.is_zero

    @property
    def _panels(self) -> Panels:
        if self.panels is None:
            raise TypeError("this stage was computed without times")
        return self.panels

    @property
    def knots(self) -> Float[Array, "K"]:
        """The values of y between panels, and at both ends; filled up with ∞."""
        return jnp.append(self.start, self._panels.y[:, -1])

    @property
    def states(self) -> State:
        """The states at the knots."""
        panels = self._panels
        log, u = jnp.append(self.begin.log, panels.log[:, -1]), panels.u[:, -1]
        return State(log, jnp.append(self.begin.u, u))

    @property
    def energies(self) -> Float[Array, "K"]:
        """The energies at the knots; 0 after the last one."""
        knots = self.knots
        known = jnp.isfinite(knots)
        return jnp.where(known, jax.vmap(self.energy)(knots, self.states), 0.0)

    def energy(self, y: Real, state: State) -> Real:
        """Return the energy in a state, in units of L₀²/J₃."""
        shape = self.interval.side.shape(*self.interval.position(y))
        return shape * jnp.exp(state.log) / 2

    @property
    def settled(self) -> tuple[Real, State, Real, Real]:
        """Return y, the state, ds/dy and r at the first knot with |y| ≥ `REACH`, or the last one.

        It is not the start, if there is a later one.
        """
        panels, last = self._panels, jnp.maximum(self.count - 1, 0)
        reaches = jnp.where(self.rises, panels.y[:, -1] >= REACH, panels.y[:, -1] <= -REACH)
        reaches &= jnp.isfinite(panels.y[:, -1])
        index = jnp.where(jnp.any(reaches), jnp.argmax(reaches), last)
        y, log, u, pace, r = (values[index, -1] for values in panels)
        return y, State(log, u), pace, r

    def piece(self, index: Int[Array, ""]) -> Piece:
        """Return the motion after the knot of this index."""
        return _piece(self._panels, self.count, (index,))


def _piece(panels: Panels, count: Int[Array, ""], place: tuple[Int[Array, ""], ...]) -> Piece:
    """Return the panel of an index, the last of `place`, out of so many."""
    *outer, index = place
    index = jnp.clip(index.astype(count.dtype), 0, jnp.maximum(count - 1, 0))
    coefficients = jnp.asarray(collocation_rule(NODES).coefficients)
    y, *state = (coefficients @ x[(*outer, index)] for x in panels[:3])
    return Piece(y, State(*state))


class _Progress(NamedTuple):
    """The stage so far, and the next panel to try."""

    y: Real
    state: State
    loss: Real
    count: Int[Array, ""]
    length: Real
    """The length of the next panel."""
    before: Real
    """The error of the panel that was refused before it, else ∞."""
    rounding: Real
    """The error of the panel before it, if that came from rounding, else 0."""
    error: Real
    """The sum of the errors of all panels."""
    panels: Panels | None


def stage_from(
    side: Side,
    z: Real,
    initial: State,
    moves: Bool[Array, ""],
    crossed: Bool[Array, ""],
    timed: bool = True,
) -> Stage:
    """Compute the motion from z = logit x to the end of its interval.

    Args:
        side: the side on which the whole motion begins.
        z: where it begins.
        initial: the integrals at the start of this stage.
        moves: whether this is a part of the motion; else nothing is computed.
        crossed: whether this is the stage on the other side of the separatrix, from there.
        timed: whether times are wanted, else u = 0.
    """
    side = jax.tree.map(lambda a, b: jnp.where(crossed, a, b), side.other, side)
    z = jnp.where(crossed, FARTHEST, z)
    interval, rises = interval_of(side, z, crossed)
    start = interval.parameter(z)
    sign = jnp.where(rises, 1.0, -1.0)
    # A knot lies at `REACH`.
    reach, end = (sign * jnp.maximum(sign * start, at) for at in (REACH, FARTHEST))
    # On the way to a stop there is no need to go on when t exceeds any number.
    stops_there = interval.limit(rises).is_zero | ~rises | (side.moments[0] == side.moments[1])

    def ended(now: _Progress) -> Bool[Array, ""]:
        return (now.count > 0) & ((now.y == end) | (stops_there & (now.state.log < LOWEST)))

    def unfinished(now: _Progress) -> Bool[Array, ""]:
        known = now.length > 0  # not NaN
        return moves & ~ended(now) & (now.count < MOST_PANELS) & known

    def advance(now: _Progress) -> _Progress:
        goal = jnp.where(sign * now.y < sign * reach, reach, end)
        ends_here = jnp.abs(goal - now.y) <= now.length
        length = jnp.where(ends_here, goal - now.y, sign * now.length)
        row, error = panel(interval, now.y, length, now.state, timed)
        # Rounding leaves an error that does not fall with the length.
        only_rounding = (error > now.before / 4) | (error < 4 * now.rounding)
        only_rounding &= (error > RTOL) & (error < ROUNDED)
        accepted = (error <= RTOL) | only_rounding | (now.length < SHORTEST)
        factor = 0.9 * (RTOL / jnp.maximum(error, 1e-30)) ** (1 / NODES)
        factor = jnp.clip(factor, jnp.where(accepted, 1.1, 0.3), jnp.where(accepted, 2.0, 0.7))
        factor = jnp.where(only_rounding, 2.0, factor)
        knot = jnp.where(ends_here, goal, now.y + length)
        following = jnp.abs(jax.lax.stop_gradient(length * factor))
        lost = side.loss(*interval.position(knot), row.r[-1], row.log[-1])
        panels = now.panels
        if panels is not None:
            place = jnp.where(accepted, now.count, MOST_PANELS)  # outside: nothing is set
            rows = zip(panels, row, strict=True)
            panels = Panels(*(a.at[place].set(b, mode="drop") for a, b in rows))
        return _Progress(
            jnp.where(accepted, knot, now.y),
            jax.tree.map(lambda a, b: jnp.where(accepted, a[-1], b), State(*row[1:3]), now.state),
            jnp.where(accepted, jnp.maximum(now.loss, lost), now.loss),
            now.count + accepted.astype(now.count.dtype),
            jnp.where(accepted, jnp.maximum(following, now.length), following),
            jnp.where(accepted, jnp.inf, error),
            jnp.where(only_rounding, error, jnp.where(accepted, 0.0, now.rounding)),
            now.error + jnp.where(accepted, error, 0.0),
            panels,
        )

    zero, infinite = jnp.zeros_like(start), jnp.full_like(start, jnp.inf)
    panels = Panels(*[jnp.full((MOST_PANELS, NODES), jnp.inf, start.dtype)] * 5) if timed else None
    count = jnp.zeros((), int)
    first = start, initial, zero, count, zero + FIRST_LENGTH, infinite, zero, zero
    done = jax.lax.while_loop(unfinished, advance, _Progress(*first, panels))
    failed = moves & ~ended(done)
    found = done.y, done.state, done.loss, failed, done.error, done.count, done.panels
    return Stage(interval, rises, start, initial, *found)


def panel(
    interval: Interval, first: Real, length: Real, start: State, timed: bool
) -> tuple[Panels, Real]:
    """Return the motion at Chebyshev nodes behind a knot, and its relative error.

    The error is that of polynomials, by their last two coefficients.
    """
    rule = collocation_rule(NODES)
    y = first + length * rule.nodes
    pace, r = jax.vmap(interval.pace)(y)
    integrals, coefficients = jnp.asarray(rule.integrals), jnp.asarray(rule.coefficients)
    change = length * pace
    fall = r * change
    log = start.log - integrals @ fall

    def tail(values: Float[Array, "n"]) -> Real:
        return jnp.sum(jnp.abs(coefficients[-2:] @ values))

    error = tail(fall) / jnp.maximum(1.0, jnp.max(jnp.abs(log - start.log)))
    u = jnp.broadcast_to(start.u, y.shape)
    if timed:
        # u = u₀ + ∫(1 − ru)ds, for (1 + |r ds|)u: ds may be large.
        scale = 1 / (1 + jnp.abs(fall))
        matrix = jnp.diag(scale) + integrals * (fall * scale)[None]
        sides = start.u + integrals @ change
        u = scale * solve_dense(matrix, sides[:, None])[:, 0]
        error = jnp.maximum(error, tail(u) / safe_divisor(jnp.max(jnp.abs(u))))
    return Panels(y, log, u, pace, r), jax.lax.stop_gradient(error)


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
        return jnp.sum(self.stages.error)

    @property
    def loss(self) -> Real:
        """The largest `Side.loss` at a knot."""
        return jnp.max(self.stages.loss)

    @property
    def energy(self) -> Real:
        """The first energy, in units of L₀²/J₃."""
        first = self.stage(0)
        return first.energy(first.start, first.begin)

    def stage(self, index: Any) -> Stage:
        """Return the first or the second stage."""
        return jax.tree.map(lambda leaf: leaf[index], self.stages)

    def _piece(self, stage: Int[Array, ""], index: Int[Array, ""]) -> Piece:
        """Return a piece of a stage, without a copy of all of them for each of many times."""
        panels = self.stages._panels
        return _piece(panels, self.stages.count[stage], (stage, index))

    def at(self, log_time: Real) -> Point:
        """Compute the motion at t = exp(log_time)."""
        second = self.crosses & (log_time > self.stage(0).end.log_time)
        which = second.astype(int)
        knots = jax.vmap(lambda each: (jnp.isfinite(each.knots), each.states.log_time))
        reached = jnp.where(*knots(self.stages), jnp.inf)[which]
        piece = self._piece(which, jnp.searchsorted(reached, log_time) - 1)
        small = dataclasses.replace(self.stages, panels=None)
        stage = jax.tree.map(lambda leaf: leaf[which], small)
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
        second = self.crosses & (first.energy(first.last, first.end) > energy)
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
        late = above > stage.count
        later = jnp.where(late, excess / jnp.where(r > 0, r, 1.0), 0.0)
        return jnp.exp(-state.log) * (state.u + later)


def motion_from(side: Side, starts_high: Bool[Array, ""], z: Real) -> SlowMotion:
    """Compute the motion from z = logit x on a side.

    A body with two equal moments has no other side: its separatrix is the equator, where L is
    across the symmetry axis, and a motion that leads there ends there.
    """

    def next_stage(carry: Any, crossed: Bool[Array, ""]) -> Any:
        state, moves = carry
        stage = stage_from(side, z, state, moves, crossed)
        arrives = moves & crosses_over(stage)
        return (stage.end, arrives), (stage, arrives)

    zero = jnp.zeros_like(z)
    carry = State(zero, zero), jnp.asarray(True)
    _, (stages, arrives) = jax.lax.scan(next_stage, carry, jnp.array([False, True]))
    return SlowMotion(starts_high, stages, arrives[0])


def crosses_over(stage: Stage) -> Any:
    """Return whether a motion goes on from a stage to the other side of the separatrix."""
    moments = stage.interval.side.moments
    return stage.reaches_separatrix & (moments[..., 1] != moments[..., 0])
