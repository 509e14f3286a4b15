"""How the slow motions of many bodies and starts end: the numbers of predictions without times.

Every case costs the same (see `slow_course`), with three exceptions: a start whose error is known
to be too large is not followed, the capture of needles is computed once for each δ (to 13 digits),
and a start whose quadrature is inaccurate is predicted on its own.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.compiling import FOR_MANY, compiled_soon, special_numbers
from .._base.parallel import pool
from .._base.types import Outcome, Real
from .capture import Capture, capture_from, computed_at, distribution, end_of_top, is_random
from .ends import needle_chances, needle_start, slow_probability, sphere_end, spin_end
from .estimates import error_of_phase, estimated_error, rounding_error, start_error
from .forecast import (
    LARGEST_ERROR,
    Units,
    Variables,
    decided,
    forecast,
    regime_of,
    scaled_rotation,
    speed_about_dipole,
)
from .principal_axes import FreeRotation
from .slow_course import Course, course
from .slow_flow import Side

CHUNK = 128  # starts computed at once; only one size, since each needs a compilation
DOUBT = 1e-6  # estimated error of ln L∞² beyond which a start is predicted on its own


class ManyEnds(NamedTuple):
    """How N motions end, in NumPy; in a trace, one motion. For the fields see `Prediction`."""

    outcome: Any
    probability: Any
    omega_inf: Any
    ratio: Any
    regime: Any
    error: Any


class _Begin(NamedTuple):
    """A start in the variables of the slow motion."""

    rotation: FreeRotation
    units: Units
    side: Side
    z: Real
    """logit x."""
    high: Bool[Array, "*n"]
    """Whether it begins on the side of the axis of J₁."""
    least_error: Real
    """The least error that the end can have."""


@special_numbers()
def ends_of_many(
    inertia: Float[np.ndarray, "N 3 3"],
    dipole: Float[np.ndarray, "N 3"],
    omega0: Float[np.ndarray, "N 3"],
    strength: float = 1.0,
    threads: int = 1,
) -> ManyEnds:
    """Return how N free rotations end.

    Args:
        inertia: inertia tensors.
        dipole: dipoles.
        omega0: initial angular velocities, not zero.
        strength: the k of κ = k d².
        threads: the number of threads.
    """
    size = len(omega0)
    variables = np.concatenate([np.reshape(inertia, (size, 9)), dipole, omega0], axis=1)
    starts = variables, np.full(size, strength)
    in_chunks = functools.partial(_in_chunks, threads)
    begin = in_chunks(_begin, starts)
    unknown = np.full(size, np.nan)
    ends = ManyEnds(
        outcome=np.full(size, int(Outcome.UNDECIDED)),
        probability=np.full((size, 8), np.nan),
        omega_inf=unknown,
        ratio=unknown.copy(),
        regime=np.zeros(size, int),
        error=begin.least_error,
    )
    lanes = np.flatnonzero(~(begin.least_error > LARGEST_ERROR))
    if lanes.size:
        some = jax.tree.map(lambda x: x[lanes], (begin, starts))
        _put(ends, lanes, _followed(in_chunks, *some))
    return ends


def _followed(in_chunks: Any, begin: _Begin, starts: tuple[np.ndarray, np.ndarray]) -> ManyEnds:
    """Return the ends of starts, by their courses on both sides, and by capture."""
    moments, crossed = begin.side.moments, np.zeros(len(begin.z), bool)
    first = in_chunks(_course, (begin.side, begin.z, crossed))
    crosses = first.rises & ~first.turns & (moments[:, 1] != moments[:, 0])
    second = jax.tree.map(np.zeros_like, first)
    if (lanes := np.flatnonzero(crosses)).size:
        there = jax.tree.map(lambda x: x[lanes], (begin.side, begin.z, crosses))
        _put(second, lanes, in_chunks(_course, there))
    ends, delta, by_chance, doubtful = in_chunks(_slow_ends, (begin, first, second, crosses))
    shared = _nearly(delta)
    for value, random in np.unique(np.stack([shared, by_chance])[:, shared != 0], axis=1).T:
        (lanes,) = np.nonzero((shared == value) & (by_chance == random))
        chance = jax.tree.map(lambda x, n=lanes.size: np.stack([x] * n), _capture(value))
        needles = jax.tree.map(lambda x, lanes=lanes: x[lanes], starts)
        _put(ends, lanes, in_chunks(_needle_ends[bool(random)], (*needles, chance)))
    for lane in np.nonzero(doubtful & (delta == 0))[0]:
        variables, coupling = (jnp.asarray(x[lane]) for x in starts)
        alone = forecast(variables, coupling, False)
        _put(ends, lane, ManyEnds(*(getattr(alone, name) for name in ManyEnds._fields)))
    return ends


def _in_chunks(threads: int, function: Any, arguments: Any) -> Any:
    """Apply a vectorised function to chunks of its arguments; the last chunk is padded."""
    size = len(jax.tree.leaves(arguments)[0])
    count = max(1, -(-size // CHUNK))
    places = np.resize(np.arange(max(size, 1)), (count, CHUNK))

    def part(chosen: Any) -> Any:
        return jax.device_get(function(*jax.tree.map(lambda x: x[chosen], arguments)))

    several = threads > 1 and count > 1
    parts = list(pool(threads).map(part, places) if several else map(part, places))
    return jax.tree.map(lambda *x: np.concatenate(x)[:size], *parts)


def _nearly(delta: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Round to 13 digits: bodies in turned axes, whose δ differ by rounding, share a capture."""
    size = 10.0 ** np.floor(np.log10(np.where(delta > 0, delta, 1.0)))
    return np.round(delta / size, 12) * size


def _put(ends: Any, lanes: Any, values: Any) -> None:
    """Replace the numbers of some starts."""
    for array, value in zip(ends, values, strict=True):
        array[lanes] = value


def _of_lanes(function: Any) -> Any:
    """Return a function of many starts, from a function of one."""
    return compiled_soon(jax.vmap(function), FOR_MANY)


@_of_lanes
def _begin(variables: Variables, strength: Real) -> _Begin:
    """Return where a slow motion begins; an ordinary one in place of a pure spin and a sphere."""
    rotation, units = scaled_rotation(variables, strength)
    apart = rotation.replaced_where(rotation.is_sphere | rotation.spin_axis[0])
    high, z = apart.place
    error, phase = start_error(apart, units.weakness), error_of_phase(apart, units.weakness)
    error = jnp.where(apart.is_needle, jnp.minimum(error, phase), error)
    error = jnp.where(rotation.is_sphere | rotation.spin_axis[0], units.weakness**2, error)
    return _Begin(rotation, units, apart.side(high), z, high, error)


_course = _of_lanes(course)


@_of_lanes
def _slow_ends(
    begin: _Begin, first: Course, second: Course, crosses: Bool[Array, ""]
) -> tuple[ManyEnds, Real, Bool[Array, ""], Bool[Array, ""]]:
    """Return the end by the slow flow, δ and `is_random` of a needle, and a doubt of the error.

    δ is 0 for other bodies.
    """
    rotation, units, _, _, high, _ = begin
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    ends_high = high ^ crosses
    spins = jnp.where(crosses, ~second.turns, ~first.rises & ~first.turns)
    residual = spins & (apart.spin_decay(jnp.where(ends_high, 0, 2)) == 0)
    log = jnp.where(residual, (first.log + second.log) / 2, -jnp.inf)
    last = apart.moments[jnp.where(ends_high, 0, 2)]
    end = slow_probability(apart, crosses, ends_high, spins), log, last
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        exact = known.probability, known.log_ratio, known.last_moment
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), exact, end)
    # If a zero of F lies beyond the separatrix, `first.loss` also stands for the way to that zero.
    later = jnp.where(crosses & spins, second.loss * jnp.exp(first.log / 2), 0.0)
    error = estimated_error(apart, jnp.maximum(first.loss, later), units.weakness)
    error += rounding_error(apart, log)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error) + rotation.left_out
    delta, omega = needle_start(apart, units.weakness)
    needle = jnp.where(apart.is_needle, delta, 0.0), is_random(delta, omega)
    doubtful = residual & ~(first.error + second.error < DOUBT) & ~is_sphere & ~is_spin
    return _untimed(rotation, units, end, error), *needle, doubtful


def _needle_end(by_chance: bool, variables: Variables, strength: Real, chance: Capture) -> ManyEnds:
    """Return the end of a needle, given the distribution of its capture."""
    rotation, units = scaled_rotation(variables, strength)
    delta, omega = needle_start(rotation, units.weakness)
    end = end_of_top(delta, omega, chance, by_chance=by_chance)
    averaging = start_error(rotation, units.weakness)
    error = jnp.where(end.random, averaging, error_of_phase(rotation, units.weakness))
    probability, log_ratio = needle_chances(rotation, end)
    error += rotation.left_out + rounding_error(rotation, log_ratio) + end.capture.error
    return _untimed(rotation, units, (probability, log_ratio, rotation.moments[2]), error)


_needle_ends: list[Any] = [
    _of_lanes(functools.partial(_needle_end, by_chance)) for by_chance in (False, True)
]


def _untimed(
    rotation: FreeRotation, units: Units, end: tuple[Array, Real, Real], error: Real
) -> ManyEnds:
    """Return an end, given its probabilities, ln L∞/L₀ and the last moment."""
    probability, log_ratio, last_moment = end
    ratio = jnp.exp(log_ratio)
    omega_inf = speed_about_dipole(probability, ratio, last_moment, units)
    outcome, omega_inf = decided(probability, omega_inf, error)
    return ManyEnds(outcome, probability, omega_inf, ratio, regime_of(rotation), error)


def _capture(delta: float) -> Capture:
    """Return the capture of a given δ; what it is computed from is kept for the process."""
    points, _ = computed_at(delta, np)
    found = np.stack([_distribution(float(point)) for point in np.broadcast_to(points, 4)])
    return _captured(jnp.asarray(delta), jnp.asarray(found))


@functools.lru_cache(maxsize=1024)
def _distribution(delta: float) -> np.ndarray:
    return np.asarray(_computed(jnp.asarray(delta)))


_captured = compiled_soon(capture_from)
_computed = compiled_soon(distribution)
