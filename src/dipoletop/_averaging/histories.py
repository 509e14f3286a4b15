"""The motion of a body at given times, by the slow flow and by the unfolded system."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.checks import or_nan
from .._base.compiling import compiled_soon, special_numbers
from .._base.guards import safe_divisor
from .._base.roots import root
from .._base.types import Real
from .ends import turns_fast
from .free_rotation import mean_square_speed
from .motion import HALVINGS, slow_motion
from .planar_orbits import PlanarMotion
from .predicted_ends import Start, Units, Variables, scaled_rotation
from .principal_axes import FreeRotation
from .unfolded_ends import PlaneOrbit, handed_over, orbit_of
from .unfolding import entry_of, top_of

FEWEST = 8  # the smallest number of times for which a program is compiled

Values = tuple[Float[Array, "T"], ...]
"""E, |L|, h and √⟨Ω²⟩ at given times."""


@special_numbers()
def at_times(
    program: Callable[..., Any], start: Start, times: Float[Array, "T"], *more: Any
) -> Any:
    """Return what a program gives at times, whose number it sees as a power of 2 at least."""
    size = times.size
    left = max(FEWEST, 1 << (size - 1).bit_length()) - size
    padded = jnp.pad(times, (0, left), constant_values=1.0)
    found = program(start.variables, (padded, start.strength), *more)
    return jax.tree.map(lambda x: x[:size], found)


@compiled_soon
def slow_history(variables: Variables, constants: tuple[Float[Array, "T"], Real]) -> Values:
    """Return E, |L|, h and √⟨Ω²⟩ at given times."""
    times, strength = constants
    rotation, units = scaled_rotation(variables, strength)
    is_sphere, (is_spin, axis) = rotation.is_sphere, rotation.spin_axis
    apart = rotation.replaced_where(is_sphere | is_spin)
    slow = _slow_values(apart, units.weakness)

    def spinning(time: Real) -> Float[Array, "3"]:
        moment = rotation.moments[axis]
        log = -jnp.log1p(rotation.spin_decay(axis) * time)
        return jnp.stack([log, 1 / moment, 1 / moment**2])

    def of_sphere(time: Real) -> Float[Array, "3"]:
        square = (rotation.dipole @ rotation.momentum) ** 2
        lost = jnp.where(square > 0, -jnp.expm1(-square * time) / safe_divisor(square), time)
        across = (1 - square) * jnp.exp(-square * time) / (1 + (1 - square) * lost)
        one = jnp.ones(())
        return jnp.stack([jnp.log(square + across), one, one])

    scaled = times / units.time
    log, h, squared = jnp.where(
        is_sphere,
        jax.vmap(of_sphere)(scaled),
        jnp.where(is_spin, jax.vmap(spinning)(scaled), jax.vmap(slow)(scaled)),
    ).T
    return in_units(units, log, h, squared)


def _slow_values(rotation: FreeRotation, weakness: Real) -> Callable[[Real], Float[Array, "3"]]:
    """Return a function from times to ln L²/L₀², h and ⟨Ω²⟩/L² of the slow flow."""
    motion = slow_motion(rotation)

    def values(time: Real) -> Float[Array, "3"]:
        point = motion.at(jnp.log(time))
        side = rotation.side(point.high)
        h = side.shape(point.x, point.rest)
        found = jnp.stack([point.log, h, mean_square_speed(side.moments, point.x, point.rest)])
        captured = rotation.is_needle & ~turns_fast(rotation, point, weakness)
        return or_nan(found, ~captured & ~motion.failed)

    return values


def in_units(units: Units, log: Real, h: Real, squared: Real) -> tuple[Real, ...]:
    """Return E, |L|, h and √⟨Ω²⟩, from ln L²/L₀² and from h and ⟨Ω²⟩/L² in units of 1/J₃."""
    momentum = units.momentum * jnp.exp(log / 2)
    energy = h * momentum * (momentum / units.moment) / 2
    return energy, momentum, h / units.moment, jnp.sqrt(squared) * momentum / units.moment


@compiled_soon
def capture_follows(
    variables: Variables, constants: tuple[Float[Array, "T"], Real], axial: int
) -> Bool[Array, "T"]:
    """Return whether a needle of nearly equal moments has left the slow flow at given times."""
    times, strength = constants
    rotation, units = scaled_rotation(variables, strength)
    top = top_of(rotation, axial, units.weakness)
    return jnp.log(times / units.time) > entry_of(rotation, slow_motion(rotation), top)[0]


@compiled_soon
def orbit_history(
    variables: Variables, constants: tuple[Float[Array, "T"], Real], axial: int
) -> Values:
    """Return the history of a start with a known phase, not averaged while the orbit lasts.

    After it, only a disc that turns fast about its symmetry axis has a history, by the slow flow.
    """
    times, strength = constants
    rotation, units = scaled_rotation(variables, strength)
    top = top_of(rotation, axial, units.weakness)
    orbit = orbit_of(top, top.start)
    early = _on_orbit(orbit, units, times)
    if axial == 0:  # a needle
        return early
    late = _after_orbit(rotation, orbit, units, times)
    return tuple(jnp.where(jnp.isnan(a), b, a) for a, b in zip(early, late, strict=True))


def _on_orbit(orbit: PlaneOrbit, units: Units, times: Float[Array, "T"]) -> Values:
    """Return the history along an orbit; NaN past its last state."""

    def at(time: Real) -> tuple[Real, ...]:
        def early(sigma: Real) -> Real:
            state, u_time = orbit.at(sigma)
            return jnp.log(u_time) - state[2] - jnp.log(time / orbit.top.time_unit)

        sigma = root(early, jnp.full_like(time, 1e-300), orbit.last, HALVINGS)
        state, _ = orbit.at(sigma)
        omega = orbit.top.omega_at(state, orbit.top.log_u)
        momentum = jnp.linalg.norm(orbit.top.moments * omega)
        known = orbit.settled | (early(orbit.last) >= 0)
        values = momentum, jnp.linalg.norm(omega), orbit.top.energy(state)
        return tuple(or_nan(x, known) for x in values)

    momentum, speed, energy = jax.vmap(at)(times / units.time)
    flat, moment = orbit.top.flat, orbit.top.moment
    momentum, energy = momentum * flat * moment, energy * flat**2 * moment / 2
    unit = units.momentum / units.moment
    return (
        energy * units.momentum * unit,
        momentum * units.momentum,
        2 * energy / momentum**2 / units.moment,
        speed * flat * unit,
    )


def _after_orbit(
    rotation: FreeRotation, orbit: PlaneOrbit, units: Units, times: Float[Array, "T"]
) -> Values:
    """Return the history of a disc after it has begun to turn fast about its symmetry axis.

    The slow flow begins where φ is a multiple of π for the last time: there a motion does not
    oscillate about its averages (`capture`). NaN at earlier times, and for other motions.
    """
    top, (last, _) = orbit.top, orbit.at(orbit.last)
    turns = (top.delta < 0) & PlanarMotion(top.delta, top.ratio).turns(last)
    heading = -jnp.sign(top.delta * last[1])
    target = heading * jnp.pi * jnp.floor(heading * last[0] / jnp.pi)
    turn = 1.5 * jnp.pi / jnp.maximum(jnp.abs(top.delta * last[1]), 1.0)
    before = jnp.maximum(orbit.last - turn, 0.0)
    sigma = root(lambda s: heading * (orbit.at(s)[0][0] - target), before, orbit.last, HALVINGS)
    state, u_time = orbit.at(sigma)
    handed, size = handed_over(rotation, top, state)
    handed, size = handed.replaced_where(~turns), size * top.flat * top.moment
    later = times / units.time - u_time * jnp.exp(-state[2]) * orbit.top.time_unit
    slow = _slow_values(handed, units.weakness * size)
    found = jax.vmap(slow)(jnp.maximum(later, 1e-300) * size**2)
    log, h, squared = or_nan(found, (turns & (later >= 0))[:, None]).T
    return in_units(units, log + 2 * jnp.log(size), h, squared)
