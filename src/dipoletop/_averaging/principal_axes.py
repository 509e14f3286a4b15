"""A body and its angular momentum in the principal axes of its inertia, moments ascending."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.types import Real
from .free_rotation import gaps_of
from .slow_flow import Side

OUTERMOST = 600.0  # |logit x| of a start on an axis or on the separatrix
ROUNDING = 64.0  # roundings within which a direction cosine counts as 0, and two moments as equal


class FreeRotation(eqx.Module):
    """The free rotation of a body, in its principal axes."""

    moments: Float[Array, "3"]
    """J₁ ≤ J₂ ≤ J₃."""
    dipole: Float[Array, "3"]
    """The unit vector n along the dipole; components of the size of rounding are 0."""
    momentum: Float[Array, "3"]
    """L."""

    def side(self, high: Bool[Array, ""]) -> Side:
        """Return the slow flow about the axis of J₁ (high) or of J₃."""
        ordered = self.moments, self.dipole**2
        return Side(*(jnp.where(high, values[::-1], values) for values in ordered))

    @property
    def gaps(self) -> Float[Array, "3"]:
        """The differences p₁ − p₂, p₂ − p₃ and p₁ − p₃ of reciprocal moments, not negative."""
        p13, p23, p12 = gaps_of(self.moments)
        return jnp.stack([p12, p23, p13])

    @property
    def is_sphere(self) -> Bool[Array, ""]:
        """Whether all moments are equal."""
        return self.moments[0] == self.moments[2]

    @property
    def is_needle(self) -> Bool[Array, ""]:
        """Whether the two larger moments are equal, and the dipole is across the symmetry axis."""
        j1, j2, j3 = self.moments
        return (j1 < j2) & (j2 == j3) & (self.dipole[0] == 0)

    @property
    def spin_axis(self) -> tuple[Bool[Array, ""], Int[Array, ""]]:
        """Whether L lies along a principal axis with a moment of its own; index of that axis."""
        j1, j2, j3 = self.moments
        alone = jnp.stack([j1 < j2, (j1 < j2) & (j2 < j3), j2 < j3])
        on_axis = alone & (jnp.sum(self.momentum != 0) == 1) & (self.momentum != 0)
        return jnp.any(on_axis), jnp.argmax(on_axis)

    def spin_decay(self, axis: Int[Array, ""]) -> Real:
        """Compute r = (1 − nᵢ²)/Jᵢ³ of a pure spin, whose law is L² = L₀²/(1 + rt)."""
        return (1 - self.dipole[axis] ** 2) / self.moments[axis] ** 3

    def replaced_where(self, condition: Bool[Array, ""]) -> "FreeRotation":
        """Replace the rotation by an ordinary one where the condition holds, to avoid NaN."""
        other = FreeRotation(
            jnp.array([0.5, 0.75, 1.0]), jnp.array([0.6, 0.0, 0.8]), jnp.array([0.48, 0.6, 0.64])
        )
        return jax.tree.map(lambda a, b: jnp.where(condition, a, b), other, self)

    @property
    def place(self) -> tuple[Bool[Array, ""], Real]:
        """Whether L moves round the axis of J₁, and logit x of that motion."""
        y1, y2, y3 = self.momentum**2 / jnp.sum(self.momentum**2)
        p12, p23, p13 = self.gaps
        above = p12 * y1 - p23 * y3  # h − p₂
        high = (above > 0) | (p23 == 0)
        inside = jnp.where(high, p13 * y3 + p12 * y2, p13 * y1 + p23 * y2)
        z = jnp.log(inside) - jnp.log(jnp.abs(above))
        return high, jnp.clip(z, -OUTERMOST, OUTERMOST)


def free_rotation(
    inertia: Float[Array, "3 3"], dipole: Float[Array, "3"], omega: Float[Array, "3"]
) -> FreeRotation:
    """Return the free rotation of a body that turns with the angular velocity Ω."""
    moments, axes = principal_axes(inertia)
    moments = equal_where_rounded(moments)
    n = axes.T @ (dipole / jnp.linalg.norm(dipole))
    small = jnp.abs(n) <= ROUNDING * jnp.finfo(n.dtype).eps
    n = jnp.where(small, 0.0, n)
    # The component along an axis is exactly ±1, so that rounding leaves none across it.
    n = jnp.where(jnp.sum(n != 0) == 1, jnp.sign(n), n)
    return FreeRotation(moments, n, moments * (axes.T @ omega))


def equal_where_rounded(moments: Float[Array, "3"]) -> Float[Array, "3"]:
    """Make moments equal that differ by rounding only."""
    j1, j2, j3 = moments
    j2 = jnp.where(j3 - j2 <= ROUNDING * jnp.finfo(j3.dtype).eps * j3, j3, j2)
    j1 = jnp.where(j2 - j1 <= ROUNDING * jnp.finfo(j3.dtype).eps * j3, j2, j1)
    return jnp.stack([j1, j2, j3])


@jax.custom_jvp
def principal_axes(inertia: Float[Array, "3 3"]) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Return the principal moments, ascending, and the principal axes as columns, right-handed.

    Axes of equal moments do not turn in a derivative: it holds for changes of the inertia that do
    not mix them, and for everything that does not depend on their choice.
    """
    moments, axes = jnp.linalg.eigh(inertia)
    return moments, axes.at[:, 2].multiply(jnp.sign(jnp.linalg.det(axes)))


@principal_axes.defjvp
def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
    (inertia,), (change,) = primals, tangents
    moments, axes = principal_axes(inertia)
    rotated = axes.T @ change @ axes
    gaps = moments[None, :] - moments[:, None]
    distinct = jnp.abs(gaps) > ROUNDING * jnp.finfo(moments.dtype).eps * moments[-1]
    turns = jnp.where(distinct, rotated / jnp.where(distinct, gaps, 1.0), 0.0)
    return (moments, axes), (jnp.diagonal(rotated), axes @ turns)
