"""The numbers of a prediction: how the slow motion of a body from a start ends, and its history."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.checks import concrete, or_nan
from .._base.compiling import compiled_soon, special_numbers
from .._base.forward_mode import forward_differentiable
from .._base.guards import safe_divisor
from .._base.types import RESIDUAL_FATES, STOP_FATES, Fate, Outcome, Real, Regime
from .capture import LARGEST, SMALLEST, capture
from .ends import SlowEnd, needle_end, needle_start, slow_end, sphere_end, spin_end
from .estimates import (
    error_at,
    error_of_phase,
    estimated_error,
    rounding_error,
    start_error,
)
from .motion import slow_motion
from .principal_axes import FreeRotation, free_rotation
from .unfolded_ends import captured_end, half_time_of, known_end, order_error
from .unfolding import LARGEST as FARTHEST_RATIO
from .unfolding import PlanarMotion, asymmetry_at_entry, entry_of, top_of

Variables = Float[Array, "15"]
"""Inertia, dipole and ω₀ in one vector."""

LARGEST_ERROR = 0.5
"""The estimated error beyond which the outcome is undecided."""
CERTAIN = 1 - 1e-6
"""The probability from which an outcome counts as decided."""


class Forecast(NamedTuple):
    """The numbers of a `Prediction`, in its order: of one motion in JAX, of many in NumPy."""

    outcome: Any
    probability: Any
    omega_inf: Any
    ratio: Any
    ratio_quantiles: Any
    half_time: Any
    radiated_energy: Any
    lifetime: Any
    regime: Any
    error: Any


@compiled_soon
def forecast(variables: Variables, strength: Real, is_needle: bool | None) -> Forecast:
    """Return how the free rotation of a body ends; differentiable by its variables.

    Args:
        variables: inertia, dipole and ω₀ in one vector.
        strength: the k of κ = k d².
        is_needle: whether the body is a needle (`needle_end`); None if that is not known.
    """
    of_start = functools.partial(_values, is_needle)
    values = forward_differentiable(of_start, one_by_one=True)(variables, strength)
    return fields_of(values)


def fields_of(values: Float[Array, "20"]) -> Forecast:
    """Return a forecast from its numbers in one vector."""
    probability, quantiles, rest = jnp.split(values, [8, 13])
    omega_inf, ratio, half_time, radiated, lifetime, regime, error = rest
    outcome, omega_inf = decided(probability, omega_inf, error)
    late = half_time, radiated, lifetime, regime.astype(int), error
    return Forecast(outcome, probability, omega_inf, ratio, quantiles, *late)


def decided(
    probability: Float[Array, "8"], omega_inf: Real, error: Real
) -> tuple[Int[Array, ""], Real]:
    """Return the outcome with a probability above `CERTAIN`, unless the error is large, and ω∞."""
    residual, stop = jnp.sum(probability[RESIDUAL_FATES]), jnp.sum(probability[STOP_FATES])
    outcome = jnp.where(residual > CERTAIN, Outcome.RESIDUAL, Outcome.UNDECIDED)
    outcome = jnp.where(stop > CERTAIN, Outcome.STOP, outcome)
    outcome = jnp.where(error > LARGEST_ERROR, Outcome.UNDECIDED, outcome)
    outcome = jnp.where(jnp.isfinite(residual), outcome, Outcome.FAILED).astype(int)
    return outcome, jnp.where(outcome > Outcome.UNDECIDED, omega_inf, jnp.nan)


class Units(NamedTuple):
    """The units of the slow motion."""

    momentum: Real
    """L₀."""
    moment: Real
    """J₃."""
    time: Real
    """J₃³/(2κL₀²)."""
    weakness: Real
    """κL₀/J₃², about τ₀Ω."""


def scaled_rotation(variables: Variables, strength: Real) -> tuple[FreeRotation, Units]:
    """Return the free rotation in units of J₃ and L₀, and these units."""
    inertia, dipole, omega = variables[:9].reshape(3, 3), variables[9:12], variables[12:]
    rotation = free_rotation(inertia, dipole, omega)
    moment = rotation.moments[2]
    momentum = jnp.linalg.norm(rotation.momentum)
    coupling = strength * jnp.sum(dipole**2)
    weakness = coupling / moment * (momentum / moment)
    unit = moment / momentum / (2 * weakness)
    moments, unit_momentum = rotation.moments / moment, rotation.momentum / momentum
    scaled = dataclasses.replace(rotation, moments=moments, momentum=unit_momentum)
    return scaled.tipped(weakness), Units(momentum, moment, unit, weakness)


def _values(is_needle: bool | None, variables: Variables, strength: Real) -> Float[Array, "20"]:
    """Return the floating-point fields of a `Prediction`, and its regime."""
    rotation, units = scaled_rotation(variables, strength)
    apart = ordinary(rotation)
    motion = slow_motion(apart)

    def needle() -> SlowEnd:
        delta, _ = needle_start(apart, units.weakness)
        return needle_end(apart, units.weakness, capture(delta), motion)

    other = functools.partial(slow_end, apart, motion)
    if is_needle is None:
        end = jax.lax.cond(apart.is_needle, needle, other)
    else:
        end = needle() if is_needle else other()
    return numbers_of(rotation, units, end, estimated_error(apart, motion, units.weakness))


def ordinary(rotation: FreeRotation) -> FreeRotation:
    """Return a rotation, or another one in place of a pure spin and that of a sphere."""
    return rotation.replaced_where(rotation.is_sphere | rotation.spin_axis[0])


def numbers_of(
    rotation: FreeRotation, units: Units, end: SlowEnd, averaging: Real
) -> Float[Array, "20"]:
    """Return the numbers of a prediction in one vector.

    Args:
        rotation: where the motion begins.
        units: its units.
        end: the end of `ordinary` of the rotation.
        averaging: the error of the averages for that.
    """
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = ordinary(rotation)
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), known, end)
    error = jnp.where(end.known_phase, error_of_phase(apart, units.weakness), averaging)
    error += rounding_error(apart, end.log_ratio)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error) + rotation.left_out + end.error
    values = _numbers(end, units, error)
    known = jnp.isfinite(values[0])
    return or_nan(values, known).at[-2].set(_regime_of(rotation).astype(float))


def _numbers(end: SlowEnd, units: Units, error: Real) -> Float[Array, "20"]:
    """Return the floating-point fields of a `Prediction`, with 0 in place of its regime."""
    ratio = jnp.exp(end.log_ratio)
    omega_inf = _speed_about_dipole(end.probability, ratio, end.last_moment, units)
    energy_unit = units.momentum**2 / units.moment
    rest = (
        omega_inf,
        ratio,
        end.half_time * units.time,
        # Not below 0 by rounding, where nothing is radiated.
        jnp.maximum(end.energy - end.last_energy, 0.0) * energy_unit,
        jnp.where(end.decay == 0, jnp.inf, units.time / safe_divisor(end.decay)),
        jnp.zeros_like(error),
        error,
    )
    return jnp.concatenate([end.probability, jnp.exp(end.log_quantiles), jnp.stack(rest)])


def _speed_about_dipole(
    probability: Float[Array, "8"], ratio: Real, last_moment: Real, units: Units
) -> Real:
    """Return ω∞: signed, 0 for a stop, NaN where chance decides its sign."""
    along, against = probability[Fate.POSITIVE], probability[Fate.NEGATIVE]
    residual, sign = along + against, along - against
    speed = units.momentum * ratio / (units.moment * last_moment)
    return jnp.where(residual == 0, 0.0, or_nan(sign * speed, jnp.abs(sign) == 1))


def _regime_of(rotation: FreeRotation) -> Int[Array, ""]:
    """Return the regime of a body; a spin about a principal axis has that of its neighbours."""
    j1, j2, j3 = rotation.moments
    regime = jnp.where((j1 == j2) | (j2 == j3), Regime.AVERAGED, Regime.SLOW_FLOW)
    regime = jnp.where(rotation.is_needle, Regime.UNFOLDED, regime)
    return jnp.where(rotation.is_sphere, Regime.EXACT, regime).astype(int)


@special_numbers()
def best_forecast(variables: Variables, strength: Real, is_needle: bool | None) -> Forecast:
    """Return the forecast by the slow flow or by the unfolded system, whose error is smaller.

    The unfolded system takes many steps, so it is considered for concrete values only.
    """
    slow = forecast(variables, strength, is_needle)
    if not concrete(slow):
        return slow
    moments = np.linalg.eigvalsh(np.asarray(variables)[:9].reshape(3, 3))
    # The smallest relative gap of moments is below any error of the unfolded system.
    if np.min(np.diff(moments)) / moments[2] > float(slow.error):
        return slow
    turns, errors = coverage(variables, strength)
    place = int(jnp.argmin(errors))
    axial, turning = 2 * place, bool(turns[place])
    if is_needle:  # `needle_end` is as accurate, but gives no half time of a known phase
        half_time = slow.half_time if turning else half_time_from(variables, strength, slow.ratio)
        return slow._replace(half_time=half_time)
    if not errors[place] < slow.error:
        return slow
    unfolded = unfolded_forecast(variables, strength, axial, turning)
    return unfolded if unfolded.error < slow.error else slow


@compiled_soon
def coverage(variables: Variables, strength: Real) -> tuple[Bool[Array, "2"], Float[Array, "2"]]:
    """Return whether a body turns fast, and the error of the unfolded system for it.

    Returns:
        Both with axis 0 and with axis 2 as its symmetry axis. The error is infinite where the
        system does not apply. For fast rotation it is a lower bound: part of it is known later.
    """
    rotation, units = scaled_rotation(variables, strength)
    each = [_coverage(rotation, axial, units.weakness) for axial in (0, 2)]
    return jax.tree.map(lambda *x: jnp.stack(x), *each)


def _coverage(rotation: FreeRotation, axial: int, weakness: Real) -> tuple[Bool[Array, ""], Real]:
    n, top = rotation.dipole, top_of(rotation, axial, weakness)
    is_spin, _ = rotation.spin_axis
    across = (n[axial] == 0) & ((n[1] == 0) | (n[2 - axial] == 0) | (top.eta == 0))
    d = top.delta
    shaped = (jnp.abs(d) >= SMALLEST) & (jnp.abs(d) <= LARGEST) & (jnp.abs(top.eta) < jnp.abs(d))
    moves = ~is_spin & jnp.any(top.omega[:2] != 0)
    turns = PlanarMotion(d, top.ratio).turns(top.start)
    error = order_error(top, jnp.where(turns, -jnp.inf, top.log_u))
    covered = across & shaped & moves & ~(turns & (d < 0))
    asymmetry = jnp.where(turns, asymmetry_at_entry(top), top.ratio)
    covered = covered & (jnp.abs(asymmetry) < FARTHEST_RATIO)
    return turns, jnp.where(covered, error, jnp.inf)


@compiled_soon
def half_time_from(variables: Variables, strength: Real, ratio: Real) -> Real:
    """Return the half time of a needle whose phase and L∞/L₀ are known."""
    rotation, units = scaled_rotation(variables, strength)
    top = top_of(rotation, 0, units.weakness)
    energy = rotation.momentum**2 @ (0.5 / rotation.moments)
    part = ratio**2 / (2 * top.moment) / energy
    return half_time_of(top, part, jnp.zeros(3)) * units.time


@compiled_soon
def unfolded_forecast(variables: Variables, strength: Real, axial: int, turns: bool) -> Forecast:
    """Return how a nearly axisymmetric body ends, by its unfolded system.

    Args:
        variables: inertia, dipole and ω₀ in one vector.
        strength: the k of κ = k d².
        axial: the principal axis, 0 or 2, that counts as the symmetry axis.
        turns: whether the start turns fast about it.
    """
    rotation, units = scaled_rotation(variables, strength)
    top = top_of(rotation, axial, units.weakness)
    if turns:
        motion = slow_motion(rotation)
        end, error = captured_end(rotation, motion, top)
        error += start_error(rotation, units.weakness)
        log_time, *_ = entry_of(rotation, motion, top)
        slow = motion.at(jnp.minimum(jnp.log(end.half_time), log_time))
        error += error_at(rotation, slow, units.weakness)
    else:
        end, error = known_end(rotation, top)
    error += rotation.left_out + rounding_error(rotation, end.log_ratio)
    return fields_of(_numbers(end, units, error).at[-2].set(float(Regime.UNFOLDED)))
