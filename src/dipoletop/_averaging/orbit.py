"""The orbit of the angular momentum in a body that turns freely, and the two mean rates of turning.

The axes are right-handed principal axes a, b, c with l = L/|L| on the side of c, which is the axis
that l moves round, and b the middle one. With the notation of `free_rotation`,

    l = (A cn v, B sn v, C dn v),   A² = x Db/Da,   B² = x,   C² = q/Da,   v = v₀ ± λt,

where λ = L√(q Db) and the sign is + about the axis of J₃, − about that of J₁. The whole body turns
about L meanwhile, at the mean rate Φ̇ = L⟨(p_a l_a² + p_b l_b²)/(l_a² + l_b²)⟩.

Source: E. T. Whittaker, Analytical Dynamics, section 69.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_sqrt
from .._base.linalg import cross, dot
from .._base.types import Real
from .free_rotation import averages, gaps_of
from .landen import Descent, descent, mean_of_ratio, uniform_phase
from .principal_axes import ROUNDING, free_rotation

Triple = Float[Array, "3"]


class MomentumOrbit(NamedTuple):
    """A free rotation about no fixed axis, or about the axis of J₁ or J₃."""

    moments: Triple
    """J_a, J_b, J_c."""
    gaps: Triple
    """Da, Db and Dab; not negative."""
    sense: Real
    """1 about the axis of J₃, −1 about that of J₁."""
    x: Real
    rest: Real
    """1 − x."""
    dipole: Triple
    """The unit vector n along the dipole."""
    momentum: Triple
    """L."""

    @property
    def q(self) -> Real:
        """The number q = Dab + (1 − x)Db."""
        return self.gaps[2] + self.rest * self.gaps[1]

    @property
    def g(self) -> Real:
        """The ratio g = Db/Da."""
        return self.gaps[1] / self.gaps[0]

    @property
    def steps(self) -> Descent:
        """The descent from the parameter m = x Dab/q."""
        return descent(self.x * self.gaps[2] / self.q, self.rest * self.gaps[0] / self.q)

    def rates(self, steps: Descent) -> tuple[Real, Real]:
        """Return Φ̇ and the signed rate ±(π/2K)λ of the phase of the motion in the body."""
        size = jnp.sqrt(dot(self.momentum, self.momentum))
        turn = mean_of_ratio(steps, self.g, 1 / self.moments[0], 1 / self.moments[1])
        return size * turn, self.sense * size * steps.mean * jnp.sqrt(self.q * self.gaps[1])

    def phase(self, steps: Descent) -> Real:
        """Return the phase πv₀/2K."""
        y, z = self.momentum[1], self.momentum[0] / jnp.sqrt(self.g)
        moves = (y != 0) | (z != 0)
        return uniform_phase(steps, jnp.arctan2(jnp.where(moves, y, 0.0), jnp.where(moves, z, 1.0)))

    def power(self) -> Real:
        """Return the mean power ⟨|d̈|²⟩ of a dipole of length 1."""
        r, growth = (self.dipole**2 @ mean for mean in averages(self.moments, self.x, self.rest))
        p, change = 1 / self.moments, self.sense * self.x * self.gaps[1]
        shape = self.rest * p[2] + self.x * p[1]
        return dot(self.momentum, self.momentum) ** 2 * (shape * r - change * growth)


class Spin(NamedTuple):
    """A rotation about a fixed axis that neighbouring orbits of L do not encircle."""

    holds: Bool[Array, ""]
    """Whether the rotation is of this kind: a body with three equal moments, an axis across the
    symmetry axis, the middle axis, or a motion on the separatrix."""
    rate: Real
    """The angular speed."""
    across: Real
    """The part of the unit vector n across the axis."""


def motion_of(
    inertia: Float[Array, "3 3"], dipole: Triple, omega: Triple
) -> tuple[MomentumOrbit, Spin]:
    """Return the free rotation; where it is a `Spin`, the orbit is a placeholder.

    Args:
        inertia: the inertia tensor.
        dipole: the unit vector n along the dipole.
        omega: the angular velocity, not zero.
    """
    rotation = free_rotation(inertia, dipole, omega)
    moments, n, momentum = rotation.moments, rotation.dipole, rotation.momentum
    _, p23, p12 = gaps_of(moments)
    square = dot(momentum, momentum)
    size, y = jnp.sqrt(square), momentum**2 / square
    above = p12 * y[0] - p23 * y[2]  # h − p₂
    high = (above > 0) | ((p23 == 0) & (p12 > 0))
    tiny = ROUNDING * float(jnp.finfo(moments.dtype).eps)
    holds = jnp.abs(above) <= tiny**2 * jnp.where(high, p12, p23)  # Db
    # With three distinct moments this is the separatrix: nearly all time is spent on axis 2.
    unit, middle = momentum / size, jnp.zeros_like(momentum).at[1].set(1.0)
    turned = cross(jnp.where((p12 > 0) & (p23 > 0), middle, unit), n)
    spin = Spin(holds, size * dot(unit**2, 1 / moments), safe_sqrt(dot(turned, turned)))
    # Where the motion is a spin, another motion stands in, so that nothing is NaN.
    example = jnp.arange(2.0, 5.0, dtype=moments.dtype)
    moments = jnp.where(holds, example, moments)
    momentum = jnp.where(holds, jnp.ones_like(example), momentum)
    return _orbit(moments, n, momentum, high & ~holds), spin


def _orbit(moments: Triple, n: Triple, momentum: Triple, high: Bool[Array, ""]) -> MomentumOrbit:
    p13, p23, p12 = gaps_of(moments)
    to_b, a_to_b = jnp.where(high, p12, p23), jnp.where(high, p23, p12)

    def axes(values: Triple, sign: Real | float = -1.0) -> Triple:
        """Return the components along a, b, c: of a vector with `sign` −1, of moments with 1."""
        return jnp.where(high, jnp.stack([sign * values[2], values[1], values[0]]), values)

    y = momentum**2 / dot(momentum, momentum)
    inside = jnp.where(high, p13 * y[2] + p12 * y[1], p13 * y[0] + p23 * y[1])
    outside = jnp.abs(p12 * y[0] - p23 * y[2])
    x, rest = inside / (inside + outside), outside / (inside + outside)
    momentum, n = axes(momentum), axes(n)
    # A half turn about a brings L to the side of c.
    half_turn = jnp.where(momentum[2] < 0, -1.0, 1.0)
    signs = jnp.stack([jnp.ones_like(half_turn), half_turn, half_turn])
    gaps, sense = jnp.stack([p13, to_b, a_to_b]), jnp.where(high, -1.0, 1.0)
    return MomentumOrbit(axes(moments, 1.0), gaps, sense, x, rest, n * signs, momentum * signs)
