"""How the slow motions of many bodies and starts end: the numbers of predictions without times.

A start whose error is known to be too large is not followed, nor is one on the other side of the
separatrix that does not get there. The capture of needles is computed once for each δ (to 13
digits).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.compiling import FOR_MANY, compiled_soon, special_numbers
from .._base.parallel import pool
from .._base.types import Outcome, Real, Regime
from .capture import is_random, known_capture
from .ends import needle_start, slow_end
from .estimates import error_of_phase, estimated_error, start_error
from .laws import Needle, end_of_needle
from .motion import SlowMotion
from .predicted_ends import (
    LARGEST_ERROR,
    End,
    Units,
    Variables,
    fields_of,
    numbers_of,
    ordinary,
    scaled_rotation,
)
from .principal_axes import FreeRotation
from .slow_flow import Side
from .stages import Stage, State, crosses_over, stage_from

CHUNK = 128  # starts computed at once; only one size, since each needs a compilation
FEW = 8  # the same for needles of known phase: few are predicted, and one may be slow


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
    delta: Real
    """The δ of a needle."""
    needle: Int[Array, "*n"]
    """What is known of a start: the number of a member of `Needle`."""


@special_numbers()
def ends_of_many(
    inertia: Float[np.ndarray, "N 3 3"],
    dipole: Float[np.ndarray, "N 3"],
    omega0: Float[np.ndarray, "N 3"],
    *,
    wanted: Bool[np.ndarray, "N"] | None = None,
    threads: int = 1,
) -> End:
    """Return how N free rotations end, in NumPy, for k = 1; the times are NaN.

    Args:
        inertia: inertia tensors.
        dipole: dipoles.
        omega0: initial angular velocities, not zero.
        wanted: which ends are wanted; the error of the others is infinite. None means all.
        threads: the number of threads.
    """
    starts = _starts(inertia, dipole, omega0)
    in_chunks = functools.partial(_in_chunks, threads)
    begin = in_chunks(_begin, starts)
    wanted = np.ones(len(omega0), bool) if wanted is None else wanted
    ends = unknown_ends(np.where(wanted, begin.least_error, np.inf))
    # One law for each start, chosen before any is followed.
    law = np.where(ends.error > LARGEST_ERROR, 0, begin.needle)
    for needle, ends_by in (
        (Needle.NO, _ends_by_slow_flow),
        (Needle.OF_KNOWN_PHASE, _ends_of_phases),
        (Needle.BY_CHANCE, _ends_by_chance),
    ):
        if (lanes := np.flatnonzero(law == needle.value)).size:
            some = jax.tree.map(lambda x: x[lanes], (starts, begin))
            put_ends(ends, lanes, ends_by(in_chunks, *some))
    return ends


@special_numbers()
def least_errors(
    inertia: Float[np.ndarray, "N 3 3"],
    dipole: Float[np.ndarray, "N 3"],
    omega0: Float[np.ndarray, "N 3"],
) -> Float[np.ndarray, "N"]:
    """Return the least errors that the ends of free rotations can have, for k = 1."""
    return _in_chunks(1, _begin, _starts(inertia, dipole, omega0)).least_error


def _starts(inertia: Any, dipole: Any, omega0: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return inertia, dipole and ω₀ in one vector, and k = 1, of each start."""
    size = len(omega0)
    variables = [np.reshape(inertia, (size, 9)), dipole, omega0]
    return np.concatenate(variables, axis=1), np.ones(size)


def unknown_ends(error: Float[np.ndarray, "N"]) -> End:
    """Return N ends of which nothing but the error is known."""

    def unknown(*shape: int) -> Float[np.ndarray, "..."]:
        return np.full((error.size, *shape), np.nan)

    outcome, regime = (
        np.full(error.size, word.value) for word in (Outcome.UNDECIDED, Regime.RESOLVED)
    )
    numbers = unknown(8), unknown(), unknown(), unknown(5), unknown(), unknown(), unknown()
    return End(outcome, *numbers, regime, error)


def _ends_by_slow_flow(in_chunks: Any, starts: Any, begin: _Begin) -> End:
    """Return the ends of starts that are no needles, by their motion on both sides."""
    still: Any = State(*np.zeros((2, len(begin.z))))  # pyright: ignore[reportArgumentType]
    no = np.zeros(len(begin.z), bool)
    first = in_chunks(_stage, (begin.side, begin.z, still, ~no, no))
    second, crosses = jax.tree.map(np.zeros_like, first), crosses_over(first)
    if (lanes := np.flatnonzero(crosses)).size:
        there = begin.side, begin.z, first.end, crosses, crosses
        there = jax.tree.map(lambda x: x[lanes], there)
        put_ends(second, lanes, in_chunks(_stage, there))
    return in_chunks(_slow_ends, (begin, first, second, crosses))


def _ends_of_phases(in_chunks: Any, starts: Any, begin: _Begin) -> End:
    """Return the ends of needles whose phase is known."""
    return in_chunks(_ends_of_needles, (*starts, None), FEW)


def _ends_by_chance(in_chunks: Any, starts: Any, begin: _Begin) -> End:
    """Return the ends of needles whose phase is random, with one capture for each δ."""
    shared, places = np.unique(_nearly(begin.delta), return_inverse=True)
    chances = jax.tree.map(lambda *x: np.stack(x)[places], *map(known_capture, shared))
    return in_chunks(_ends_of_needles, (*starts, chances))


def _in_chunks(threads: int, function: Any, arguments: Any, chunk: int = CHUNK) -> Any:
    """Apply a vectorised function to chunks of its arguments; the last chunk is padded."""
    size = len(jax.tree.leaves(arguments)[0])
    count = max(1, -(-size // chunk))
    places = np.resize(np.arange(max(size, 1)), (count, chunk))

    def part(chosen: Any) -> Any:
        return jax.tree.map(np.asarray, function(*jax.tree.map(lambda x: x[chosen], arguments)))

    several = threads > 1 and count > 1
    parts = list(pool(threads).map(part, places) if several else map(part, places))
    return jax.tree.map(lambda *x: np.concatenate(x)[:size], *parts)


def _nearly(delta: Any) -> Float[np.ndarray, "N"]:
    """Round to 13 digits: bodies in turned axes, whose δ differ by rounding, share a capture."""
    size = 10.0 ** np.floor(np.log10(np.where(delta > 0, delta, 1.0)))
    return np.round(delta / size, 12) * size


def put_ends(ends: Any, lanes: Any, values: Any) -> None:
    """Replace the numbers of some starts."""
    for array, value in zip(*map(jax.tree.leaves, (ends, values)), strict=True):
        array[lanes] = value


def _of_lanes(function: Any) -> Any:
    """Return a function of many starts, from a function of one."""
    return compiled_soon(jax.vmap(function), FOR_MANY)


@_of_lanes
def _begin(variables: Variables, strength: Real) -> _Begin:
    """Return where a slow motion begins; an ordinary one in place of a pure spin and a sphere."""
    rotation, units = scaled_rotation(variables, strength)
    apart = ordinary(rotation)
    high, z = apart.place
    error, phase = start_error(apart, units.weakness), error_of_phase(apart, units.weakness)
    error = jnp.where(apart.is_needle, jnp.minimum(error, phase), error)
    error = jnp.where(rotation.is_sphere | rotation.spin_axis[0], units.weakness**2, error)
    delta, omega = needle_start(apart, units.weakness)
    phase = jnp.where(is_random(delta, omega), Needle.BY_CHANCE.value, Needle.OF_KNOWN_PHASE.value)
    needle = jnp.where(apart.is_needle, phase, Needle.NO.value)
    return _Begin(rotation, units, apart.side(high), z, high, error, delta, needle)


_stage = _of_lanes(functools.partial(stage_from, timed=False))


@_of_lanes
def _slow_ends(begin: _Begin, first: Stage, second: Stage, crosses: Bool[Array, ""]) -> End:
    """Return the end by the slow flow."""
    rotation, units, high = begin.rotation, begin.units, begin.high
    apart = ordinary(rotation)
    stages = jax.tree.map(lambda *x: jnp.stack(x), first, second)
    motion = SlowMotion(high, stages, crosses)
    averaging = estimated_error(apart, motion, units.weakness)
    return fields_of(numbers_of(rotation, units, slow_end(apart, motion), averaging))


_ends_of_needles: Any = _of_lanes(end_of_needle)
