"""The numbers of a prediction, in the units of the body."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.checks import or_nan
from .._base.guards import safe_divisor
from .._base.types import RESIDUAL_FATES, STOP_FATES, Fate, Outcome, Real, Regime
from .ends import SlowEnd, sphere_end, spin_end
from .estimates import error_of_phase, rounding_error
from .principal_axes import FreeRotation, free_rotation

Variables = Float[Array, "15"]
"""Inertia, dipole and ω₀ in one vector."""

LARGEST_ERROR = 0.5
"""The estimated error beyond which the outcome is undecided."""
CERTAIN = 1 - 1e-6
"""The probability from which an outcome counts as decided."""


class End(eqx.Module):
    """How one rotation ends, in JAX, or many, in NumPy; `dipoletop.Prediction` names the fields."""

    outcome: Int[Array | np.ndarray, "*batch"]
    probability: Float[Array | np.ndarray, "*batch 8"]
    omega_inf: Float[Array | np.ndarray, "*batch"]
    ratio: Float[Array | np.ndarray, "*batch"]
    ratio_quantiles: Float[Array | np.ndarray, "*batch 5"]
    half_time: Float[Array | np.ndarray, "*batch"]
    radiated_energy: Float[Array | np.ndarray, "*batch"]
    lifetime: Float[Array | np.ndarray, "*batch"]
    regime: Int[Array | np.ndarray, "*batch"]
    error: Float[Array | np.ndarray, "*batch"]


def fields_of(values: Float[Array, "20"]) -> End:
    """Return an end from its numbers in one vector."""
    return end_from(separate(values))


def separate(values: Float[Array, "20"]) -> list[Array]:
    """Divide the numbers of an end.

    Derivatives that are NaN, as of an ω∞ that chance decides, then reach no other number.
    """
    probability, quantiles, rest = jnp.split(values, [8, 13])
    return [probability, quantiles, *rest]


def end_from(numbers: list[Array]) -> End:
    """Return an end from its separate numbers."""
    probability, quantiles, *rest = numbers
    omega_inf, ratio, half_time, radiated, lifetime, regime, error = rest
    outcome, omega_inf = decided(probability, omega_inf, error)
    late = half_time, radiated, lifetime, regime.astype(int), error
    return End(outcome, probability, omega_inf, ratio, quantiles, *late)


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


class Start(NamedTuple):
    """A rotation at its start."""

    variables: Variables
    strength: Real
    """The k of κ = k d²."""

    @property
    def parts(self) -> tuple[Float[Array, "3 3"], Float[Array, "3"], Float[Array, "3"]]:
        """Inertia, dipole and ω₀."""
        inertia, dipole, omega = self.variables[:9], self.variables[9:12], self.variables[12:]
        return inertia.reshape(3, 3), dipole, omega


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
    inertia, dipole, omega = Start(variables, strength).parts
    rotation = free_rotation(inertia, dipole, omega)
    moment = rotation.moments[2]
    momentum = jnp.linalg.norm(rotation.momentum)
    coupling = strength * jnp.sum(dipole**2)
    weakness = coupling / moment * (momentum / moment)
    unit = moment / momentum / (2 * weakness)
    moments, unit_momentum = rotation.moments / moment, rotation.momentum / momentum
    scaled = dataclasses.replace(rotation, moments=moments, momentum=unit_momentum)
    return scaled.tipped(weakness), Units(momentum, moment, unit, weakness)


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
        averaging: the error of the averages for that; not used for a known phase.
    """
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = ordinary(rotation)
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), known, end)
    error = jnp.where(end.known_phase, error_of_phase(apart, units.weakness), averaging)
    error += rounding_error(apart, end.log_ratio)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error) + rotation.left_out + end.error
    values = numbers_in_units(end, units, error)
    known = jnp.isfinite(values[0])
    return or_nan(values, known).at[-2].set(_regime_of(rotation).astype(float))


def numbers_in_units(end: SlowEnd, units: Units, error: Real) -> Float[Array, "20"]:
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
