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
from .._base.roots import root
from .._base.types import PREDICTED_FATES, Fate, Real
from ..exact.averaged_quadrature import AveragedOrbit, mesh
from .capture import LEVELS as QUANTILES
from .capture import TopEnd
from .capture_times import clock_of_needle
from .estimates import estimated_error, rate_error
from .free_rotation import gaps_of
from .motion import HALVINGS, Point, SlowMotion
from .planar_orbits import ENTRY, Expansion, entry_q
from .principal_axes import FreeRotation
from .stages import RTOL, Stage

EXCESS = 1e-8
"""(E₀ − E∞)/E₀ below which it decays as next to its limit, to this relative error."""
BEFORE_ENTRY = 1.5
"""E over ω⊥²/2 at the entry above which the entry is sure to come later: random phases have at most
1.01 times ω⊥²/2 there on average."""


class SlowEnd(NamedTuple):
    """How a slow motion ends."""

    probability: Float[Array, "8"]
    """The probability of each of the `PREDICTED_FATES`."""
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
    """Return how a slow motion of a body ends; times are NaN if they were not computed."""
    stage = motion.final
    limit = stage.limit
    axis = jnp.where(motion.ends_high, 0, 2)
    spins = ~stage.rises & ~limit.is_zero
    residual = spins & (limit.r == 0)
    log = jnp.where(residual, stage.end.log, -jnp.inf)
    last_energy = stage.interval.side.shape(limit.x, limit.rest) * jnp.exp(log) / 2
    energy = motion.energy
    half_time = decay = jnp.full_like(log, jnp.nan)
    error = motion.error + rate_error(rotation, motion.ends_high, limit.rates)
    if stage.panels is not None:
        decay, more = late_decay(stage)
        # The excess is a difference of energies, unless it is so small that it decays
        # exponentially.
        excess = (energy - last_energy) / energy
        short = residual & (excess < EXCESS)
        off = (RTOL + motion.error) / safe_divisor(excess)
        error += more + jnp.where(residual & ~short, off, 0.0)
        half_time = motion.time_at((energy + last_energy) / 2)
        half_time = jnp.where(short, _half_time_of_neighbours(rotation, axis), half_time)
    end = SlowEnd(
        _probability(rotation, motion, spins),
        *_certain(log / 2),
        energy,
        last_energy,
        half_time,
        rotation.moments[axis],
        decay,
        jnp.asarray(False),
        error,
    )
    return jax.tree.map(lambda x: x if x.dtype == bool else or_nan(x, ~motion.failed), end)


def late_decay(stage: Stage) -> tuple[Real, Real]:
    """Return the rate of the law L² = L²ₚ/(1 + rate t) of the last stage, and its relative error.

    With the last r = r*, 1/L² − r*t tends to L²ₚ⁻¹ = L⁻²(1 − r*u) + ∫(r − r*)ds/L² from any point.
    Near the end r − r* falls as exp(−|y|), and 1/L² grows as exp(ρ|y|), ρ = r*|ds/dy|. So the
    limit exists for ρ < 1 only: otherwise L falls before h has come to its last value.
    """
    last, (y, state, pace, r) = stage.limit.r, stage.settled
    pace = jnp.abs(pace)
    exists = last * pace < 1
    rest = (r - last) * pace / jnp.where(exists, 1 - last * pace, 1.0)
    share = 1 - last * state.u + rest
    exists &= share > 0
    share = jnp.where(exists, share, 1.0)
    error = (RTOL + jnp.abs(rest) * jnp.exp(-jnp.abs(y))) / share
    rate = jnp.where(exists, last * jnp.exp(state.log) / share, jnp.nan)
    return jnp.where(last == 0, 0.0, rate), jnp.where((last == 0) | ~exists, 0.0, error)


def _probability(rotation: FreeRotation, motion: SlowMotion, spins: Array) -> Float[Array, "8"]:
    """Return the probabilities of the fates of a slow motion, which ends on an axis or not."""
    axis = jnp.where(motion.ends_high, 0, 2)
    tumbling = jnp.where(motion.ends_high, Fate.TUMBLING_HIGH, Fate.TUMBLING_LOW)
    # The sign of L about the last axis is the first one, or chance after the separatrix.
    sign = jnp.sign(rotation.momentum[axis] * rotation.dipole[axis])
    return jnp.where(
        spins & (rotation.spin_decay(axis) == 0),
        _residual_ends(jnp.where(motion.crosses, 0.0, sign)),
        certainty_of(jnp.where(spins, Fate.AXIS_1 + axis, tumbling)),
    )


def spin_end(rotation: FreeRotation, axis: Int[Array, ""]) -> SlowEnd:
    """Return how a pure spin about a principal axis ends, by its law L² = 1/(1 + rt)."""
    moment, cosine = rotation.moments[axis], rotation.dipole[axis]
    r = rotation.spin_decay(axis)
    residual = r == 0
    sign = jnp.sign(rotation.momentum[axis] * cosine)
    probability = jnp.where(residual, _residual_ends(sign), certainty_of(Fate.AXIS_1 + axis))
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
    ends = jnp.where(stops, certainty_of(Fate.AXIS_3), _residual_ends(jnp.sign(cosine)))
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


def needle_end(
    rotation: FreeRotation,
    weakness: Real,
    end: TopEnd,
    motion: SlowMotion | None = None,
    *,
    timed: bool = False,
) -> SlowEnd:
    """Return how the rotation of a needle ends.

    A needle is an axisymmetric body with its dipole across its long axis. The slow flow leads to
    rotation across the long axis, where chance decides how the body is captured.

    Args:
        rotation: its two larger moments are equal.
        weakness: κL₀/J₃².
        end: the end of the `needle_start` in the limit of small amplitude.
        motion: its slow motion, if the half time of a random phase is wanted at any cost: random
            phases are followed from their entry into the plane on.
        timed: whether it is wanted if it comes before that entry, so that it follows from (4.16);
            else it is NaN.
    """
    # The logarithm of |ω₀|J₃/L₀ leads from |ω∞|/|ω₀| to L∞/L₀.
    shift = jnp.log(jnp.linalg.norm(rotation.momentum / rotation.moments))
    energy = rotation.momentum @ (rotation.momentum / rotation.moments) / 2
    squares = jnp.mean(jnp.exp(2 * (end.capture.log_table + shift)))
    residual = end.along + end.against
    last_energy = jnp.where(residual > 0, residual * squares / 2, 0.0)
    half_time, error = jnp.full_like(energy, jnp.nan), end.capture.error
    if timed or motion is not None:
        delta, omega = needle_start(rotation, weakness)
        q = entry_q(delta, jnp.zeros_like(delta))
        log_square = 2 * (end.log_scale + shift - Expansion(-1.5 * delta / (1 - delta)).log_w(q))
        square = jnp.exp(jnp.where(end.random, log_square, 0.0))
        last = jnp.where(end.random, 2 * last_energy / safe_divisor(square), 0.0)
        half, late = (energy + last_energy) / 2, jnp.zeros_like(error)
        if motion is not None:
            averaging = estimated_error(rotation, motion, weakness)
            clock = clock_of_needle(delta, last)
            half_time, late = clock.time_at(motion, half, averaging, square)
            half_time = or_nan(half_time, ~motion.failed)
        else:
            half_time = time_of_needle(delta, omega / weakness, half / energy)
            half_time = or_nan(half_time, half > BEFORE_ENTRY * square / 2)
        half_time = or_nan(half_time, end.random)
        error += jnp.where(end.random, late, 0.0)
    log_mean = jnp.log(safe_divisor(residual)) + end.capture.log_mean + shift
    zero = jnp.zeros_like(residual)
    ends = {
        Fate.POSITIVE: end.along,
        Fate.NEGATIVE: end.against,
        Fate.AXIS_1: end.symmetry_axis,
        Fate.AXIS_3: end.across,
        Fate.WOBBLING: end.wobbling,
    }
    return SlowEnd(
        jnp.stack([ends.get(fate, zero) for fate in PREDICTED_FATES]),
        jnp.where(residual > 0, log_mean, -jnp.inf),
        end.capture.log_quantiles_of_all() + shift,
        energy,
        last_energy,
        half_time,
        rotation.moments[2],
        jnp.where(residual == 1, 0.0, jnp.nan),
        ~end.random,
        error,
    )


def time_of_needle(delta: Real, omega: Float[Array, "3"], part: Real) -> Real:
    """Return the time at which the energy of a needle has fallen to a part of E₀, by (4.16).

    With u = ω⊥² and v = ω₃², E is proportional to u + (1 − δ)v. Both fall at least as
    ξ^{−(1−δ)/(1+2δ)}, ξ = u/v.
    """
    w1, w2, w3 = omega
    square = w1**2 + w2**2 + w3**2
    orbit = AveragedOrbit(delta, (w1**2 + w2**2) / square, w3**2 / square, prolate=True)

    def energy(x: Real) -> Real:
        point = orbit.point(x)
        return orbit.u * jnp.exp(point.log_u) + (1 - delta) * orbit.v * jnp.exp(point.log_v)

    zero, latest = jnp.zeros_like(part), -1.01 * jnp.log(part) * orbit.a / (1 - delta)
    first = energy(zero)
    x = root(lambda x: part - energy(x) / first, zero, latest, HALVINGS)
    return 2 * mesh(orbit, x)[1][-1] / square


def needle_start(rotation: FreeRotation, weakness: Real) -> tuple[Real, Float[Array, "3"]]:
    """Return the δ of a needle, and its ω₀ in units of 1/τ₀, dipole first and long axis last."""
    long = jnp.array([1.0, 0.0, 0.0])
    frame = jnp.stack([rotation.dipole, jnp.cross(long, rotation.dipole), long])
    omega = frame @ (rotation.momentum / rotation.moments)
    return 1 - rotation.moments[0] / rotation.moments[2], weakness * omega


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
    shares = jnp.stack([1 + sign, 1 - sign]) / 2
    return jnp.concatenate([shares, jnp.zeros(len(PREDICTED_FATES) - 2, sign.dtype)])


def certainty_of(fate: Fate | Int[Array, ""]) -> Float[Array, "8"]:
    """Return the probabilities of an end that is certain."""
    return jax.nn.one_hot(fate, len(PREDICTED_FATES))
