"""How a slow motion ends: in residual rotation, in pure spin, or tumbling; and when.

Units are those of the motion: L₀ for angular momentum, the largest moment J₃ for moments, L₀²/J₃
for energy, and J₃³/(2κL₀²) for time.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.checks import or_nan
from .._base.guards import safe_divisor
from .._base.types import Real
from .capture import LEVELS as QUANTILES
from .capture import TopEnd, capture, end_of_top
from .capture_times import clock_of_needle
from .estimates import estimated_error, largest_loss, rate_error
from .free_rotation import averages, gaps_of
from .motion import RTOL, Point, SlowMotion, Stage
from .planar_orbits import ENTRY, Expansion
from .principal_axes import FreeRotation
from .unfolding import entry_q

ENDS = (
    "residual +",
    "residual -",
    "stop about axis 1",
    "stop about axis 2",
    "stop about axis 3",
    "tumbling, low",
    "tumbling, high",
    "wobbling",
)
"""The ends of a motion: residual rotation along and against the dipole; a stop in pure spin about
the principal axis of J₁ (the smallest), J₂, J₃; a stop while tumbling, with h below or above 1/J₂;
a stop while oscillating about the middle axis of a needle."""

EXCESS = 1e-8
"""(E₀ − E∞)/E₀ below which it decays as next to its limit, to this relative error."""


class SlowEnd(NamedTuple):
    """How a slow motion ends."""

    probability: Float[Array, "8"]
    """The probability of each of the `ENDS`."""
    log_ratio: Real
    """The logarithm of the mean of L∞/L₀; −∞ for a stop."""
    log_quantiles: Float[Array, "5"]
    """The logarithms of the `QUANTILES` of L∞/L₀."""
    energy: Real
    """E₀."""
    last_energy: Real
    """E∞."""
    half_time: Real
    """The time at which E − E∞ has fallen to one half."""
    last_moment: Real
    """The moment about the axis of the last rotation, if it is a pure spin."""
    decay: Real
    """The rate of the law L² = L²ₚ/(1 + decay t) at late times; 0 if the rotation is residual, NaN
    if chance decides that, or if no such law has the right t = 0."""
    known_phase: Bool[Array, ""] | bool = False
    """Whether the body is captured at once, from its own phase, so that nothing is averaged."""
    error: Real | float = 0.0
    """The estimated relative error of the times beyond that of the averages."""


def slow_end(rotation: FreeRotation, motion: SlowMotion) -> SlowEnd:
    """Return how a slow motion of a body ends."""
    stage = motion.final
    limit = stage.limit
    axis = jnp.where(motion.ends_high, 0, 2)
    spins = ~stage.rises & ~limit.is_zero
    residual = spins & (limit.r == 0)
    end = stage.end
    log = jnp.where(residual, end.log, -jnp.inf)
    last_energy = stage.interval.side.shape(limit.x, limit.rest) * jnp.exp(log) / 2
    energy = motion.energy
    decay, error = late_decay(stage)
    rates, _ = averages(stage.interval.side.moments, limit.x, limit.rest)
    error += motion.error + rate_error(rotation, motion.ends_high, rates)
    # The excess is a difference of energies, unless it is so small that it decays exponentially.
    excess = (energy - last_energy) / energy
    short = residual & (excess < EXCESS)
    error += jnp.where(residual & ~short, (RTOL + motion.error) / safe_divisor(excess), 0.0)
    half_time = jnp.where(
        short,
        _half_time_of_neighbours(rotation, axis),
        motion.time_at((energy + last_energy) / 2),
    )
    return SlowEnd(
        slow_probability(rotation, motion.crosses, motion.ends_high, spins),
        *_certain(log / 2),
        energy,
        last_energy,
        half_time,
        rotation.moments[axis],
        decay,
        error=error,
    )


def late_decay(stage: Stage) -> tuple[Real, Real]:
    """Return the rate of the law L² = L²ₚ/(1 + rate t) of the last stage, and its relative error.

    With the last r = r*, 1/L² − r*t tends to L²ₚ⁻¹ = L⁻²(1 − r*u) + ∫(r − r*)ds/L² from any point.
    Near the end r − r* falls as exp(−|y|), and 1/L² grows as exp(ρ|y|), ρ = r*|ds/dy|. So the
    limit exists for ρ < 1 only: otherwise L falls before h has come to its last value.
    """
    last, index = stage.limit.r, stage.settled
    y, state = stage.knots[index], stage.knot(index)
    pace, r = stage.interval.pace(y)
    pace = jnp.abs(pace)
    exists = last * pace < 1
    rest = (r - last) * pace / jnp.where(exists, 1 - last * pace, 1.0)
    share = 1 - last * state.u + rest
    exists &= share > 0
    share = jnp.where(exists, share, 1.0)
    error = (RTOL + jnp.abs(rest) * jnp.exp(-jnp.abs(y))) / share
    rate = jnp.where(exists, last * jnp.exp(state.log) / share, jnp.nan)
    return jnp.where(last == 0, 0.0, rate), jnp.where((last == 0) | ~exists, 0.0, error)


def slow_probability(
    rotation: FreeRotation, crosses: Bool[Array, ""], ends_high: Bool[Array, ""], spins: Array
) -> Float[Array, "8"]:
    """Return the probabilities of the `ENDS` of a slow motion.

    Args:
        rotation: where it begins.
        crosses: whether it crosses the separatrix.
        ends_high: whether it ends on the side of the axis of J₁.
        spins: whether it ends on an axis.
    """
    axis = jnp.where(ends_high, 0, 2)
    # The sign of L about the last axis is the first one, or chance after the separatrix.
    sign = jnp.sign(rotation.momentum[axis] * rotation.dipole[axis])
    return jnp.where(
        spins & (rotation.spin_decay(axis) == 0),
        _residual_ends(jnp.where(crosses, 0.0, sign)),
        jax.nn.one_hot(jnp.where(spins, 2 + axis, jnp.where(ends_high, 6, 5)), 8),
    )


def spin_end(rotation: FreeRotation, axis: Int[Array, ""]) -> SlowEnd:
    """Return how a pure spin about a principal axis ends, by its law L² = 1/(1 + rt)."""
    moment, cosine = rotation.moments[axis], rotation.dipole[axis]
    r = rotation.spin_decay(axis)
    residual = r == 0
    sign = jnp.sign(rotation.momentum[axis] * cosine)
    probability = jnp.where(residual, _residual_ends(sign), jax.nn.one_hot(2 + axis, 8))
    energy = 1 / (2 * moment)
    log_ratio = jnp.where(residual, 0.0, -jnp.inf)
    last_energy = jnp.where(residual, energy, 0.0)
    half_time = jnp.where(residual, _half_time_of_neighbours(rotation, axis), 1 / safe_divisor(r))
    across = jnp.where(jnp.arange(3) == axis, 0.0, 1.0)
    error = 3 * rotation.rounding * rotation.moments[2] / rotation.moments[0]
    error += rate_error(rotation, jnp.zeros((), bool), across)
    times = half_time, moment, r
    return SlowEnd(probability, *_certain(log_ratio), energy, last_energy, *times, error=error)


def _half_time_of_neighbours(rotation: FreeRotation, axis: Int[Array, ""]) -> Real:
    """Return the limit of the half time of starts next to residual rotation about an axis.

    E − E∞ is in proportion to x = (h − c)/Db, which falls as exp(F(0)t). For a dipole along this
    axis c F(0) = −abc − ½[a²(b − c) + b²(a − c)]. NaN about the middle axis, which the neighbours
    leave.
    """
    moments = jnp.roll(rotation.moments, -1 - axis)  # that of the axis comes last
    (a, b, c), (to_a, to_b, _) = 1 / moments, gaps_of(moments)
    growth = -a * b * c - (a**2 * to_b + b**2 * to_a) / 2
    attracts = (axis != 1) & (growth < 0)
    return or_nan(np.log(2) / jnp.where(attracts, -growth, 1.0), attracts)


def sphere_end(rotation: FreeRotation) -> SlowEnd:
    """Return how the rotation of a sphere ends.

    s = n·Ω is constant, and u = |Ω×n|² obeys u′ = −(s² + u)u. The solution
    u = u₀y/(1 + u₀(1 − y)/s²), y = exp(−s²t), is exact at order 1. A stop is counted as one about
    axis 3.
    """
    cosine = rotation.dipole @ rotation.momentum
    square, stops = cosine**2, cosine == 0
    divisor = safe_divisor(square)
    ends = jnp.where(stops, jax.nn.one_hot(4, 8), _residual_ends(jnp.sign(cosine)))
    half = jnp.full_like(square, 0.5)
    return SlowEnd(
        ends,
        *_certain(jnp.where(stops, -jnp.inf, jnp.log(divisor) / 2)),
        half,
        half * square,
        jnp.where(stops, 1.0, jnp.log1p(square) / divisor),
        jnp.ones_like(square),
        jnp.where(stops, 1.0, 0.0),
    )


def needle_end(rotation: FreeRotation, motion: SlowMotion, weakness: Real) -> SlowEnd:
    """Return how the rotation of a needle ends.

    A needle is an axisymmetric body with its dipole across its long axis. The slow flow leads to
    rotation across the long axis, where chance decides how the body is captured.

    Args:
        rotation: its two larger moments are equal.
        motion: its slow motion.
        weakness: κL₀/J₃².
    """
    delta, omega = needle_start(rotation, weakness)
    end = end_of_top(delta, omega, capture(delta))
    shift = _log_speed(rotation)
    energy = motion.energy
    squares = jnp.mean(jnp.exp(2 * (end.capture.log_table + shift)))
    residual = end.along + end.against
    last_energy = jnp.where(residual > 0, residual * squares / 2, 0.0)
    q = entry_q(delta, jnp.zeros_like(delta))
    log_square = 2 * (end.log_scale + shift - Expansion(-1.5 * delta / (1 - delta)).log_w(q))
    square = jnp.exp(jnp.where(end.random, log_square, 0.0))
    last = jnp.where(end.random, 2 * last_energy / safe_divisor(square), 0.0)
    clock = clock_of_needle(delta, last)
    averaging = estimated_error(rotation, largest_loss(motion), weakness)
    half_time, late = clock.time_at(motion, (energy + last_energy) / 2, averaging, square)
    error = end.capture.error + jnp.where(end.random, late, 0.0)
    probability, log_ratio = needle_chances(rotation, end)
    return SlowEnd(
        probability,
        log_ratio,
        end.capture.log_quantiles_of_all() + shift,
        energy,
        last_energy,
        or_nan(half_time, end.random),
        rotation.moments[2],
        jnp.where(residual == 1, 0.0, jnp.nan),
        ~end.random,
        error,
    )


def needle_start(rotation: FreeRotation, weakness: Real) -> tuple[Real, Float[Array, "3"]]:
    """Return the δ of a needle, and its ω₀ in units of 1/τ₀, dipole first and long axis last."""
    long = jnp.array([1.0, 0.0, 0.0])
    frame = jnp.stack([rotation.dipole, jnp.cross(long, rotation.dipole), long])
    omega = frame @ (rotation.momentum / rotation.moments)
    return 1 - rotation.moments[0] / rotation.moments[2], weakness * omega


def needle_chances(rotation: FreeRotation, end: TopEnd) -> tuple[Float[Array, "8"], Real]:
    """Return the probabilities of the `ENDS` of a needle, and the logarithm of the mean L∞/L₀."""
    residual = end.along + end.against
    log_mean = jnp.log(safe_divisor(residual)) + end.capture.log_mean + _log_speed(rotation)
    zero = jnp.zeros_like(residual)
    ends = end.along, end.against, end.symmetry_axis, zero, end.across, zero, zero, end.wobbling
    return jnp.stack(ends), jnp.where(residual > 0, log_mean, -jnp.inf)


def _log_speed(rotation: FreeRotation) -> Real:
    """Return the logarithm of |ω₀|J₃/L₀, the factor from |ω∞|/|ω₀| to L∞/L₀."""
    return jnp.log(jnp.linalg.norm(rotation.momentum / rotation.moments))


def turns_fast(rotation: FreeRotation, point: Point, weakness: Real) -> Bool[Array, "*times"]:
    """Return whether a body with two equal moments still turns fast about its symmetry axis.

    It does before its capture, while q = 2|δω₃|/ω⊥² is large. Averages over that turn then hold.
    """
    axial = jnp.where(rotation.moments[1] == rotation.moments[2], 0, 2)
    delta = 1 - rotation.moments[axial] / rotation.moments[1]
    # ω₃ = κL√(1 − x)/J_c and ω⊥² = κ²L²x/J_b², in units of 1/τ₀.
    across = jnp.sqrt(point.x) / rotation.moments[1]
    along = jnp.sqrt(point.rest) / rotation.moments[axial]
    log_q = jnp.log(2 * jnp.abs(delta) * along / across**2) - jnp.log(weakness) - point.log / 2
    return log_q > jnp.log(ENTRY * (1 + 1.5 * jnp.abs(delta / (1 - delta))))


def _certain(log_ratio: Real) -> tuple[Real, Float[Array, "5"]]:
    """Return the logarithm of a ratio that does not depend on chance, and its quantiles."""
    return log_ratio, jnp.broadcast_to(log_ratio, (len(QUANTILES),))


def _residual_ends(sign: Real) -> Float[Array, "8"]:
    """Return the probabilities if L∞ is along (1), against (−1) or as likely either way (0)."""
    return jnp.concatenate([jnp.stack([1 + sign, 1 - sign]) / 2, jnp.zeros(6, sign.dtype)])
