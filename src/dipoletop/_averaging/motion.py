"""The slow motion in time: energy, angular momentum and h of a body that radiates weakly.

A motion has one stage or two (`stages`), before and after it crosses the separatrix.

At the last y the motion has come to a zero x* of F or to an axis, and L² obeys dL²/dt = −2κr*L⁴
exactly: L² = L²ₑ/(1 + 2κr*L²ₑ(t − tₑ)), which is constant where r* = 0. A body with two equal
moments that comes to its equator continues to approach it as a power of L².
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._base.guards import safe_divisor
from .._base.roots import root
from .._base.types import Real
from .principal_axes import FreeRotation
from .slow_flow import Side
from .stages import Stage, State, crosses_over, piece_of, stage_from

HALVINGS = 60


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

    def at(self, log_time: Real) -> Point:
        """Compute the motion at t = exp(log_time)."""
        second = self.crosses & (log_time > self.stage(0).end.log_time)
        which = second.astype(int)
        knots = jax.vmap(lambda each: (jnp.isfinite(each.knots), each.states.log_time))
        reached = jnp.where(*knots(self.stages), jnp.inf)[which]
        # By both indices at once, so that no stage is copied for each of many times.
        place = which, jnp.searchsorted(reached, log_time) - 1
        piece = piece_of(self.stages.timed_panels, self.stages.count[which], place)
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


def slow_motion(rotation: FreeRotation) -> SlowMotion:
    """Return the slow motion of a body with at least two different moments."""
    high, z = rotation.place
    return motion_from(rotation.side(high), high, z)


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
