"""The numbers of a prediction: how the slow motion of a body from a start ends, and its history."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.checks import or_nan
from .._base.forward_mode import forward_differentiable
from .._base.guards import safe_divisor
from .._base.types import Outcome, Real, Regime
from .ends import SlowEnd, needle_end, shape, slow_end, sphere_end, spin_end, turns_fast
from .free_rotation import mean_square_speed, period
from .motion import Motion, motion_from
from .principal_axes import FreeRotation, free_rotation
from .slow_flow import from_logit

LARGEST_ERROR = 0.5
"""The estimated error beyond which the slow flow says nothing."""
CERTAIN = 1 - 1e-6
"""The probability from which an outcome counts as decided."""
ERROR = 1.0
"""The estimated error in units of the part of L² that is radiated within one period; measured."""
QUADRATURE = 1e-12
"""The relative error of the quadratures."""


class Forecast(NamedTuple):
    """The numbers of a `Prediction`, in its order."""

    outcome: Int[Array, ""]
    probability: Float[Array, "8"]
    omega_inf: Real
    ratio: Real
    ratio_quantiles: Float[Array, "5"]
    half_time: Real
    radiated_energy: Real
    lifetime: Real
    regime: Int[Array, ""]
    error: Real


@eqx.filter_jit
def forecast(variables: Float[Array, "15"], strength: Real, is_needle: bool | None) -> Forecast:
    """How the free rotation of a body ends; differentiable by its variables.

    Args:
        variables: inertia, dipole and ω₀ in one vector.
        strength: the k of κ = k d².
        is_needle: whether chance may decide, see `needle_end`; None if that is not known.
    """
    values = forward_differentiable(functools.partial(_values, is_needle))(variables, strength)
    probability, quantiles, rest = jnp.split(values, [8, 13])
    omega_inf, ratio, half_time, radiated, lifetime, regime, error = rest
    outcome = decided_outcome(probability, error)
    decided = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    omega_inf = jnp.where(decided, omega_inf, jnp.nan)
    times = half_time, radiated, lifetime
    return Forecast(
        outcome, probability, omega_inf, ratio, quantiles, *times, regime.astype(int), error
    )


def decided_outcome(probability: Float[Array, "*n 8"], error: Real) -> Int[Array, "*n"]:
    """The outcome that has a probability above `CERTAIN`, where the error allows one at all."""
    residual, stop = jnp.sum(probability[..., :2], -1), jnp.sum(probability[..., 2:], -1)
    outcome = jnp.where(residual > CERTAIN, Outcome.RESIDUAL, Outcome.UNDECIDED)
    outcome = jnp.where(stop > CERTAIN, Outcome.STOP, outcome)
    outcome = jnp.where(error > LARGEST_ERROR, Outcome.UNDECIDED, outcome)
    return jnp.where(jnp.isfinite(residual), outcome, Outcome.FAILED).astype(int)


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


def scaled_rotation(variables: Float[Array, "15"], strength: Real) -> tuple[FreeRotation, Units]:
    """The free rotation in units of J₃ and L₀, and these units."""
    inertia, dipole, omega = variables[:9].reshape(3, 3), variables[9:12], variables[12:]
    rotation = free_rotation(inertia, dipole, omega)
    moment = rotation.moments[2]
    momentum = jnp.linalg.norm(rotation.momentum)
    coupling = strength * jnp.sum(dipole**2)
    weakness = coupling / moment * (momentum / moment)
    unit = moment / momentum / (2 * weakness)
    scaled = FreeRotation(rotation.moments / moment, rotation.dipole, rotation.momentum / momentum)
    return scaled, Units(momentum, moment, unit, weakness)


def _slow_motion(rotation: FreeRotation) -> Motion:
    """The slow motion of a body with at least two different moments."""
    high, z = rotation.place
    return motion_from(rotation.side(high), high, z)


def _values(
    is_needle: bool | None, variables: Float[Array, "15"], strength: Real
) -> Float[Array, "20"]:
    """The floating-point fields of a `Prediction`, and its regime."""
    rotation, units = scaled_rotation(variables, strength)
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    motion = _slow_motion(apart)

    def needle() -> SlowEnd:
        return needle_end(apart, motion, units.weakness)

    def other() -> SlowEnd:
        return slow_end(apart, motion)

    if is_needle is None:
        end = jax.lax.cond(apart.is_needle, needle, other)
    else:
        end = needle() if is_needle else other()
    for case, known in ((is_spin, spin_end(rotation, axis)), (is_sphere, sphere_end(rotation))):
        end = jax.tree.map(lambda a, b, case=case: jnp.where(case, a, b), known, end)
    ratio = jnp.exp(end.log_ratio)
    omega_inf = speed_about_dipole(end.probability, ratio, end.last_moment, units)
    log_crossing = motion.stage(0).end.log
    averaging = estimated_error(apart, motion.crosses, log_crossing, units.weakness)
    error = jnp.where(end.known_phase, units.weakness, averaging)
    error = jnp.where(is_sphere | is_spin, units.weakness**2, error)
    energy_unit = units.momentum**2 / units.moment
    rest = (
        omega_inf,
        ratio,
        end.half_time * units.time,
        (end.energy - end.last_energy) * energy_unit,
        jnp.where(end.decay == 0, jnp.inf, units.time / safe_divisor(end.decay)),
        jnp.zeros_like(error),
        error,
    )
    values = jnp.concatenate([end.probability, jnp.exp(end.log_quantiles), jnp.stack(rest)])
    return (
        or_nan(values, ~motion.failed | is_sphere | is_spin)
        .at[-2]
        .set(regime_of(rotation).astype(float))
    )


def speed_about_dipole(
    probability: Float[Array, "8"], ratio: Real, last_moment: Real, units: Units
) -> Real:
    """ω∞: signed, 0 for a stop, NaN where its sign is a matter of chance."""
    residual, sign = probability[0] + probability[1], probability[0] - probability[1]
    speed = units.momentum * ratio / (units.moment * last_moment)
    return jnp.where(residual == 0, 0.0, or_nan(sign * speed, jnp.abs(sign) == 1))


def regime_of(rotation: FreeRotation) -> Int[Array, ""]:
    """The law for a body; a spin about a principal axis has that of its neighbours."""
    j1, j2, j3 = rotation.moments
    regime = jnp.where((j1 == j2) | (j2 == j3), Regime.AVERAGED, Regime.SLOW_FLOW)
    regime = jnp.where(rotation.is_needle, Regime.UNFOLDED, regime)
    return jnp.where(rotation.is_sphere, Regime.EXACT, regime).astype(int)


def estimated_error(
    rotation: FreeRotation, crosses: Bool[Array, ""], log_crossing: Real, weakness: Real
) -> Real:
    """The part of L² that is radiated within one period, which averaging neglects.

    It is the largest at the start, or at the separatrix, whose libration is slow if two moments are
    nearly equal: its rate is L√(Db Dab), and ln(16/(1 − m)) is taken as 10 there.

    Args:
        rotation: where the motion begins.
        crosses: whether it crosses the separatrix.
        log_crossing: ln L²/L₀² there.
        weakness: κL₀/J₃².
    """
    high, z = rotation.place
    side = rotation.side(high)
    x, rest = from_logit(z)
    r, _ = side.rates(x, rest)
    first = r * period(side.moments, x, rest)
    p12, p23, _ = rotation.gaps
    across = (1 - rotation.dipole[1] ** 2) / rotation.moments[1] ** 3
    libration = jnp.sqrt(jnp.where(crosses, p12 * p23, 1.0))
    momentum = jnp.exp(log_crossing / 2)
    crossing = jnp.where(crosses, momentum * across * 4 * 5 / libration, 0.0)
    return ERROR * weakness * jnp.maximum(first, crossing) / jnp.pi + QUADRATURE


@eqx.filter_jit
def history_at(
    variables: Float[Array, "15"], constants: tuple[Float[Array, "T"], Real]
) -> tuple[Float[Array, "T"], ...]:
    """E, |L|, h and √⟨Ω²⟩ at given times."""
    times, strength = constants
    rotation, units = scaled_rotation(variables, strength)
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    motion = _slow_motion(apart)

    def slow(time: Real) -> Float[Array, "3"]:
        point = motion.at(jnp.log(time))
        side = apart.side(point.high)
        h = shape(side, point.x, point.rest)
        values = jnp.stack([point.log, h, mean_square_speed(side.moments, point.x, point.rest)])
        captured = apart.is_needle & ~turns_fast(apart, point, units.weakness)
        return or_nan(values, ~captured & ~motion.failed)

    def spinning(time: Real) -> Float[Array, "3"]:
        moment = rotation.moments[axis]
        log = -jnp.log1p(rotation.spin_decay(axis) * time)
        return jnp.stack([log, 1 / moment, 1 / moment**2])

    def of_sphere(time: Real) -> Float[Array, "3"]:
        square = (rotation.dipole @ rotation.momentum) ** 2
        lost = jnp.where(
            square > 0, -jnp.expm1(-square * time) / jnp.where(square > 0, square, 1.0), time
        )
        across = (1 - square) * jnp.exp(-square * time) / (1 + (1 - square) * lost)
        one = jnp.ones(())
        return jnp.stack([jnp.log(square + across), one, one])

    scaled = times / units.time
    log, h, squared = jnp.where(
        is_sphere,
        jax.vmap(of_sphere)(scaled),
        jnp.where(is_spin, jax.vmap(spinning)(scaled), jax.vmap(slow)(scaled)),
    ).T
    momentum = units.momentum * jnp.exp(log / 2)
    energy = h * momentum * (momentum / units.moment) / 2
    return energy, momentum, h / units.moment, jnp.sqrt(squared) * momentum / units.moment
