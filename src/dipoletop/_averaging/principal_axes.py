"""A body and its angular momentum in the principal axes of its inertia, moments ascending.

In axes that are turned against the principal ones, rounding of the inertia tensor turns two of the
computed principal axes in their plane by about eps over the relative difference of their moments.
Components of n and of Ω that such a turn may have made count as 0. Whether n lies along a principal
axis is decided by n × In, which rounding changes by about eps, whatever the moments; the computed
axes then follow n.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.guards import rounding, safe_divisor, safe_sqrt
from .._base.linalg import components, cross, dot, trace
from .._base.types import Real
from .free_rotation import gaps_of
from .slow_flow import Side

OUTERMOST = 600.0  # |logit x| of a start on an axis or on the separatrix
ROUNDING = 64.0  # roundings within which two moments count as equal
TURN = 8.0  # roundings of an inertia tensor that is written in turned axes
LARGEST_TURN = 0.01  # largest component of a unit vector that counts as made by rounding


class FreeRotation(eqx.Module):
    """The free rotation of a body, in its principal axes."""

    moments: Float[Array, "3"]
    """J₁ ≤ J₂ ≤ J₃."""
    dipole: Float[Array, "3"]
    """The unit vector n along the dipole; components of the size of rounding are 0."""
    momentum: Float[Array, "3"]
    """L; components of the size of rounding are 0."""
    rounding: Real
    """The estimated rounding of the inertia tensor over J₃; 0 if it is diagonal."""
    left_out: Real
    """The size of the components of n and of L/|L| that count as 0."""

    def side(self, high: Bool[Array, ""]) -> Side:
        """Return the slow flow about the axis of J₁ (high) or of J₃."""
        ordered = self.moments, self.dipole**2
        return Side(*(jnp.where(high, values[::-1], values) for values in ordered))

    def rounding_of(self, vector: Float[Array, "3"]) -> Float[Array, "3"]:
        """Estimate the error of the components of a vector by rounding; 0 of those that are 0."""
        turns = self.rounding * self.moments[2] * _reciprocal_gaps(self.moments)
        return jnp.where(vector == 0, 0.0, turns @ jnp.abs(vector))

    @property
    def is_sphere(self) -> Bool[Array, ""]:
        """Whether all moments are equal."""
        j1, _, j3 = components(self.moments)
        return j1 == j3

    @property
    def is_needle(self) -> Bool[Array, ""]:
        """Whether the two larger moments are equal, and the dipole is across the symmetry axis."""
        j1, j2, j3 = components(self.moments)
        return (j1 < j2) & (j2 == j3) & (self.dipole[0] == 0)

    @property
    def symmetry_axis(self) -> tuple[Bool[Array, ""], Int[Array, ""]]:
        """Whether just two moments are equal, and the index of the third axis."""
        j1, j2, j3 = components(self.moments)
        return (j1 == j2) != (j2 == j3), jnp.where(j1 == j2, 2, 0)

    @property
    def spin_axis(self) -> tuple[Bool[Array, ""], Int[Array, ""]]:
        """Whether Ω is constant in the body but for its size, and the index of an axis like it.

        L lies along a principal axis with a moment of its own; or across the symmetry axis of a
        body whose dipole lies along that axis, so that any two axes across it are alike.
        """
        j1, j2, j3 = components(self.moments)
        alone = jnp.stack([j1 < j2, (j1 < j2) & (j2 < j3), j2 < j3])
        on_axis = alone & (jnp.sum(self.momentum != 0) == 1) & (self.momentum != 0)
        has_axis, axis = self.symmetry_axis
        end_over_end = has_axis & self.is_along(axis) & (self.momentum[axis] == 0)
        largest = jnp.argmax(jnp.abs(self.momentum))
        axis = jnp.where(end_over_end, largest, jnp.argmax(on_axis))
        return end_over_end | jnp.any(on_axis), axis

    def is_along(self, axis: Int[Array, ""]) -> Bool[Array, ""]:
        """Whether the dipole lies along a principal axis."""
        return (self.dipole[axis] != 0) & (jnp.sum(self.dipole != 0) == 1)

    def tipped(self, weakness: Real) -> "FreeRotation":
        """Return the rotation as radiation tips it while it hardly brakes.

        If L lies across the symmetry axis and the dipole does not, nor along it, the torque along
        that axis is about κ|Ω|³ until the body precesses. By then L has turned by about √κΩ/J.
        """
        has_axis, axis = self.symmetry_axis
        size, along, n = jnp.linalg.norm(self.momentum), self.momentum[axis], self.dipole[axis]
        least = jnp.sqrt(weakness) * size
        tips = has_axis & (n != 0) & ~self.is_along(axis) & (jnp.abs(along) < least)
        tipped = self.momentum.at[axis].set(jnp.where(along < 0, -least, least))
        momentum = jnp.where(tips, tipped, self.momentum)
        return dataclasses.replace(self, momentum=momentum)

    def spin_decay(self, axis: Int[Array, ""]) -> Real:
        """Compute r = (1 − nᵢ²)/Jᵢ³ of a pure spin, whose law is L² = L₀²/(1 + rt)."""
        across = jnp.where(jnp.arange(3) == axis, 0.0, self.dipole)  # 1 − nᵢ² would be rounded to 0
        return dot(across, across) / self.moments[axis] ** 3

    def replaced_where(self, condition: Bool[Array, ""]) -> "FreeRotation":
        """Replace the rotation by an ordinary one where the condition holds, to avoid NaN."""
        other = FreeRotation(
            jnp.array([0.5, 0.75, 1.0]),
            jnp.array([0.6, 0.0, 0.8]),
            jnp.array([0.48, 0.6, 0.64]),
            jnp.zeros(()),
            jnp.zeros(()),
        )
        return jax.tree.map(lambda a, b: jnp.where(condition, a, b), other, self)

    @property
    def place(self) -> tuple[Bool[Array, ""], Real]:
        """Whether L moves round the axis of J₁, and logit x of that motion."""
        y1, y2, y3 = components(self.momentum**2 / jnp.sum(self.momentum**2))
        p13, p23, p12 = gaps_of(self.moments)
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
    eps, n = float(jnp.finfo(moments.dtype).eps), dipole / jnp.linalg.norm(dipole)
    is_diagonal = (inertia[0, 1] == 0) & (inertia[0, 2] == 0) & (inertia[1, 2] == 0)
    turns = eps * moments[2] * _reciprocal_gaps(moments)
    off = cross(n, inertia @ n)
    is_principal = dot(off, off) <= (rounding(off) * trace(inertia)) ** 2
    along, lean = _along_axis(moments, axes.T @ n)
    axes = jnp.where(is_principal, _turned(axes, along, n, moments), axes)
    direction, dropped = _without_rounding(axes.T @ n, turns)
    direction = jnp.where(is_principal, along, direction)
    rate = axes.T @ omega
    speed = jnp.linalg.norm(rate)
    rate, lost = _without_rounding(rate / safe_divisor(speed), turns)
    momentum = moments * (speed * rate)
    lost = moments * lost / safe_divisor(_norm(moments * rate))
    return FreeRotation(
        moments,
        direction,
        momentum,
        jnp.where(is_diagonal, 0.0, TURN * eps),
        jax.lax.stop_gradient(jnp.where(is_principal, lean, _norm(dropped)) + _norm(lost)),
    )


def _along_axis(moments: Float[Array, "3"], n: Float[Array, "3"]) -> tuple[Array, Real]:
    """Return the axis nearest to a unit vector, and the angle from it to axes of other moments."""
    nearest = jnp.argmax(jnp.abs(n))
    along = jnp.where(jnp.arange(3) == nearest, jnp.sign(n), 0.0)
    across = jnp.where(moments == moments[nearest], 0.0, n)
    return along, _norm(across)


def _turned(
    axes: Float[Array, "3 3"], along: Array, n: Float[Array, "3"], moments: Float[Array, "3"]
) -> Float[Array, "3 3"]:
    """Turn axes (columns) the shortest way, so that `along`, in these axes, becomes n.

    In a derivative they follow n only among axes of equal moments.
    """
    old, new = jax.lax.stop_gradient((axes @ along, n))
    alike = moments == jnp.sum(jnp.abs(along) * moments)
    new = new + axes @ jnp.where(alike, axes.T @ (n - new), 0.0)
    both = old + new
    turned = axes - both[:, None] * (both @ axes)[None] / (1 + dot(old, new))
    return turned + 2 * new[:, None] * (old @ axes)[None]


def _without_rounding(
    unit: Float[Array, "3"], turns: Float[Array, "3 3"]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Split a unit vector into a unit vector and the components that rounding may have made.

    Args:
        unit: the unit vector.
        turns: the angle by which rounding turns each two axes in their plane.
    """
    size = jnp.abs(unit)
    made = ROUNDING * jnp.max(turns * size[None], axis=1)
    small = size <= jnp.minimum(made, LARGEST_TURN)
    kept = jnp.where(small, 0.0, unit)
    return kept / safe_divisor(_norm(kept)), jnp.where(small, unit, 0.0)


def _norm(vector: Float[Array, "3"]) -> Real:
    return safe_sqrt(dot(vector, vector))


def _reciprocal_gaps(moments: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return 1/|Jᵢ − Jⱼ|; 0 where they are equal: axes in their plane are alike."""
    gaps = jnp.abs(moments[:, None] - moments[None])
    return jnp.where(gaps > 0, 1 / safe_divisor(gaps), 0.0)


def equal_where_rounded(moments: Float[Array, "3"]) -> Float[Array, "3"]:
    """Make moments equal that differ by rounding only; each keeps its derivatives."""
    # The difference of two such numbers is exact, and so is the sum.
    j1, j2, j3 = components(moments)
    near = ROUNDING * jnp.finfo(j3.dtype).eps * j3
    j2 = j2 + jax.lax.stop_gradient(jnp.where(j3 - j2 <= near, j3 - j2, 0.0))
    j1 = j1 + jax.lax.stop_gradient(jnp.where(j2 - j1 <= near, j2 - j1, 0.0))
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
