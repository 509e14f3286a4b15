"""The slow motion on one side of the separatrix, by quadrature over the parameter y of `slow_flow`.

ln L² is an integral over y. Time follows from dt = ds/(2κL²): the unknown u = 2κL²t obeys
du/ds = 1 − ru and is bounded, so neither t nor L² can over- or underflow.

From one knot in y to the next, ln L² and u are polynomials through Chebyshev nodes (collocation).
The knots are so near to each other that the last coefficients are negligible, or of the size of
rounding. Where times are not wanted, as for many motions at once, only ln L² at the end is kept.
For stops it is computed roughly then, since only the error depends on it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.chebyshev import chebyshev_sum, collocation_rule
from .._base.dense import solve_dense
from .._base.guards import safe_divisor
from .._base.types import Real
from .slow_flow import FARTHEST, Bound, Interval, Side, interval_of

RTOL = 1e-13  # relative error of a panel
COARSE = 1e-5
"""The relative error of a panel where only its `loss` is wanted, to one digit."""
ROUNDED = 1e-4  # error below which it may be that of rounding
MOST_PANELS = 400
FIRST_LENGTH, FIRST_COARSE = 0.5, 2.0  # of a panel, in y
SHORTEST = 1e-10
LOWEST = -1500.0  # ln L²/L₀² at which t exceeds any floating-point number by far
NODES = 16  # of collocation between two knots
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
    """The integrals at the first y."""
    last: Real
    """The last y."""
    end: State
    """The integrals at the last y."""
    loss: Real
    """The largest `Side.loss` at a knot but the first, for ln L² = 0 at the start of the motion."""
    failed: Bool[Array, "*n"]
    """Whether there are too many panels, or a rate is not a number."""
    error: Real
    """The estimated error of ln L², relative to its change if that is large; 0 for a stop
    without times."""
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
    def timed_panels(self) -> Panels:
        """The panels of a stage that was computed with times."""
        if self.panels is None:
            raise TypeError("this stage was computed without times")
        return self.panels

    @property
    def knots(self) -> Float[Array, "K"]:
        """The values of y between panels, and at both ends; filled up with ∞."""
        return jnp.append(self.start, self.timed_panels.y[:, -1])

    @property
    def states(self) -> State:
        """The states at the knots."""
        panels = self.timed_panels
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
        """y, the integrals, ds/dy and r at the first end of a panel beyond `REACH`, or the last."""
        panels, last = self.timed_panels, jnp.maximum(self.count - 1, 0)
        reaches = jnp.where(self.rises, panels.y[:, -1] >= REACH, panels.y[:, -1] <= -REACH)
        reaches &= jnp.isfinite(panels.y[:, -1])
        index = jnp.where(jnp.any(reaches), jnp.argmax(reaches), last)
        y, log, u, pace, r = (values[index, -1] for values in panels)
        return y, State(log, u), pace, r

    def piece(self, index: Int[Array, ""]) -> Piece:
        """Return the motion after the knot of this index."""
        return piece_of(self.timed_panels, self.count, (index,))


def piece_of(panels: Panels, count: Int[Array, ""], place: tuple[Int[Array, ""], ...]) -> Piece:
    """Return the motion in one panel.

    Args:
        panels: the panels, perhaps of two stages on the leading axis.
        count: the number of panels of the stage.
        place: the index of the panel, after that of its stage if there are two.
    """
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
    # Only a dipole along an extreme axis leaves a residual rotation. Without one L ends at 0.
    is_kept = (side.weights[1] == 0) & (side.weights[0] * side.weights[2] == 0)
    is_fine = is_kept | timed
    rtol = jnp.where(is_fine, RTOL, COARSE)

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
        only_rounding &= (error > rtol) & (error < ROUNDED)
        accepted = (error <= rtol) | only_rounding | (now.length < SHORTEST)
        factor = 0.9 * (rtol / jnp.maximum(error, 1e-30)) ** (1 / NODES)
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
            now.error + jnp.where(accepted & is_fine, error, 0.0),
            panels,
        )

    zero, infinite = jnp.zeros_like(start), jnp.full_like(start, jnp.inf)
    panels = Panels(*[jnp.full((MOST_PANELS, NODES), jnp.inf, start.dtype)] * 5) if timed else None
    count = jnp.zeros((), int)
    length = jnp.where(is_fine, FIRST_LENGTH, FIRST_COARSE)
    first = start, initial, zero, count, zero + length, infinite, zero, zero
    done = jax.lax.while_loop(unfinished, advance, _Progress(*first, panels))
    failed = moves & ~ended(done)
    found = done.y, done.state, done.loss, failed, done.error, done.count, done.panels
    return Stage(interval, rises, start, initial, *found)


def panel(
    interval: Interval, first: Real, length: Real, start: State, timed: bool
) -> tuple[Panels, Real]:
    """Return the motion at Chebyshev nodes behind a knot, and its relative error.

    The error is that of polynomials, by their last two coefficients. Without times ln L² is
    computed at the last node only.
    """
    rule = collocation_rule(NODES)
    y = first + length * rule.nodes
    pace, r = jax.vmap(interval.pace)(y)
    integrals = jnp.asarray(rule.integrals if timed else rule.integrals[-1:])
    last_coefficients = jnp.asarray(rule.coefficients[-2:])
    change = length * pace
    fall = r * change
    log = start.log - integrals @ fall

    def tail(values: Float[Array, "n"]) -> Real:
        return jnp.sum(jnp.abs(last_coefficients @ values))

    error = tail(fall) / jnp.maximum(1.0, jnp.max(jnp.abs(log - start.log)))
    u = jnp.broadcast_to(start.u, log.shape)
    if timed:
        # u = u₀ + ∫(1 − ru)ds, for (1 + |r ds|)u: ds may be large.
        scale = 1 / (1 + jnp.abs(fall))
        matrix = jnp.diag(scale) + integrals * (fall * scale)[None]
        sides = start.u + integrals @ change
        u = scale * solve_dense(matrix, sides[:, None])[:, 0]
        error = jnp.maximum(error, tail(u) / safe_divisor(jnp.max(jnp.abs(u))))
    return Panels(y, log, u, pace, r), jax.lax.stop_gradient(error)


def crosses_over(stage: Stage) -> Any:
    """Return whether a motion goes on from a stage to the other side of the separatrix."""
    moments = stage.interval.side.moments
    return stage.reaches_separatrix & (moments[..., 1] != moments[..., 0])
