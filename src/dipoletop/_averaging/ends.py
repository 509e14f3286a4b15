"""How a slow motion ends: in residual rotation, in pure spin, or tumbling; and when.

Units are those of the motion: L₀ for angular momentum, the largest moment J₃ for moments, L₀²/J₃
for energy, and J₃³/(2κL₀²) for time.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._base.bisection import root
from .._base.types import Real
from .motion import HALVINGS, Motion, Stage
from .principal_axes import FreeRotation
from .slow_flow import Side

ENDS = (
    "residual +",
    "residual -",
    "stop about axis 1",
    "stop about axis 2",
    "stop about axis 3",
    "tumbling, low",
    "tumbling, high",
    "wobbling",
)
"""The ends of a motion: residual rotation along and against the dipole; a stop in pure spin about
the principal axis of J₁ (the smallest), J₂, J₃; a stop while tumbling, with h below or above 1/J₂;
a stop while oscillating about the middle axis of a needle."""


class SlowEnd(NamedTuple):
    """How a slow motion ends."""

    probability: Float[Array, "8"]
    """Of each of the `ENDS`."""
    log: Real
    """ln L∞²/L₀²; −∞ for a stop."""
    energy: Real
    """E₀."""
    last_energy: Real
    """E∞."""
    half_time: Real
    """The time at which E − E∞ has fallen to one half."""
    last_moment: Real
    """The moment about the axis of the last rotation, if it is a pure spin."""
    lifetime: Real
    """The time in which L² falls to one half of the plateau L²ₚ of L² = L²ₚ/(1 + t/lifetime), the
    law at late times; infinite if the rotation is residual."""


def slow_end(rotation: FreeRotation, motion: Motion) -> SlowEnd:
    """How a slow motion of a body ends."""
    stage = motion.final
    limit = stage.limit
    r, _ = stage.interval.side.rates(limit.x, limit.rest)
    turns_about = jnp.where(motion.ends_high, 0, 2)
    on_axis = (stage.knots[stage.last] < 0) & ~limit.is_zero
    residual = on_axis & (r == 0)
    # The sign of L about the last axis is the first one, or chance after the separatrix.
    sign = jnp.sign(rotation.momentum[turns_about] * rotation.dipole[turns_about])
    along = jnp.where(motion.crosses, 0.5, (1 + sign) / 2)
    spin, tumbling = on_axis & ~residual, ~on_axis
    probability = jnp.stack(
        [
            jnp.where(residual, along, 0.0),
            jnp.where(residual, 1 - along, 0.0),
            1.0 * (spin & motion.ends_high),
            jnp.zeros_like(r),
            1.0 * (spin & ~motion.ends_high),
            1.0 * (tumbling & ~motion.ends_high),
            1.0 * (tumbling & motion.ends_high),
            jnp.zeros_like(r),
        ]
    )
    end = stage.end
    h = shape(stage.interval.side, limit.x, limit.rest)
    last_energy = jnp.where(residual, h * jnp.exp(end.log) / 2, 0.0)
    energy = _energies(motion.stage(0))[0]
    return SlowEnd(
        probability,
        jnp.where(residual, end.log, -jnp.inf),
        energy,
        last_energy,
        _time_at(motion, (energy + last_energy) / 2),
        rotation.moments[turns_about],
        1 / (r * jnp.exp(end.log + r * end.s)),
    )


def spin_end(rotation: FreeRotation, axis: Int[Array, ""]) -> SlowEnd:
    """How a pure spin about a principal axis ends: L² = 1/(1 + rt), r = (1 − nᵢ²)/Jᵢ³."""
    moment, cosine = rotation.moments[axis], rotation.dipole[axis]
    r = (1 - cosine**2) / moment**3
    along = (1 + jnp.sign(rotation.momentum[axis] * cosine)) / 2
    residual = 1.0 * (r == 0)
    stop = jax.nn.one_hot(axis, 3) * (1 - residual)
    zeros = jnp.zeros(3)
    probability = jnp.concatenate([residual * jnp.stack([along, 1 - along]), stop, zeros])
    energy = 1 / (2 * moment)
    log = jnp.where(r == 0, 0.0, -jnp.inf)
    return SlowEnd(probability, log, energy, residual * energy, 1 / r, moment, 1 / r)


def sphere_end(rotation: FreeRotation) -> SlowEnd:
    """How the rotation of a sphere ends: n·Ω is constant, and u = |Ω×n|² obeys u′ = −(n·Ω)²u − u².

    The solution is exact at order 1, u = u₀y/(1 + u₀(1 − y)/s²) with s = n·Ω and y = exp(−s²t).
    """
    cosine = rotation.dipole @ rotation.momentum
    square = cosine**2
    residual = 1.0 * (cosine != 0)
    along = (1 + jnp.sign(cosine)) / 2
    ends = jnp.zeros(8).at[4].set(1 - residual)
    probability = ends.at[:2].set(residual * jnp.stack([along, 1 - along]))
    log = jnp.where(cosine == 0, -jnp.inf, jnp.log(jnp.where(cosine == 0, 1.0, square)))
    divisor = jnp.where(square == 0, 1.0, square)
    half_time = jnp.where(square == 0, 1.0, jnp.log1p(square) / divisor)
    half = jnp.asarray(0.5)
    lifetime = jnp.where(cosine == 0, 1.0, jnp.inf)
    return SlowEnd(probability, log, half, half * square, half_time, jnp.ones(()), lifetime)


def shape(side: Side, x: Real, rest: Real) -> Real:
    """The shape h = 2E/L² of the rotation at x."""
    _, jb, jc = side.moments
    return rest / jc + x / jb


def _energies(stage: Stage) -> Float[Array, "K"]:
    """The energies at the knots; 0 behind the last one."""
    h = jax.vmap(lambda y: shape(stage.interval.side, *stage.interval.position(y)))(stage.knots)
    known = jnp.arange(stage.knots.size) <= stage.last
    return jnp.where(known, h * jnp.exp(stage.states.log) / 2, 0.0)


def _time_at(motion: Motion, energy: Real) -> Real:
    """The time at which the energy has fallen to a value."""
    second = motion.crosses & (_energies(motion.stage(0))[motion.stage(0).last] > energy)
    stage = motion.stage(second.astype(int))
    above = jnp.sum(_energies(stage) > energy)
    piece = stage.piece(above - 1)

    def lost(part: Real) -> Real:
        y, state = piece.at(part)
        h = shape(stage.interval.side, *stage.interval.position(y))
        return energy - h * jnp.exp(state.log) / 2

    part = root(lost, jnp.zeros_like(energy), jnp.ones_like(energy), HALVINGS)
    y, state = piece.at(part)
    # After the last knot E falls as L² does, by 1 + r(t − tₑ)L²ₑ.
    limit = stage.limit
    r, _ = stage.interval.side.rates(limit.x, limit.rest)
    h = shape(stage.interval.side, *stage.interval.position(y))
    excess = jnp.maximum(h * jnp.exp(state.log) / 2 / energy - 1, 0.0)
    late = above > stage.last
    later = jnp.where(late, excess / jnp.where(r > 0, r, 1.0), 0.0)
    return jnp.exp(-state.log) * (state.u + later)
