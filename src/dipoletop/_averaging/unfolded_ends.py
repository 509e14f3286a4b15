"""How a nearly axisymmetric body ends, by its unfolded system; and its history.

A needle that turns fast about its symmetry axis is captured at a random phase: many phases are
followed. Other starts have a known phase. They are followed together with neighbours that differ
by the error of the unfolded system. These show how certain the end is.
"""

import functools
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.checks import or_nan
from .._base.guards import safe_divisor
from .._base.types import RESIDUAL_FATES, Fate, Real
from .capture import LEVELS
from .capture_times import clock_from
from .ends import SlowEnd, certainty_of, slow_end
from .motion import SlowMotion, slow_motion
from .planar_orbits import PlanarMotion, Settled, follow, settle
from .principal_axes import FreeRotation
from .unfolding import LARGEST, PHASES, Top, entry_of, phases

TURNING = 2.0  # value of q above which no phase is captured
SHIFT = 3.0  # distance of neighbours, in units of the error
UNCERTAIN = 0.5  # the error where a neighbour ends in another way
ORBIT_STEPS = 16_384
ORBITS = 1e-9  # the error of orbits
NEXT_TO_LINE = 0.999  # E∞/E₀ above which the half time is that of the linear law at the line
TIGHT = 1e-12  # the loss ln u that an orbit leaves out


def order_error(top: Top, log_u: Real) -> Real:
    """Return the relative size of the terms that the unfolded system neglects from a given u on."""
    z = top.start[1] * jnp.exp(top.log_u - log_u)
    far = 1 / jnp.abs(top.delta) + jnp.minimum(jnp.abs(z), 1 / jnp.abs(top.delta))
    return (jnp.exp(log_u) * far + jnp.abs(top.eta)) * far / (1 - top.delta)


def captured_end(rotation: FreeRotation, motion: SlowMotion, top: Top) -> tuple[SlowEnd, Real]:
    """Return the end of a needle that is captured at a random phase, and its relative error."""
    _, q, log_u = entry_of(rotation, motion, top)
    plane = PlanarMotion(top.delta, top.eta * jnp.exp(-log_u))
    lanes = jax.vmap(functools.partial(settle, plane))(phases(plane, q))
    logs = lanes.log_ratio + _log_momentum(top, log_u)
    known = jnp.all(lanes.residual | lanes.stops)
    share = jnp.mean(jnp.where(lanes.residual, 1.0, 0.0))
    # A dipole on the axis of the largest moment makes every phase residual in the end. On the
    # middle axis no phase is, if the line repels while all still turn. Otherwise the sample of
    # phases may miss a share below its resolution.
    turning = jnp.all(2 * jnp.abs(top.delta * lanes.state[:, 1]) > TURNING)
    certain = (top.eta > 0) | ((share == 0) & turning)
    residual = jnp.where(certain, share, jnp.clip(share, 0.5 / PHASES, 1 - 0.5 / PHASES))
    ends = residual / 2 * (certainty_of(Fate.POSITIVE) + certainty_of(Fate.NEGATIVE))
    ends += (1 - residual) * certainty_of(Fate.TUMBLING_LOW)
    end = _end_of(rotation, top, ends, logs)
    square = jnp.exp(log_u - 2 * top.log_unit)
    clock = clock_from(plane, q, jnp.mean(jnp.exp(2 * lanes.log_ratio)))
    half = (end.energy + end.last_energy) / 2
    order = order_error(top, log_u)
    half_time, late = clock.time_at(motion, half, order, square, top.moment)
    error = order + _sampling_error(logs) + late
    error = jnp.where(known & (jnp.abs(plane.ratio) < LARGEST), error, jnp.inf)
    return end._replace(half_time=half_time), error


def _sampling_error(logs: Float[Array, "n"]) -> Real:
    """Return half the relative difference between the means over odd and over even phases."""
    largest = jnp.max(jnp.where(jnp.isfinite(logs), logs, -jnp.inf))
    parts = jnp.exp(logs - jnp.where(jnp.isfinite(largest), largest, 0.0))
    odd, even = jnp.sum(parts[::2]), jnp.sum(parts[1::2])
    return jnp.abs(odd - even) / safe_divisor(odd + even)


def known_end(rotation: FreeRotation, top: Top, *, is_disc: bool) -> tuple[SlowEnd, Real]:
    """Return the end of a start whose phase is known, and its relative error; a disc has δ < 0."""
    log_u = top.log_u
    error = order_error(top, log_u) + ORBITS
    start, ratio = top.start, top.ratio
    size = jnp.stack([jnp.ones_like(error), jnp.abs(start[1]) + 1, jnp.zeros_like(error)])
    plane = PlanarMotion(top.delta, ratio)
    size = jnp.where(plane.stays(start), 0.0, SHIFT * error * size)
    shifts = jnp.array([[0, 0, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0.0]])
    lanes = jax.vmap(lambda shift: settle(plane, start + shift * size))(shifts)
    stop, log_stop = _stops(
        rotation, top, plane, jax.tree.map(lambda leaf: leaf[0], lanes), is_disc
    )
    residual = jnp.where(
        lanes.along[:, None], certainty_of(Fate.POSITIVE), certainty_of(Fate.NEGATIVE)
    )
    each = jnp.where(lanes.residual[:, None], residual, stop)
    logs = jnp.where(lanes.residual, lanes.log_ratio + _log_momentum(top, log_u), log_stop)
    alike = jnp.all(lanes.residual == lanes.residual[0])
    alike = alike & jnp.all(jnp.where(lanes.residual, lanes.along == lanes.along[0], True))
    spread = jnp.where(jnp.isfinite(logs), jnp.abs(logs - logs[0]), 0.0)
    error = jnp.where(alike, error + jnp.max(spread), UNCERTAIN)
    # A disc comes to turn fast, where the neglected ω₃²/ω⊥² = z²u is largest.
    _, z, fall = lanes.state[0]
    error += jnp.where((top.delta < 0) & ~lanes.residual[0], z**2 * jnp.exp(log_u + fall), 0.0)
    error = jnp.where(jnp.all(lanes.residual | lanes.stops), error, jnp.inf)
    probability = jnp.where(alike, each[0], jnp.mean(each, axis=0))
    end = _end_of(rotation, top, probability, jnp.where(alike, logs[:1], logs))
    part = end.last_energy / end.energy
    half_times = jax.vmap(lambda shift: half_time_of(top, part, shift * size))(shifts)
    spread = jnp.abs(half_times / half_times[0] - 1)
    counts = jnp.isfinite(spread) & (part < NEXT_TO_LINE)
    error += jnp.max(jnp.where(counts, spread, 0.0))
    return end._replace(half_time=half_times[0]), error


def half_time_of(top: Top, last_part: Real, shift: Float[Array, "3"]) -> Real:
    """Return the time after which E − E∞ of a start with a known phase has fallen to one half.

    Args:
        top: the body.
        last_part: E∞/E₀.
        shift: what is added to the start.
    """
    start, plane = top.start + shift, PlanarMotion(top.delta, top.ratio)
    half_lost = (1 + last_part) / 2 * top.energy(start)
    y = follow_in_time(plane, start, lambda y: half_lost - top.energy(y[:3])).ys[-1]
    reached = top.energy(y[:3]) <= half_lost * (1 + ORBITS)
    half = or_nan(y[3] * jnp.exp(-y[2]), reached)
    near, linear = plane.half_life(start)
    return jnp.where(near, linear, half) * top.time_unit


class PlaneOrbit(eqx.Module):
    """An orbit of the unfolded system in time."""

    top: Top
    path: diffrax.DenseInterpolation
    last: Real
    """The last σ."""
    settled: Bool[Array, ""]
    """Whether it is at the residual line by then."""

    def at(self, sigma: Real) -> tuple[Float[Array, "3"], Real]:
        """Return the state at σ, and uτ."""
        y = self.path.evaluate(sigma)
        return y[:3], y[3]


def orbit_of(top: Top, start: Float[Array, "3"]) -> PlaneOrbit:
    """Return the orbit of a start (φ, z, ln u/u₀) whose phase is known."""
    plane = PlanarMotion(top.delta, top.ratio)
    orbit = follow_in_time(plane, start)
    settled = plane.settles(orbit.ys[-1], TIGHT)
    return PlaneOrbit(top, orbit.interpolation, orbit.ts[-1], settled)


def follow_in_time(plane: PlanarMotion, start: Float[Array, "3"], passed: Any = None) -> Any:
    """Return the orbit of a start, with uτ as its fourth component.

    Args:
        plane: the system.
        start: the start.
        passed: a function of the state; the orbit ends where it becomes positive. None: the orbit
            is kept, and ends when its end is known.
    """

    def field(sigma: Any, y: Array, args: Any) -> Array:
        rate = plane(sigma, y)
        return jnp.append(rate, 1 + rate[2] * y[3])  # u dτ = dσ

    def ended(t: Any, y: Array, args: Any, **_: Any) -> Any:
        is_known = plane.ended(y) & (~plane.settles(y) | plane.settles(y, TIGHT))
        return is_known if passed is None else jnp.where(is_known, 1.0, passed(y))

    kept = passed is None
    return follow(field, jnp.append(start, 0.0), ended, ORBIT_STEPS, dense=kept, exact=not kept)


def handed_over(
    rotation: FreeRotation, top: Top, state: Float[Array, "3"]
) -> tuple[FreeRotation, Real]:
    """Return the free rotation in a state, with |L| = 1, and its |L| over J₁√u₀."""
    momentum = top.frame.T @ (top.moments * top.omega_at(state, top.log_u))
    size = jnp.linalg.norm(momentum)
    return eqx.tree_at(lambda each: each.momentum, rotation, momentum / size), size


def _log_momentum(top: Top, log_u: Real) -> Real:
    """Return the logarithm of J₁√u over L₀."""
    return log_u / 2 - top.log_unit + jnp.log(top.moment)


def _end_of(
    rotation: FreeRotation, top: Top, probability: Float[Array, "8"], logs: Float[Array, "n"]
) -> SlowEnd:
    """Return the end, given ln L∞/L₀ of equally probable lanes; the half time is NaN."""
    unknown = jnp.full_like(top.delta, jnp.nan)
    residual = jnp.sum(probability[RESIDUAL_FATES])
    log_mean = jax.nn.logsumexp(logs) - np.log(logs.size)
    return SlowEnd(
        probability,
        log_mean,
        _quantiles(logs),
        rotation.momentum**2 @ (0.5 / rotation.moments),
        jnp.mean(jnp.exp(2 * logs)) / (2 * top.moment),
        unknown,
        top.moment,
        jnp.where(residual == 1, 0.0, jnp.nan),
    )


def _quantiles(logs: Float[Array, "n"]) -> Float[Array, "5"]:
    """Return the `LEVELS` of equally probable values, some of them −∞."""
    ordered = jnp.sort(logs)
    stops = jnp.sum(jnp.where(jnp.isfinite(logs), 0.0, 1.0))
    last = logs.size - 1
    place = jnp.asarray(LEVELS) * logs.size - 0.5
    lower = jnp.clip(jnp.floor(place), jnp.minimum(stops, last), last)
    finite = jnp.where(jnp.isfinite(ordered), ordered, 0.0)
    first = finite[lower.astype(int)]
    second = finite[jnp.minimum(lower + 1, last).astype(int)]
    between = first + jnp.clip(place - lower, 0.0, 1.0) * (second - first)
    return jnp.where(place < stops - 0.5, -jnp.inf, between)


def _stops(
    rotation: FreeRotation, top: Top, plane: PlanarMotion, at: Settled, is_disc: bool
) -> tuple[Float[Array, "8"], Real]:
    """Return the probabilities and ln L∞/L₀ of a start that is not captured.

    It tumbles if the residual line repels it, since the dipole is then on the middle axis. A disc
    that turns fast obeys the slow flow.
    """
    nothing = jnp.full_like(top.delta, -jnp.inf)
    stays = certainty_of(Fate.AXIS_2)  # across dipole and symmetry axis
    ends = jnp.where(plane.repels(at.state), certainty_of(Fate.TUMBLING_LOW), stays)
    if not is_disc:
        return ends, nothing
    turning = plane.turns(at.state)
    y = plane.section(jnp.where(turning, at.state, jnp.array([0.3, 5.0, 0.0])), jnp.zeros(()))
    handed, size = handed_over(rotation, top, y)
    end = slow_end(handed, slow_motion(handed))
    log_ratio = jnp.log(size) + _log_momentum(top, top.log_u) + end.log_ratio
    return jnp.where(turning, end.probability, ends), jnp.where(turning, log_ratio, nothing)
