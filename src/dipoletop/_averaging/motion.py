"""The slow motion in time: energy, angular momentum and h of a body that radiates weakly.

A motion has one stage or two, before and after it crosses the separatrix. On each, s and ln L² are
integrals over the parameter y of `slow_flow`. Time follows from dt = ds/(2κL²): the unknown
u = 2κL²t obeys du/ds = 1 − ru and is bounded, so neither t nor L² can over- or underflow.

Where y ends the motion has come to a zero x* of F or to an axis, and L² obeys dL²/dt = −2κr*L⁴
exactly: L² = L²ₑ/(1 + 2κr*L²ₑ(t − tₑ)), which is constant where r* = 0.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.bisection import bisect
from .._base.types import Real
from .slow_flow import FARTHEST, Bound, Interval, Side, interval_of

RTOL = 1e-13  # of the quadratures
MAX_STEPS = 1000
HALVINGS = 60


class State(NamedTuple):
    """What is integrated along y."""

    s: Real
    """∫2κL²dt."""
    log: Real
    """ln L²/L₀²."""
    u: Real
    """2κL²t."""


class Stage(eqx.Module):
    """The motion on one side of the separatrix."""

    interval: Interval
    start: Real
    end: Real
    """Values of y."""
    solution: diffrax.Solution

    @property
    def limit(self) -> Bound:
        """The end of the interval to which the motion leads."""
        pair = zip(self.interval.low, self.interval.high, strict=True)
        return Bound(*(jnp.where(self.end > 0, high, low) for low, high in pair))

    def state(self, y: Real) -> State:
        """The state at y, between start and end."""
        return State(*self.solution.evaluate(y))


def stage_from(side: Side, z: Real, initial: State, moves: Bool[Array, ""]) -> Stage:
    """The motion from z = logit x to the end of its interval; none if it does not move."""
    interval = interval_of(side, z)
    start = interval.parameter(z)
    pace, _ = interval.pace(start)
    end = jnp.where(pace > 0, jnp.maximum(start, FARTHEST), jnp.minimum(start, -FARTHEST))
    end = jnp.where(moves, end, start)

    def field(y: Real, state: Array, args: Any) -> Array:
        pace, r = interval.pace(y)
        return pace * jnp.stack([jnp.ones_like(r), -r, 1 - r * state[2]])

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        start,
        end,
        None,
        jnp.stack(initial),
        stepsize_controller=diffrax.PIDController(RTOL, RTOL),
        saveat=diffrax.SaveAt(t1=True, dense=True),
        max_steps=MAX_STEPS,
        throw=False,
    )
    return Stage(interval, start, end, solution)


class Point(NamedTuple):
    """The slow motion at given times."""

    high: Bool[Array, "*times"]
    """Whether L moves round the axis of the smallest moment, rather than that of the largest."""
    x: Real
    rest: Real
    """1 − x."""
    log: Real
    """ln L²/L₀²."""


class Motion(eqx.Module):
    """A slow motion from t = 0 on; times are in the unit 1/(2κL₀²)."""

    starts_high: Bool[Array, ""]
    stages: Stage
    """Two, on the leading axis; the second takes no step unless the motion crosses."""
    crosses: Bool[Array, ""]
    """Whether it crosses the separatrix."""

    @property
    def last(self) -> Stage:
        """The stage in which it ends."""
        return self._stage(self.crosses.astype(int))

    @property
    def ends_high(self) -> Bool[Array, ""]:
        """The side on which it ends."""
        return self.starts_high ^ self.crosses

    def _stage(self, index: Any) -> Stage:
        return jax.tree.map(lambda leaf: leaf[index], self.stages, is_leaf=eqx.is_array)

    def at(self, log_time: Real) -> Point:
        """The motion at t = exp(log_time)."""
        first = self._stage(0)
        crossing = _log_time(first.state(first.end))
        second = self.crosses & (log_time > crossing)
        stage = self._stage(second.astype(int))

        def passed(part: Real) -> Bool[Array, ""]:
            y = stage.start + part * (stage.end - stage.start)
            return _log_time(stage.state(y)) >= log_time

        _, part = bisect(passed, jnp.zeros(()), jnp.ones(()), HALVINGS)
        y = stage.start + part * (stage.end - stage.start)
        state = stage.state(y)
        x, rest = stage.interval.position(y)
        limit = stage.limit
        r, _ = stage.interval.side.rates(limit.x, limit.rest)
        # After the end of y, 2κL²ₑ(t − tₑ) = uₑ(t/tₑ − 1).
        later = state.u * jnp.expm1(jnp.maximum(log_time - _log_time(state), 0.0))
        return Point(self.starts_high ^ second, x, rest, state.log - jnp.log1p(r * later))


def motion_from(side: Side, starts_high: Bool[Array, ""], z: Real) -> Motion:
    """The motion from z = logit x on a side."""

    def next_stage(carry: Any, is_second: Any) -> Any:
        side, z, state, moves = carry
        stage = stage_from(side, z, state, moves)
        arrives = (stage.end > 0) & ~stage.interval.high.is_zero & moves
        last = State(*stage.solution.ys[-1])
        return (side.other, jnp.full_like(z, FARTHEST), last, arrives), (stage, arrives)

    zero = jnp.zeros_like(z)
    carry = side, z, State(zero, zero, zero), jnp.asarray(True)
    _, (stages, arrives) = jax.lax.scan(next_stage, carry, jnp.arange(2))
    return Motion(starts_high, stages, arrives[0])


def _log_time(state: State) -> Real:
    """ln t, in units of 1/(2κL₀²)."""
    return jnp.log(state.u) - state.log
