"""What surrounds a body, in the units of the dimensionless library: friction and its noise.

In body axes the momentum P (L but for the near field, `surroundings.radiation_reaction`) obeys

    dP = P×Ω dt − γΩ dt + B(P)∘dA + √(2D) dW,    Ω = I⁻¹P,
    dA = (θc − d₂)dt + √(2θ) dW′,                B(P)a = (Ω×d)×a − P×I⁻¹(d×a),

with θ = kT of the thermal radiation, d₂ the second derivative of the dipole in free rotation, and
γ and D the drag and the noise by a gas and by thermal friction. In the sense of Stratonovich (∘)
the drift that keeps the equilibrium is Bc with the constant vector c = I⁻¹d − (tr I⁻¹)d: half of
the divergence of the columns of B. Without it the rotation would cool down to nothing.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import finite, instance, not_negative, shape_of, where_valid
from .._base.guards import safe_divisor
from .._base.linalg import inverse, matvec, trace
from .._base.refusals import refuse
from .._base.shown import Shown
from .._base.types import Vector
from ..bodies import Body
from ..particles import Particle
from ..particles.units import BOLTZMANN
from ..surroundings import RadiationReaction, Surrounding
from ..surroundings.radiation_reaction import dipole_derivatives, impulse


class Bath(Shown):
    """Friction, and the noise that belongs to it, dimensionless as everything of a `Body`.

    Args:
        heat: θ = kT of the thermal radiation that the dipole feels, in units of I₁/τ₀².
        drag: γ of other friction, the torque −γω, in units of I₁/τ₀: a number or a matrix, shape
            (3, 3), in body axes.
        drag_heat: kT of what causes the drag, with the noise D = kTγ; None means `heat`.

    Raises:
        ValueError: a heat that is negative; a drag that is no number, and no symmetric matrix
            without negative eigenvalues.
    """

    heat: Float[Array, ""]
    drag: Float[Array, "3 3"]
    diffusion: Float[Array, "3 3"]
    """D of the drag, ⟨MᵢMⱼ⟩ = 2Dᵢⱼδ."""

    def __init__(self, heat: Any = 0.0, drag: Any = 0.0, drag_heat: Any = None) -> None:
        self.heat = not_negative("heat", heat, batch=False)
        self.drag = _drag(drag)
        warm = self.heat if drag_heat is None else not_negative("drag_heat", drag_heat, batch=False)
        self.diffusion = warm * self.drag

    @staticmethod
    def around(particle: Particle, *surroundings: Surrounding, axis: Any = None) -> "Bath":
        """Return the bath of a particle, for `particle.body(axis)`.

        Args:
            particle: a single particle.
            surroundings: what acts on it: a `RadiationReaction` with its temperature, a `Gas`, a
                `Blackbody`, ….
            axis: as for `Particle.tau0`.

        Raises:
            ValueError: an argument that is no surrounding.
        """
        instance("particle", particle, Particle)
        tau0, moment = particle.tau0(axis), particle.moment(axis)
        heat, drag, diffusion = jnp.zeros(()), jnp.zeros((3, 3)), jnp.zeros((3, 3))
        for each in surroundings:
            instance("surroundings", each, Surrounding, "be surroundings, such as a `Gas`")
            if isinstance(each, RadiationReaction):
                heat = heat + BOLTZMANN * each.temperature * tau0 / moment * tau0
                continue
            unit = jnp.eye(3)
            drag = drag - each.torque(particle, unit) * (tau0 / moment)
            noise = each.diffusion(particle, unit[0])
            diffusion = diffusion + noise * (tau0 / moment) ** 2 * tau0
        return eqx.tree_at(lambda bath: (bath.drag, bath.diffusion), Bath(heat), (drag, diffusion))

    @property
    def acting(self) -> tuple[bool, bool]:
        """Whether the field of thermal radiation acts, and whether there is a drag or its noise."""
        drags = np.any(np.asarray(self.drag) != 0) or np.any(np.asarray(self.diffusion) != 0)
        return bool(np.asarray(self.heat) > 0), bool(drags)

    @property
    def highest(self) -> Float[Array, ""]:
        """The highest kT of the radiation and of what causes the drag."""
        drag = jnp.diagonal(self.drag)
        heats = jnp.where(drag > 0, jnp.diagonal(self.diffusion) / safe_divisor(drag), 0.0)
        return jnp.maximum(self.heat, jnp.max(heats))

    @property
    def roots(self) -> Float[Array, "3 3"]:
        """√(2D), symmetric."""
        values, axes = jnp.linalg.eigh(2 * self.diffusion)
        return (axes * jnp.sqrt(jnp.maximum(values, 0.0))[None]) @ axes.T


def _drag(value: Any) -> Float[Array, "3 3"]:
    shape = shape_of(value)
    if shape == ():
        return not_negative("drag", value, batch=False) * jnp.eye(3)
    drag = finite("drag", value, shape, batch=False)
    if shape != (3, 3):
        refuse("drag", "be a number or have shape (3, 3)", f"has shape {shape}")
    sound = jnp.max(jnp.abs(drag - drag.T)) <= 1e-12 * jnp.max(jnp.abs(drag))
    sound &= jnp.min(jnp.linalg.eigvalsh(drag)) >= -1e-12 * jnp.max(jnp.abs(drag))
    return where_valid("drag", drag, sound, "be symmetric, without negative eigenvalues")


class Kicks(eqx.Module):
    """The forces of a bath on the momentum P of a body, in body axes; lanes behind."""

    inertia: Float[Array, "3 3"]
    inverse: Float[Array, "3 3"]
    dipole: Float[Array, "3"]
    shift: Float[Array, "3"]
    """θc."""
    spread: Float[Array, ""]
    """√(2θ)."""
    drag: Float[Array, "3 3"]
    roots: Float[Array, "3 3"]
    is_hot: bool = eqx.field(static=True)
    """Whether the field of thermal radiation acts."""
    is_dragged: bool = eqx.field(static=True)
    """Whether there is a drag, or its noise."""

    def __init__(self, body: Body, bath: Bath, acting: tuple[bool, bool]) -> None:
        self.is_hot, self.is_dragged = acting
        self.inertia, self.dipole = body.inertia, body.dipole
        self.inverse = inverse(body.inertia)
        c = matvec(self.inverse, body.dipole) - trace(self.inverse) * body.dipole
        self.shift, self.spread = bath.heat * c, jnp.sqrt(2 * bath.heat)
        self.drag, self.roots = bath.drag, bath.roots

    @property
    def draws(self) -> int:
        """The number of random numbers of a step."""
        return 3 * (self.is_hot + self.is_dragged)

    def field(self, momentum: Vector, a: Vector) -> Vector:
        """Return B(P)a."""
        return impulse(self.inverse, self.dipole, momentum, a)

    def thermal(self, momentum: Vector, h: Any, z: Float[Array, "d *#lanes"]) -> Vector:
        """Return the change of P by the noise, its drift and the drag in the time h.

        Args:
            momentum: P.
            h: the time.
            z: `draws` independent normal numbers.
        """
        change, root = jnp.zeros_like(momentum), jnp.sqrt(h)
        if self.is_hot:
            spread = self.spread * root
            a = [h * s + spread * w for s, w in zip(self.shift, z[:3], strict=True)]
            change += self.field(momentum, jnp.stack(a))
        if self.is_dragged:
            slowed = matvec(self.drag, matvec(self.inverse, momentum))
            change += matvec(self.roots, root * z[-3:]) - h * slowed
        return change

    def radiated(self, momentum: Vector) -> Vector:
        """Compute −B d₂ of free rotation, the rate of P by radiation reaction."""
        _, second = dipole_derivatives(self.inverse, self.dipole, momentum)
        return -self.field(momentum, second)
