"""The interface of whatever acts on a body from outside: a torque, and its noise."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import not_negative, positive, shape_of
from .._base.linalg import diagonal
from .._base.refusals import refuse
from .._base.shown import Shown
from .._base.types import Vector
from ..particles import Particle
from ..particles.shapes import Solid


class Surrounding(Shown):
    """What acts on a particle, in SI units and body axes.

    Vectors have their components on axis 0. Lanes behind them have the shape of the numbers that
    the surrounding holds, unless these are single ones.
    """

    name: eqx.AbstractClassVar[str]
    """Its name in tables."""

    @abc.abstractmethod
    def torque(self, particle: Particle, omega: Vector) -> Vector:
        """Return the mean torque on a rotation Ω in rad/s, shape (3, ...), N m."""

    @abc.abstractmethod
    def noise(self, particle: Particle, omega: Vector) -> Float[Array, "3 3 ..."]:
        """Return the matrix G of the fluctuating torque G dW/dt, N m √s.

        W has three independent components with ⟨dW²⟩ = dt.
        """

    def diffusion(self, particle: Particle, omega: Vector) -> Float[Array, "3 3 ..."]:
        """Compute D = ½GGᵀ, with ⟨Mᵢ(t)Mⱼ(t′)⟩ = 2Dᵢⱼδ(t − t′), in (N m)² s."""
        g = self.noise(particle, omega)
        return jnp.sum(g[:, None] * g[None], axis=2) / 2


def with_lanes(values: Any, components: int, lead: int, omega: Vector) -> Any:
    """Return numbers in a shape that broadcasts with the lanes of Ω behind `lead` axes.

    Args:
        values: shape (*components, *lanes), or (*components,) for all lanes.
        components: the number of axes of components that they have.
        lead: the number of axes in front of the lanes in the result.
        omega: Ω, shape (3, *lanes).
    """
    shape = values.shape
    if values.ndim == components:
        shape = (*shape, *[1] * (omega.ndim - 1))
    return values.reshape(*[1] * (lead - components), *shape)


def diagonal_matrix(entries: Any) -> Float[Array, "3 3 ..."]:
    """Return the diagonal matrix of three entries, with their lanes behind."""
    return jnp.moveaxis(diagonal(*entries), (-2, -1), (0, 1))


def solid_of(particle: Particle, what: str) -> Solid:
    """Return the shape of a particle; refuse one without it."""
    if particle.shape is None:
        refuse("particle", f"have a `shape`, on which {what} depends", "has none")
    return particle.shape


def zero_or_more(name: str, value: Any, unit: str | None = None) -> Float[Array, "..."]:
    """Return finite numbers of any shape that are not negative."""
    return not_negative(name, value, shape_of(value), batch=False, unit=unit)


def above_zero(name: str, value: Any, unit: str | None = None) -> Float[Array, "..."]:
    """Return finite numbers of any shape that are positive."""
    return positive(name, value, shape_of(value), batch=False, unit=unit)
