"""The laws that predict how a rotation of weak radiation ends, and its history.

Averages over free rotation hold for every body, and give the capture of a needle by chance. If two
moments are nearly equal, the unfolded system may be more accurate. It takes many steps, so it is
considered for concrete values only.
"""

import dataclasses
import enum
import functools
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.checks import concrete
from .._base.compiling import compiled_soon, special_numbers, untraced
from .._base.forward_mode import forward_differentiable
from .._base.types import Real, Regime
from .capture import (
    LARGEST,
    SMALLEST,
    Capture,
    TopEnd,
    capture,
    end_by_chance,
    end_of_phase,
    end_of_top,
    is_random,
    known_capture,
)
from .ends import SlowEnd, needle_end, needle_start, slow_end
from .estimates import error_at, estimated_error, rounding_error, start_error
from .histories import Values, at_times, capture_follows, orbit_history, slow_history
from .motion import slow_motion
from .planar_orbits import PlanarMotion
from .predicted_ends import (
    End,
    Start,
    Units,
    Variables,
    end_from,
    fields_of,
    numbers_in_units,
    numbers_of,
    ordinary,
    scaled_rotation,
    separate,
)
from .principal_axes import FreeRotation
from .unfolded_ends import captured_end, half_time_of, known_end, order_error
from .unfolding import LARGEST as FARTHEST_RATIO
from .unfolding import asymmetry_at_entry, entry_of, top_of


@runtime_checkable
class Law(Protocol):
    """How a rotation ends, and its motion until then."""

    def end(self, start: Start) -> End | None:
        """Return how a rotation ends; None if that takes too long."""
        ...

    def history(self, start: Start, times: Float[Array, "T"]) -> Values:
        """Return E, |L|, h and √⟨Ω²⟩ at given times."""
        ...


class Needle(enum.Enum):
    """What is known of a start: whether the body is a needle (`needle_end`), of which phase.

    A program for less costs less to compile.
    """

    NO = enum.auto()
    BY_CHANCE = enum.auto()
    HALVED_BEFORE = enum.auto()
    """By chance, when the energy has already halved; else the half time is NaN."""
    OF_KNOWN_PHASE = enum.auto()
    OF_ANY_PHASE = enum.auto()
    UNKNOWN = enum.auto()


@dataclasses.dataclass(frozen=True)
class SlowFlow:
    """Averages over free rotation; a needle is captured by chance, or at once from its phase."""

    needle: Needle = Needle.UNKNOWN
    chance: Capture | None = None
    """The capture of a needle whose δ is constant; None: it is computed."""

    def end(self, start: Start) -> End:
        """Return how a rotation ends; the half time of a needle of known phase is NaN."""
        return averaged_end(*start, self.needle, self.chance)

    def history(self, start: Start, times: Float[Array, "T"]) -> Values:
        """Return the averaged motion; NaN from the capture of a needle on."""
        return at_times(slow_history, start, times)


class ByChance(SlowFlow):
    """The capture of a needle whose phase is random, for a known start."""

    def end(self, start: Start) -> End:
        """Return how a rotation ends."""
        end = averaged_end(*start, Needle.HALVED_BEFORE, self.chance)
        is_late = np.isnan(jax.lax.stop_gradient(end.half_time))
        return super().end(start) if is_late else end


class KnownPhase:
    """The motion of a needle whose phase is known."""

    def end(self, start: Start) -> End:
        """Return how a rotation ends."""
        end = averaged_end(*start, Needle.OF_KNOWN_PHASE)
        return dataclasses.replace(end, half_time=half_time_from(*start, jnp.asarray(end.ratio)))

    def history(self, start: Start, times: Float[Array, "T"]) -> Values:
        """Return the motion, which is not averaged."""
        return at_times(orbit_history, start, times, 0)


@dataclasses.dataclass(frozen=True)
class Unfolded:
    """The unfolded system of a body with two nearly equal moments."""

    axial: int
    """The principal axis, 0 or 2, that counts as the symmetry axis."""
    turns: bool
    """Whether the start turns fast about it."""

    def end(self, start: Start) -> End:
        """Return how a rotation ends."""
        return unfolded_end(*start, self.axial, self.turns)

    def history(self, start: Start, times: Float[Array, "T"]) -> Values:
        """Return the motion; of a random phase it is averaged, and NaN from the capture on."""
        if not self.turns:
            return at_times(orbit_history, start, times, self.axial)
        captured = at_times(capture_follows, start, times, self.axial)
        slow = at_times(slow_history, start, times)
        return jax.tree.map(lambda x: jnp.where(captured, jnp.nan, x), slow)


@special_numbers()
def first_law(inertia: Array, dipole: Array, omega: Array, strength: Real) -> Law:
    """Return the law by averages of a start, for a needle that of its phase if it is known.

    A start that is only differentiated is known. A needle that spins about its symmetry axis is not
    captured, and counts as no needle.
    """
    is_traced, is_constant = not concrete(inertia, dipole, omega), concrete(inertia, dipole)
    # In a trace the result of any operation, even on what is known, is traced.
    inertia, dipole, omega = (
        x if concrete(x) else jax.lax.stop_gradient(x) for x in (inertia, dipole, omega)
    )
    if not concrete(inertia, dipole):
        return SlowFlow()
    with untraced():
        some = omega if (is_known := concrete(omega)) else np.ones(3)
        start = jnp.asarray(np.concatenate([np.ravel(x) for x in (inertia, dipole, some)]))
        is_captured, is_random, delta = _is_captured(start, strength)
        if not is_captured:
            return SlowFlow(Needle.NO)
        if is_known and not is_random:
            return SlowFlow(Needle.OF_KNOWN_PHASE) if is_traced else KnownPhase()
        chance = known_capture(float(delta)) if is_constant else None
    return ByChance(Needle.BY_CHANCE, chance) if is_known else SlowFlow(Needle.OF_ANY_PHASE, chance)


@compiled_soon
def _is_captured(
    variables: Variables, strength: Real
) -> tuple[Bool[Array, ""], Bool[Array, ""], Real]:
    """Return whether a needle is captured, whether by chance, and its δ."""
    rotation, units = scaled_rotation(variables, strength)
    delta, omega = needle_start(rotation, units.weakness)
    is_captured = rotation.is_needle & jnp.any(omega[:2] != 0)
    return is_captured, is_random(delta, omega), delta


@special_numbers()
def averaged_law_and_end(start: Start, first: Law) -> tuple[Law, End]:
    """Return the law of slow rotations whose error is smallest, and the end by it.

    Args:
        start: the start.
        first: its `first_law`.
    """
    end: Any = first.end(start)
    if not concrete(end) or isinstance(first, ByChance | KnownPhase):
        return first, end
    moments = np.linalg.eigvalsh(np.asarray(start.variables)[:9].reshape(3, 3))
    # The smallest relative gap of moments is below any error of the unfolded system.
    if np.min(np.diff(moments)) / moments[2] > float(end.error):
        return first, end
    other, least_error = unfolded_law(start)
    if least_error < end.error and (found := other.end(start)).error < end.error:
        return other, found
    return first, end


def law_of(start: Start, regime: Any) -> Law:
    """Return the law of slow rotations of a given regime."""
    if not concrete(start, regime) or regime != Regime.UNFOLDED:
        return SlowFlow()
    law = first_law(*start.parts, start.strength)
    return unfolded_law(start)[0] if type(law) is SlowFlow else law


def unfolded_law(start: Start) -> tuple[Unfolded, float]:
    """Return the unfolded system of a body, and its least error; infinite if it does not apply."""
    turns, errors = map(np.asarray, coverage(*start))
    place = int(np.argmin(errors))
    return Unfolded(2 * place, bool(turns[place])), float(errors[place])


def averaged_end(
    variables: Variables, strength: Real, needle: Needle, chance: Capture | None = None
) -> End:
    """Return how the free rotation of a body ends; differentiable by its variables.

    Args:
        variables: inertia, dipole and ω₀ in one vector.
        strength: the k of κ = k d².
        needle: what is known of the start.
        chance: the capture of a needle whose δ is constant; None: it is computed.
    """
    return _end_from(_numbers_if(needle)(variables, (strength, chance)))


_end_from = compiled_soon(end_from)


@functools.cache
def _numbers_if(needle: Needle) -> Callable[..., list[Array]]:
    """Return the function from a start, for a kind of needles, to the numbers of its end."""

    def of_start(variables: Variables, settings: tuple[Real, Capture | None]) -> list[Array]:
        return separate(_numbers(needle, variables, *settings))

    return forward_differentiable(of_start, one_by_one=True, compiled=compiled_soon)


def _numbers(
    needle: Needle, variables: Variables, strength: Real, chance: Capture | None
) -> Float[Array, "20"]:
    """Return the floating-point fields of a `Prediction`, and its regime."""
    rotation, units = scaled_rotation(variables, strength)
    apart = ordinary(rotation)
    start = needle_start(apart, units.weakness)
    if needle is Needle.OF_KNOWN_PHASE:
        return _numbers_of_needle(rotation, units, end_of_phase(*start))
    if needle is Needle.HALVED_BEFORE:
        found = end_by_chance(*start, chance or capture(start[0]))
        return _numbers_of_needle(rotation, units, found, timed=True)
    motion = slow_motion(apart)
    end_of = end_by_chance if needle is Needle.BY_CHANCE else end_of_top

    def captured() -> SlowEnd:
        found = end_of(*start, chance or capture(start[0]))
        return needle_end(apart, units.weakness, found, motion)

    other = functools.partial(slow_end, apart, motion)
    if needle is Needle.UNKNOWN:
        end = jax.lax.cond(apart.is_needle, captured, other)
    else:
        end = other() if needle is Needle.NO else captured()
    return numbers_of(rotation, units, end, estimated_error(apart, motion, units.weakness))


def _numbers_of_needle(
    rotation: FreeRotation, units: Units, end: TopEnd, *, timed: bool = False
) -> Float[Array, "20"]:
    """Return the numbers of a needle whose slow motion is not computed; `timed` as `needle_end`."""
    apart = ordinary(rotation)
    slow = needle_end(apart, units.weakness, end, timed=timed)
    return numbers_of(rotation, units, slow, start_error(apart, units.weakness))


def end_of_needle(variables: Variables, strength: Real, chance: Capture | None) -> End:
    """Return how a needle ends, without times.

    Args:
        variables: inertia, dipole and ω₀ in one vector.
        strength: the k of κ = k d².
        chance: its capture; None if its phase is known.
    """
    rotation, units = scaled_rotation(variables, strength)
    start = needle_start(rotation, units.weakness)
    end = end_of_phase(*start) if chance is None else end_by_chance(*start, chance)
    return fields_of(_numbers_of_needle(rotation, units, end))


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
def unfolded_end(variables: Variables, strength: Real, axial: int, turns: bool) -> End:
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
        end, error = known_end(rotation, top, is_disc=axial == 2)
    error += rotation.left_out + rounding_error(rotation, end.log_ratio)
    return fields_of(numbers_in_units(end, units, error).at[-2].set(float(Regime.UNFOLDED)))
