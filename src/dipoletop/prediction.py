"""The future of real particles, which turn far too often to follow every turn.

A particle of a laboratory has τ₀Ω ~ 1e-25 … 1e-17 and makes 1e17 … 1e25 turns while it brakes. Its
energy and its angular momentum hardly change during one turn, so they follow the averages over
free rotation (`_averaging`). `predict` follows this slow flow from a start to its end, at a cost
that does not depend on the amplitude.

Errors: averaging neglects relative changes of E and L within one period, of the order of τ₀Ω over
the relative difference of the moments. `Prediction.error` estimates it.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ._averaging.ends import ENDS as ENDS
from ._averaging.ends import QUANTILES as QUANTILES
from ._averaging.ends import (
    SlowEnd,
    needle_end,
    shape,
    slow_end,
    sphere_end,
    spin_end,
    turns_fast,
)
from ._averaging.free_rotation import mean_square_speed, period
from ._averaging.motion import Motion, motion_from
from ._averaging.principal_axes import FreeRotation, free_rotation
from ._averaging.slow_flow import from_logit
from ._base.checks import ArrayLike, concrete, described, finite, or_nan, refuse, where_valid
from ._base.forward_mode import forward_differentiable
from ._base.guards import safe_divisor
from ._base.summaries import with_error
from ._base.types import Outcome, Real, Regime
from .bodies import Body
from .particles import RADIATION, Particle

LARGEST_ERROR = 0.5
"""The estimated error beyond which the slow flow says nothing."""
FASTEST_RIM = 0.1
"""The largest speed of a point of a particle, over that of light."""
CERTAIN = 1 - 1e-6
"""The probability from which an outcome counts as decided."""
ERROR = 1.0
"""The estimated error in units of the part of L² that is radiated within one period; measured."""
QUADRATURE = 1e-12
"""The relative error of the quadratures."""


class History(NamedTuple):
    """The motion at given times, averaged over one free rotation."""

    times: Float[Array, "T"]
    energy: Float[Array, "T"]
    """E."""
    momentum: Float[Array, "T"]
    """|L|."""
    shape: Float[Array, "T"]
    """h = 2E/L², between the reciprocals of the largest and of the smallest moment."""
    speed: Float[Array, "T"]
    """√⟨Ω²⟩."""


class Prediction(eqx.Module):
    """How a rotation ends, and how long that takes.

    Quantities are dimensionless for a `Body`, and in SI units for a `Particle`.

    Attributes:
        outcome: a member of `Outcome`: RESIDUAL or STOP, where the ends of that kind have together
            a probability above 1 − 1e-6, else UNDECIDED, as where `error` exceeds 0.5; FAILED where
            the argument is not a number.
        probability: of each of the `ENDS`, shape (8,).
        omega_inf: ω∞ along the dipole, signed; 0 for a stop, NaN where its sign is a matter of
            chance or the outcome is undecided.
        ratio: L∞/L₀, the mean over chance.
        ratio_quantiles: the `QUANTILES` of L∞/L₀, shape (5,).
        half_time: the time after which E − E∞ has fallen to one half; NaN for an exactly
            axisymmetric needle whose capture begins before that.
        radiated_energy: E₀ − E∞.
        lifetime: how long the last rotation lives: its late law is L² = L²ₚ/(1 + t/lifetime);
            infinite for residual rotation, NaN where chance decides.
        regime: a member of `Regime`, the law that decided.
        error: estimated relative error of `ratio` and of the times.
    """

    outcome: Int[Array, "*batch"]
    probability: Float[Array, "*batch 8"]
    omega_inf: Float[Array, "*batch"]
    ratio: Float[Array, "*batch"]
    ratio_quantiles: Float[Array, "*batch 5"]
    half_time: Float[Array, "*batch"]
    radiated_energy: Float[Array, "*batch"]
    lifetime: Float[Array, "*batch"]
    regime: Int[Array, "*batch"]
    error: Float[Array, "*batch"]
    variables: Float[Array, "*batch 15"] = eqx.field(repr=False)
    """Inertia, dipole and ω₀, in one vector."""
    strength: float = eqx.field(static=True)
    """The k of κ = k d²: 1 for a `Body`."""

    def history(self, times: ArrayLike) -> History:
        """Energy, angular momentum and speed at given times.

        Args:
            times: positive, shape (T,), in units of the body's time, or seconds for a `Particle`.

        Returns:
            A `History`, each field of shape (T,). NaN for an exactly axisymmetric needle from the
            time on at which its capture begins, since that is a matter of chance.

        Raises:
            ValueError: times that are not positive and finite.
        """
        given = finite("times", times, (-1,), batch=False)
        given = where_valid("times", given, given > 0, "be positive")
        values = _history(self.variables, (given, jnp.asarray(self.strength, given.dtype)))
        return History(given, *values)

    def __repr__(self) -> str:
        """The numbers of a single prediction."""
        if self.outcome.ndim or not concrete(self.outcome):
            return eqx.tree_pformat(self)
        unit = ("", "", "") if self.strength == 1.0 else (" rad/s", " s", " J")
        ends = (f"{p:.3g} {end}" for p, end in zip(self.probability, ENDS, strict=True) if p > 0)
        shown = [
            Outcome(int(self.outcome)).name,
            f"ends: {', '.join(ends)}",
            f"ratio={with_error(float(self.ratio), float(self.error * self.ratio))}",
            f"omega_inf={float(self.omega_inf):.6g}{unit[0]}",
            f"half_time={float(self.half_time):.6g}{unit[1]}",
            f"lifetime={float(self.lifetime):.6g}{unit[1]}",
            f"radiated_energy={float(self.radiated_energy):.6g}{unit[2]}",
            Regime(int(self.regime)).name,
        ]
        return f"Prediction({'; '.join(shown)})"


def predict(body: Body | Particle, omega0: ArrayLike) -> Prediction:
    """How a free rotation that radiates weakly ends: the slow flow of E and L to its end.

        dE/dt = −κ⟨|n₂|²⟩,   d(L²)/dt = −2κ⟨L·(n₁×n₂)⟩,   averaged over free rotation,

    with n₁, n₂ the derivatives of the dipole's direction n in space. May be jitted, vmapped, and
    differentiated with respect to the inertia, the dipole and ω₀.

    Args:
        body: a `Body` (dimensionless), or a `Particle` (SI).
        omega0: initial angular velocity in body axes, shape (3,), not zero; dimensionless, or in
            rad/s for a `Particle`.

    Returns:
        A `Prediction`.

    Raises:
        ValueError: bad arguments; float64 is off; a rotation so fast that averaging or
            non-relativistic mechanics ends. Where ω₀ is traced, the former is UNDECIDED, and the
            latter is not looked for.

    Example:
        >>> import dipoletop as dt
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [0, 0, 1])
        >>> prediction = dt.predict(body, [1e-20, 2e-20, 3e-20])
        >>> dt.Outcome(int(prediction.outcome)).name, f"{prediction.ratio:.6f}"
        ('RESIDUAL', '0.912825')
    """
    if not isinstance(body, Body | Particle):
        refuse("body", "be a Body or a Particle", described(body))
    if body.inertia.ndim != 2:
        refuse("body", "be a single one (`jax.vmap` takes a batch)", "is a batch of them")
    omega = finite("omega0", omega0, (3,), batch=False)
    if omega.dtype != jnp.float64:
        hint = 'jax.config.update("jax_enable_x64", True) switches float64 on'
        refuse("omega0", "be float64", f"is {omega.dtype} ({hint})")
    omega = where_valid("omega0", omega, jnp.any(omega != 0), "not be zero")
    strength = RADIATION if isinstance(body, Particle) else 1.0
    coupling = jnp.asarray(strength, omega.dtype)
    variables = jnp.concatenate([body.inertia.ravel(), body.dipole, omega])
    numbers = _predicted(variables, coupling, _is_needle(body))
    prediction = Prediction(*numbers, variables=variables, strength=strength)
    if concrete(variables):
        _check_theory(prediction, body, omega)
    return prediction


def _check_theory(prediction: Prediction, body: Body | Particle, omega: Array) -> None:
    """Refuse a rotation so fast that a theory ends; one that is traced is UNDECIDED."""
    if isinstance(body, Particle) and body.radius is not None:
        rim = float(body.rim_speed(omega))
        if rim > FASTEST_RIM:
            must = f"have a rim slower than {FASTEST_RIM} c, since the theory is not relativistic"
            refuse("omega0", must, f"makes it {rim:.2g} c")
    if prediction.error > LARGEST_ERROR:
        must = "radiate little within one turn, to be averaged (`classify` follows every turn)"
        was = f"makes the estimated relative error {float(prediction.error):.2g}"
        refuse("omega0", must, was)


def _is_needle(body: Body | Particle) -> bool | None:
    """Whether chance may decide, see `needle_end`; None if the body is traced."""
    if not concrete(body):
        return None
    with jax.ensure_compile_time_eval():  # under `jit`, too
        return bool(free_rotation(body.inertia, body.dipole, jnp.zeros(3)).is_needle)


@eqx.filter_jit
def _predicted(
    variables: Float[Array, "15"], strength: Real, is_needle: bool | None
) -> tuple[Array, ...]:
    """The fields of a `Prediction`."""
    values = forward_differentiable(functools.partial(_values, is_needle))(variables, strength)
    probability, quantiles, rest = jnp.split(values, [8, 13])
    omega_inf, ratio, half_time, radiated, lifetime, regime, error = rest
    residual, stop = jnp.sum(probability[:2]), jnp.sum(probability[2:])
    outcome = jnp.where(residual > CERTAIN, Outcome.RESIDUAL, Outcome.UNDECIDED)
    outcome = jnp.where(stop > CERTAIN, Outcome.STOP, outcome)
    outcome = jnp.where(error > LARGEST_ERROR, Outcome.UNDECIDED, outcome)
    outcome = jnp.where(jnp.isfinite(residual), outcome, Outcome.FAILED)
    decided = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    omega_inf = jnp.where(decided, omega_inf, jnp.nan)
    numbers = outcome.astype(int), regime.astype(int)
    times = half_time, radiated, lifetime
    return numbers[0], probability, omega_inf, ratio, quantiles, *times, numbers[1], error


class _Units(NamedTuple):
    """The units of the slow motion."""

    momentum: Real
    """L₀."""
    moment: Real
    """J₃."""
    time: Real
    """J₃³/(2κL₀²)."""
    weakness: Real
    """κL₀/J₃², about τ₀Ω."""


def _rotation(variables: Float[Array, "15"], strength: Real) -> tuple[FreeRotation, _Units]:
    """The free rotation in units of J₃ and L₀, and these units."""
    inertia, dipole, omega = variables[:9].reshape(3, 3), variables[9:12], variables[12:]
    rotation = free_rotation(inertia, dipole, omega)
    moment = rotation.moments[2]
    momentum = jnp.linalg.norm(rotation.momentum)
    coupling = strength * jnp.sum(dipole**2)
    weakness = coupling / moment * (momentum / moment)
    unit = moment / momentum / (2 * weakness)
    scaled = FreeRotation(rotation.moments / moment, rotation.dipole, rotation.momentum / momentum)
    return scaled, _Units(momentum, moment, unit, weakness)


def _slow_motion(rotation: FreeRotation) -> Motion:
    """The slow motion of a body with at least two different moments."""
    high, z = rotation.place
    return motion_from(rotation.side(high), high, z)


def _values(
    is_needle: bool | None, variables: Float[Array, "15"], strength: Real
) -> Float[Array, "20"]:
    """The floating-point fields of a `Prediction`, and its regime."""
    rotation, units = _rotation(variables, strength)
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
    residual = jnp.sum(end.probability[:2])
    sign = end.probability[0] - end.probability[1]
    ratio = jnp.exp(end.log_ratio)
    speed = units.momentum * ratio / (units.moment * end.last_moment)
    omega_inf = jnp.where(jnp.abs(sign) == 1, sign * speed, jnp.nan)
    omega_inf = jnp.where(residual == 0, 0.0, omega_inf)
    symmetric = (rotation.moments[0] == rotation.moments[1]) | (
        rotation.moments[1] == rotation.moments[2]
    )
    regime = jnp.where(symmetric, Regime.AVERAGED, Regime.SLOW_FLOW)
    regime = jnp.where(apart.is_needle, Regime.UNFOLDED, regime)
    regime = jnp.where(is_sphere, Regime.EXACT, regime)
    error = jnp.where(end.known_phase, units.weakness, _error(apart, motion, units.weakness))
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
    return or_nan(values, ~motion.failed | is_sphere | is_spin).at[-2].set(regime.astype(float))


def _error(rotation: FreeRotation, motion: Motion, weakness: Real) -> Real:
    """The part of L² that is radiated within one period, which averaging neglects.

    It is the largest at the start, or at the separatrix, whose libration is slow if two moments are
    nearly equal: its rate is L√(Db Dab), and ln(16/(1 − m)) is taken as 10 there.
    """
    high, z = rotation.place
    side = rotation.side(high)
    x, rest = from_logit(z)
    r, _ = side.rates(x, rest)
    first = r * period(side.moments, x, rest)
    p12, p23, _ = rotation.gaps
    across = (1 - rotation.dipole[1] ** 2) / rotation.moments[1] ** 3
    libration = jnp.sqrt(jnp.where(motion.crosses, p12 * p23, 1.0))
    momentum = jnp.exp(motion.stage(0).end.log / 2)
    crossing = jnp.where(motion.crosses, momentum * across * 4 * 5 / libration, 0.0)
    return ERROR * weakness * jnp.maximum(first, crossing) / jnp.pi + QUADRATURE


@eqx.filter_jit
def _history(
    variables: Float[Array, "15"], constants: tuple[Float[Array, "T"], Real]
) -> tuple[Float[Array, "T"], ...]:
    """E, |L|, h and √⟨Ω²⟩ at given times."""
    times, strength = constants
    rotation, units = _rotation(variables, strength)
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
