"""How the slow motions of many bodies and starts end: the numbers of predictions without times.

Every case costs the same (see `slow_course`), with two exceptions: the capture of needles is
computed once for each δ, and a start whose quadrature is inaccurate is predicted on its own.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.types import Outcome, Real
from .capture import Capture, capture, end_of_top
from .ends import needle_chances, needle_start, slow_probability, sphere_end, spin_end
from .estimates import error_of_phase, estimated_error, start_error
from .forecast import (
    Variables,
    decided_outcome,
    forecast,
    regime_of,
    scaled_rotation,
    speed_about_dipole,
)
from .slow_course import outline

CHUNKS = 64, 1024  # starts computed at once; only two sizes, since each needs a compilation
DOUBT = 1e-6  # estimated error of ln L∞² beyond which a start is predicted on its own


class ManyEnds(NamedTuple):
    """How N motions end; the fields are explained at `Prediction`."""

    outcome: Int[np.ndarray, "N"]
    probability: Float[np.ndarray, "N 8"]
    omega_inf: Float[np.ndarray, "N"]
    ratio: Float[np.ndarray, "N"]
    regime: Int[np.ndarray, "N"]
    error: Float[np.ndarray, "N"]


class _UntimedEnd(NamedTuple):
    """How one motion ends."""

    probability: Float[Array, "8"]
    omega_inf: Real
    ratio: Real
    regime: Int[Array, ""]
    error: Real


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
    for value in np.unique(delta[delta != 0]):
        (lanes,) = np.nonzero(delta == value)
        captured = _in_chunks(
            _needle_ends, variables[lanes], (coupling, _capture(jnp.asarray(value)))
        )
        _put(ends, lanes, captured)
    for lane in np.nonzero(doubtful & (delta == 0))[0]:
        alone = forecast(jnp.asarray(variables[lane]), coupling, False)
        _put(ends, lane, _UntimedEnd(*(getattr(alone, name) for name in _UntimedEnd._fields)))
    outcome = np.asarray(decided_outcome(jnp.asarray(ends.probability), jnp.asarray(ends.error)))
    decided = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    omega_inf = np.where(decided, ends.omega_inf, np.nan)
    return ManyEnds(outcome, ends.probability, omega_inf, ends.ratio, ends.regime, ends.error)


def _in_chunks(function: Any, variables: Float[np.ndarray, "N 15"], constants: Any) -> Any:
    """Apply a vectorised function to chunks of the starts; the last chunk is padded."""
    small, large = CHUNKS
    length = small if len(variables) <= small else large
    count = max(1, -(-len(variables) // length))
    padded = np.resize(variables, (count * length, 15))
    parts = [function(part, constants) for part in np.split(padded, count)]
    return jax.tree.map(lambda *x: np.concatenate(x)[: len(variables)], *parts)


def _put(ends: _UntimedEnd, lanes: Any, values: _UntimedEnd) -> None:
    """Replace the ends of some starts."""
    for array, value in zip(ends, values, strict=True):
        array[lanes] = value


@eqx.filter_jit
@functools.partial(jax.vmap, in_axes=(0, None))
def _slow_ends(variables: Variables, strength: Real) -> tuple[_UntimedEnd, Real, Bool[Array, ""]]:
    """Return the end by the slow flow, δ of a needle or 0, and whether the error is too large."""
    rotation, units = scaled_rotation(variables, strength)
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    leads = outline(apart)
    last = apart.moments[jnp.where(leads.ends_high, 0, 2)]
    end = (
        slow_probability(apart, leads.crosses, leads.ends_high, leads.spins),
        leads.log / 2,
        last,
    )
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        exact = known.probability, known.log_ratio, known.last_moment
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), exact, end)
    probability, log_ratio, last_moment = end
    ratio = jnp.exp(log_ratio)
    error = estimated_error(apart, leads.loss, units.weakness)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error)
    omega_inf = speed_about_dipole(probability, ratio, last_moment, units)
    delta, _ = needle_start(apart, units.weakness)
    doubtful = ~(leads.error < DOUBT) & ~is_sphere & ~is_spin
    end = _UntimedEnd(probability, omega_inf, ratio, regime_of(rotation), error)
    return end, jnp.where(apart.is_needle, delta, 0.0), doubtful


@eqx.filter_jit
@functools.partial(jax.vmap, in_axes=(0, None))
def _needle_ends(variables: Variables, constants: tuple[Real, Capture]) -> _UntimedEnd:
    """Return the end of a needle, given the distribution of its capture."""
    strength, chance = constants
    rotation, units = scaled_rotation(variables, strength)
    delta, omega = needle_start(rotation, units.weakness)
    end = end_of_top(delta, omega, chance)
    probability, log_ratio = needle_chances(rotation, end)
    ratio = jnp.exp(log_ratio)
    omega_inf = speed_about_dipole(probability, ratio, rotation.moments[2], units)
    averaging = start_error(rotation, units.weakness)
    error = jnp.where(end.random, averaging, error_of_phase(rotation, units.weakness))
    return _UntimedEnd(probability, omega_inf, ratio, regime_of(rotation), error)


_capture = eqx.filter_jit(capture)
