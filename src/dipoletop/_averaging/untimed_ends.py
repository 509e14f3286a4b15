"""How the slow motions of many bodies and starts end: the numbers of predictions without times.

Every case costs the same (see `slow_course`), with two exceptions: the capture of needles is
computed once for each δ (to 13 digits), and a start whose quadrature is inaccurate is predicted on
its own.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.compiling import with_special_numbers
from .._base.types import Real
from .capture import Capture, capture_from, computed_at, distribution, end_of_top
from .ends import needle_chances, needle_start, slow_probability, sphere_end, spin_end
from .estimates import error_of_phase, estimated_error, rounding_error, start_error
from .forecast import (
    Units,
    Variables,
    decided,
    forecast,
    regime_of,
    scaled_rotation,
    speed_about_dipole,
)
from .principal_axes import FreeRotation
from .slow_course import outline

CHUNKS = 64, 1024  # starts computed at once; only two sizes, since each needs a compilation
DOUBT = 1e-6  # estimated error of ln L∞² beyond which a start is predicted on its own


class ManyEnds(NamedTuple):
    """How N motions end, in NumPy; in a trace, one motion. For the fields see `Prediction`."""

    outcome: Any
    probability: Any
    omega_inf: Any
    ratio: Any
    regime: Any
    error: Any


@with_special_numbers
def ends_of_many(
    inertia: Float[np.ndarray, "N 3 3"],
    dipole: Float[np.ndarray, "N 3"],
    omega0: Float[np.ndarray, "N 3"],
    strength: float = 1.0,
) -> ManyEnds:
    """Return how N free rotations end.

    Args:
        inertia: inertia tensors.
        dipole: dipoles.
        omega0: initial angular velocities, not zero.
        strength: the k of κ = k d².
    """
    size = len(omega0)
    variables = np.concatenate([np.reshape(inertia, (size, 9)), dipole, omega0], axis=1)
    coupling = jnp.asarray(strength)
    ends, delta, doubtful = _in_chunks(_slow_ends, variables, coupling)
    shared = _nearly(delta)
    for value in np.unique(shared[shared != 0]):
        (lanes,) = np.nonzero(shared == value)
        captured = _in_chunks(_needle_ends, variables[lanes], (coupling, _capture(value)))
        _put(ends, lanes, captured)
    for lane in np.nonzero(doubtful & (delta == 0))[0]:
        alone = forecast(jnp.asarray(variables[lane]), coupling, False)
        _put(ends, lane, ManyEnds(*(getattr(alone, name) for name in ManyEnds._fields)))
    return ends


def _in_chunks(function: Any, variables: Float[np.ndarray, "N 15"], constants: Any) -> Any:
    """Apply a vectorised function to chunks of the starts; the last chunk is padded."""
    small, large = CHUNKS
    length = small if len(variables) <= small else large
    count = max(1, -(-len(variables) // length))
    padded = np.resize(variables, (count * length, 15))
    parts = [function(part, constants) for part in np.split(padded, count)]
    return jax.tree.map(lambda *x: np.concatenate(x)[: len(variables)], *parts)


def _nearly(delta: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Round to 13 digits: bodies in turned axes, whose δ differ by rounding, share a capture."""
    size = 10.0 ** np.floor(np.log10(np.where(delta > 0, delta, 1.0)))
    return np.round(delta / size, 12) * size


def _put(ends: ManyEnds, lanes: Any, values: ManyEnds) -> None:
    """Replace the ends of some starts."""
    for array, value in zip(ends, values, strict=True):
        array[lanes] = value


@eqx.filter_jit
@functools.partial(jax.vmap, in_axes=(0, None))
def _slow_ends(variables: Variables, strength: Real) -> tuple[ManyEnds, Real, Bool[Array, ""]]:
    """Return the end by the slow flow, δ of a needle or 0, and whether the error is too large."""
    rotation, units = scaled_rotation(variables, strength)
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    leads = outline(apart)
    last = apart.moments[jnp.where(leads.ends_high, 0, 2)]
    probability = slow_probability(apart, leads.crosses, leads.ends_high, leads.spins)
    end = probability, leads.log / 2, last
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        exact = known.probability, known.log_ratio, known.last_moment
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), exact, end)
    error = estimated_error(apart, leads.loss, units.weakness)
    error += rounding_error(apart, leads.log / 2)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error) + rotation.left_out
    delta, _ = needle_start(apart, units.weakness)
    doubtful = ~(leads.error < DOUBT) & ~is_sphere & ~is_spin
    return _untimed(rotation, units, end, error), jnp.where(apart.is_needle, delta, 0.0), doubtful


@eqx.filter_jit
@functools.partial(jax.vmap, in_axes=(0, None))
def _needle_ends(variables: Variables, constants: tuple[Real, Capture]) -> ManyEnds:
    """Return the end of a needle, given the distribution of its capture."""
    strength, chance = constants
    rotation, units = scaled_rotation(variables, strength)
    delta, omega = needle_start(rotation, units.weakness)
    end = end_of_top(delta, omega, chance)
    averaging = start_error(rotation, units.weakness)
    error = jnp.where(end.random, averaging, error_of_phase(rotation, units.weakness))
    probability, log_ratio = needle_chances(rotation, end)
    error += rotation.left_out + rounding_error(rotation, log_ratio) + end.capture.error
    return _untimed(rotation, units, (probability, log_ratio, rotation.moments[2]), error)


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


_captured = eqx.filter_jit(capture_from)
_computed = eqx.filter_jit(distribution)
