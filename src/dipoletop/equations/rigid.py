"""Any rigid body, any dipole: the full equation of motion and its reductions.

The equation of motion (3.3) is IΩ̇ + N = T(Ω, Ω̇, Ω̈) with N = Ω×IΩ and T the radiation torque.
The levels differ in the Ω̇ and Ω̈ that they insert into T. The rates are functions of the load: N
here, N − M where a torque M acts from outside (`torque_driven`).
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.linalg import components, cross, dot, inverse, matvec, scale, solve, trace
from .._base.types import Real, Vector, Verdict
from ..bodies import Body
from ..radiation import angular_momentum, gyroscopic_torque, radiation_torque
from ._common import OfBody, OfFull, OfOmega, OfOrder, first_and_second
from ._verdicts import any_body
from .levels import Level

FullState = Float[Array, "6 *lanes"]
"""(Ω, a)."""


def free_rotation(body: Body, omega: Vector) -> tuple[Vector, Vector]:
    """Compute Ω̇ = −I⁻¹N and Ω̈ = I⁻¹{Ω×N − Ω̇×(IΩ)} of free rotation (below (3.3))."""
    reciprocal = inverse(body.inertia)  # once: repeated operations are not merged
    momentum = angular_momentum(body, omega)
    load = cross(omega, momentum)
    first = -matvec(reciprocal, load)
    return first, matvec(reciprocal, cross(omega, load) - cross(first, momentum))


def reduced_rate(body: Body, omega: Vector, rates: tuple[Vector, Vector], load: Vector) -> Vector:
    """Compute Ω̇ = I⁻¹{T(Ω, Ω̇, Ω̈) − load}, with the rates (Ω̇, Ω̈) of a lower order in T."""
    torque = radiation_torque(body, omega, *rates) - load
    return matvec(inverse(body.inertia), torque)


def semi_reduced_rate(body: Body, omega: Vector, second: Vector, load: Vector) -> Vector:
    """Solve {I − [d]×(Ω dᵀ + 2(d·Ω))}Ω̇ = T(Ω, 0, Ω̈) − load for Ω̇, with Ω̈ of a lower order."""
    d, inertia = body.dipole, body.inertia
    along, across = dot(d, omega), cross(d, omega)
    x, y, z = components(scale(2 * along, d))
    turned = [[0, -z, y], [z, 0, -x], [-y, x, 0]]  # [2(d·Ω)d]×
    rows = zip(components(inertia), components(across), turned, strict=True)
    matrix = [
        [j - (lever * n + t) for j, n, t in zip(components(row), components(d), more, strict=True)]
        for row, lever, more in rows
    ]
    known = radiation_torque(body, omega, jnp.zeros_like(omega), second)
    return solve(jnp.stack([jnp.stack(row) for row in matrix]), known - load)


def full_rate(body: Body, a: Vector, load: Vector) -> Vector:
    """Compute Ω̇ = a + s n, s = −[n·load + n·(I a)]/(n·I n): no radiation torque is along n."""
    inertia_d = matvec(body.inertia, body.dipole)  # d·(I a) = (I d)·a, since I is symmetric
    along = dot(body.dipole, load) + dot(inertia_d, a)
    return a - scale(along / dot(inertia_d, body.dipole), body.dipole)


def full_fast_rate(body: Body, omega: Vector, rate: Vector, load: Vector) -> Vector:
    """Compute ȧ = PΩ̈ = P[IΩ̇ + load − T(Ω, Ω̇, 0)]/|d|²."""
    torque = radiation_torque(body, omega, rate, jnp.zeros_like(omega))
    unbalanced = matvec(body.inertia, rate) + load - torque
    return across_dipole(body, scale(1 / dot(body.dipole, body.dipole), unbalanced))


def across_dipole(body: Body, v: Vector) -> Vector:
    """Compute Pv = v − n (n·v), n = d/|d|."""
    d = body.dipole
    return v - scale(dot(d, v) / dot(d, d), d)


def runaway_rate(body: Body) -> Real:
    """Return the slower of the two eigenvalues across n of P(I − InnᵀI/(n·In))P/|d|²."""
    inertia, d = jnp.asarray(body.inertia), jnp.asarray(body.dipole)  # NumPy's on the host
    square, inertia_d = dot(d, d), matvec(inertia, d)
    along = dot(inertia_d, d)
    across = jnp.stack([inertia[i] - scale(inertia_d[i] / along, inertia_d) for i in range(3)])
    # This matrix annihilates n from both sides without P. Its two other eigenvalues follow from
    # its trace and from the sum of its principal 2×2 minors.
    total = trace(across)
    pairs = ((0, 1), (0, 2), (1, 2))
    minors = sum(across[i, i] * across[j, j] - across[i, j] * across[j, i] for i, j in pairs)
    root = jnp.sqrt(jnp.maximum(total**2 / 4 - minors, 0.0))
    return minors / ((total / 2 + root) * square)


class Reduced(OfOrder, OfBody):
    """Reduced equation of order m: IΩ̇ = −N + T(Ω, F, DF·F), F the rates of order m − 1.

    Order 0 is free rotation, order 1 the paper's equation (3.4). The sequence is the asymptotic
    expansion of the physical branch of the full equation. For an axisymmetric body with its dipole
    across the axis, `TransverseReduced` is the same equation: faster, and at order 1 with
    proven regions.

    Args:
        body: inertia tensor and dipole, dimensionless.
        order: 1 … 4; each costs about four times the one before.

    Raises:
        ValueError: something other than a `Body`, or an order that is not 1, 2, 3 or 4.
    """

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return dΩ/dτ, shape (3,) or (3, B)."""
        body = self.body
        if self.order == 1:
            rates = free_rotation(body, y)
        else:
            lower = Reduced(body, self.order - 1)
            rates = first_and_second(lambda w: lower(t, w), y)
        return reduced_rate(body, y, rates, gyroscopic_torque(body, y))

    def verdict(self, y: Vector, seen: any_body.SeenBody | None = None) -> Verdict:
        """Return RESIDUAL by a Lyapunov function, STOP by balance or slow flow; uncertified."""
        seen = self.prepare() if seen is None else seen
        return any_body.verdict(seen, y, Level.of_order(self.order))._replace(equation=Reduced)

    def prepare(self) -> any_body.SeenBody:
        """Return the numbers that verdicts need and that depend on the body alone."""
        return any_body.seen(self.body)


class SemiReduced(OfOmega, OfBody):
    """Semi-reduced equation: {I − [d]×(Ω dᵀ + 2(d·Ω))}Ω̇ = −N + d×(d×(Ω²Ω − Ω̈)), Ω̈ of (3.4).

    Only Ω̈ is replaced, by Ω̈ of free rotation; Ω̇ is kept, which requires a 3×3 solve. There
    are no runaways, and residual rotation has no spurious threshold.

    Args:
        body: inertia tensor and dipole, dimensionless.

    Raises:
        ValueError: something other than a `Body`.
    """

    level = Level.SEMI.label

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return dΩ/dτ, shape (3,) or (3, B)."""
        _, second = free_rotation(self.body, y)
        return semi_reduced_rate(self.body, y, second, gyroscopic_torque(self.body, y))

    def verdict(self, y: Vector, seen: any_body.SeenBody | None = None) -> Verdict:
        """Return RESIDUAL by a Lyapunov function, STOP by balance or slow flow; uncertified."""
        seen = self.prepare() if seen is None else seen
        return any_body.verdict(seen, y, Level.SEMI)._replace(equation=SemiReduced)

    def prepare(self) -> any_body.SeenBody:
        """Return the numbers that verdicts need and that depend on the body alone."""
        return any_body.seen(self.body)


class Full(OfFull, OfBody):
    """Full equation (3.3), IΩ̇ + N = T(Ω, Ω̇, Ω̈), state (Ω, a) with a = PΩ̇, P = 1 − nnᵀ.

        Ω̇ = a + s n,   s = −[n·N + n·(I a)]/(n·I n)   (no torque along the dipole d = |d| n)
        ȧ = PΩ̈ = [IΩ̇ + N − T(Ω, Ω̇, 0)]/|d|²

    Physical motions lie on a slow manifold that repels forwards in time; all other motions run
    away. This class is the vector field; `simulate` and `classify` follow the manifold.

    Args:
        body: inertia tensor and dipole, dimensionless.

    Raises:
        ValueError: something other than a `Body`.
    """

    level = Level.FULL.label

    def __call__(self, t: Any, y: FullState, args: Any = None) -> FullState:
        """Return d(Ω, a)/dτ, shape (6,) or (6, B)."""
        body, omega = self.body, y[:3]
        load = gyroscopic_torque(body, omega)
        rate = full_rate(body, y[3:], load)
        return jnp.concatenate([rate, full_fast_rate(body, omega, rate, load)])

    def verdict(self, y: FullState) -> Verdict:
        """Return the verdict on a state of the physical branch; see `Reduced.verdict`."""
        return any_body.verdict(any_body.seen(self.body), self.omega(y), Level.FULL)._replace(
            equation=Full
        )

    def fast(self, omega_dot: Vector) -> Vector:
        """Compute the fast part of Ω̇, which is a part of the state: a = PΩ̇."""
        return across_dipole(self.body, omega_dot)

    def reduced(self, order: int) -> Reduced:
        """Return the reduced level of that order."""
        return Reduced(self.body, order)

    @property
    def semi(self) -> SemiReduced:
        """The semi-reduced level."""
        return SemiReduced(self.body)

    @property
    def runaway_rate(self) -> Real:
        """The slower of the two rates at which distances from the physical branch grow near rest.

        There N and T(Ω, Ω̇, 0) are negligible, so ȧ = PIΩ̇/|d|² with Ω̇ = a − n (n·Ia)/(n·In): the
        rates are the eigenvalues across n of P(I − InnᵀI/(n·In))P/|d|².
        """
        return runaway_rate(self.body)
