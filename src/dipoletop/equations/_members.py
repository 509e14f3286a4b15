"""Members that several equations share: by the kind of their states, and of the body that moves."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._base.types import Real, State, Vector
from ..bodies import Body, axisymmetric
from ._common import reduced_order, rigid_body, shape_parameter, transverse_omega_scale
from .coordinates import from_cylindrical, to_cylindrical
from .levels import Level


class OfOmega(eqx.Module):
    """An equation whose state is ω itself."""

    def lift(self, omega0: Vector) -> Vector:
        """Return ω₀, since the state is ω itself."""
        return omega0

    def omega(self, y: Vector) -> Vector:
        """Return the state, which is ω itself."""
        return y


class OfOrder(OfOmega):
    """A reduced level, 1 … 4."""

    order: int = eqx.field(static=True, default=1, converter=reduced_order)

    @property
    def level(self) -> str:
        """The label of the level."""
        return Level.of_order(self.order).label


class OmegaFirst(eqx.Module):
    """An equation whose state begins with ω."""

    def omega(self, y: State) -> Vector:
        """Return the first three components."""
        return y[:3]


class OfFull(OmegaFirst):
    """A full equation of a body, with the state (ω, a)."""

    def lift(self: Any, omega0: Vector) -> State:
        """Return the state near the physical branch, by the reduction of order 3."""
        return jnp.concatenate([omega0, self.fast(self.reduced(3)(0.0, omega0))])


class Cylindrical(eqx.Module):
    """An equation with the state (ω⊥, ω₃, φ)."""

    def lift(self, omega0: Vector) -> Vector:
        """Compute (ω⊥, ω₃, φ) of ω₀."""
        return to_cylindrical(omega0)

    def omega(self, y: Vector) -> Vector:
        """Compute ω of a state (ω⊥, ω₃, φ)."""
        return from_cylindrical(y[0], y[1], y[2])


class TransverseTop(eqx.Module):
    """An equation of the top with a transverse dipole."""

    delta: Real = eqx.field(converter=shape_parameter)

    omega_scale = staticmethod(transverse_omega_scale)

    @property
    def body(self) -> Body:
        """The top, for energies and powers."""
        return axisymmetric(self.delta)


class LongitudinalTop(eqx.Module):
    """An equation of the top with a longitudinal dipole."""

    delta: Real = eqx.field(converter=shape_parameter)

    @property
    def body(self) -> Body:
        """The top, for energies and powers."""
        return axisymmetric(self.delta, "longitudinal")


class OfBody(eqx.Module):
    """An equation of any body."""

    body: Body = eqx.field(converter=rigid_body)
