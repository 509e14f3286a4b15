"""Plane rotator (section 2 and appendix A of the paper): the dipole turns in a plane.

Dimensionless: ω about body axis 3, the dipole along axis 1, τ₀ = k d²/I, ϖ = ω′. The full
equation ω″ = ω′ + ω³ has one physical branch, ϖ = f(ω); all other motions run away.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._base.checks import where_valid
from .._base.shown import Shown
from .._base.types import Outcome, Real, Stop, Vector, Verdict
from ..bodies import Body, axisymmetric
from .levels import Level
from .rotator_curves import critical_manifold, separatrix

BranchState = Float[Array, "1 *lanes"]
FullState = Float[Array, "2 *lanes"]


def _speed(omega0: Vector) -> Real:
    """Return component 3 of ω₀; refuse other components, which a plane rotator does not have."""
    flat = (omega0[0] == 0) & (omega0[1] == 0)
    return where_valid("omega0", omega0[2], flat, "lie along axis 3 (a plane rotator)")


def _always_stops(y: Float[Array, "n *lanes"]) -> Verdict:
    """Return STOP: on the physical branch ω always decays, like (2τ)^{−1/2}."""
    zero = jnp.zeros_like(y[0])
    outcome = jnp.where(jnp.isfinite(y[0]), int(Outcome.STOP), int(Outcome.FAILED))
    return Verdict(outcome.astype("int32"), zero, zero == 0, int(Stop.AXIS))


class _Rotator(Shown):
    """An equation of the plane rotator, whose state begins with ω."""

    def omega(self, y: Float[Array, "n *lanes"]) -> Vector:
        """Return (0, 0, ω)."""
        zero = jnp.zeros_like(y[0])
        return jnp.stack([zero, zero, y[0]])

    @property
    def body(self) -> Body:
        """A body of moment 1 about axis 3, for energies and powers."""
        return axisymmetric(0.0)


class RotatorReduced(_Rotator):
    """Reduced equation (2.3): ω′ = −ω³, state (ω,). Its solution is (2.4), `exact.rotator`.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> dt.RotatorReduced()(0.0, jnp.array([0.5])).tolist()
        [-0.125]
    """

    level = Level.ORDER_1.label

    def __call__(self, t: Any, y: BranchState, args: Any = None) -> BranchState:
        """Return dω/dτ, shape (1,) or (1, B)."""
        return -(y**3)

    def lift(self, omega0: Vector) -> BranchState:
        """Return component 3 of ω₀; the others must be 0."""
        return _speed(omega0)[None]

    def verdict(self, y: BranchState) -> Verdict:
        """Return STOP, certified."""
        return _always_stops(y)._replace(equation=RotatorReduced)


class RotatorBranch(_Rotator):
    """The physical motions of the full equation: ω′ = f(ω), state (ω,), f the critical manifold."""

    level = Level.FULL.label

    def __call__(self, t: Any, y: BranchState, args: Any = None) -> BranchState:
        """Return dω/dτ, shape (1,) or (1, B)."""
        return critical_manifold(y)

    def lift(self, omega0: Vector) -> BranchState:
        """Return component 3 of ω₀; the others must be 0."""
        return _speed(omega0)[None]

    def verdict(self, y: BranchState) -> Verdict:
        """Return STOP, certified."""
        return _always_stops(y)._replace(equation=RotatorBranch)


class Domain(NamedTuple):
    """The signs of ω at the blow-ups of a full motion in the past and in the future.

    The curves AOC (`critical_manifold`) and BOD (`separatrix`) divide the phase plane into four
    domains, one for each pair of signs.
    """

    past: Int[Array, "*lanes"]
    """Sign of ω at the blow-up in the past; 0 on BOD, whose motions come from rest."""
    future: Int[Array, "*lanes"]
    """Sign of ω at the runaway in the future; 0 on AOC, whose motions stop."""


class RotatorFull(_Rotator):
    """Full equation (2.2), dimensionless (A.1): ω″ = ω′ + ω³, state (ω, ϖ = ω′).

    From a start ω₀ of shape (3,), `simulate` and `classify` follow the physical branch
    (`RotatorBranch`). A whole state (ω, ϖ) is integrated as given, and runs away.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> run = dt.classify(dt.RotatorFull(), jnp.array([1.0, 0.0]))  # off the branch
        >>> dt.Outcome(int(run.outcome)).name, f"{run.time:.4f}"  # time of the blow-up
        ('FAILED', '1.6351')
    """

    level = Level.FULL.label

    def __call__(self, t: Any, y: FullState, args: Any = None) -> FullState:
        """Return d(ω, ϖ)/dτ, shape (2,) or (2, B)."""
        return jnp.stack([y[1], y[1] + y[0] ** 3])

    def lift(self, omega0: Vector) -> FullState:
        """Return the state (ω, f(ω)) on the physical branch."""
        speed = _speed(omega0)
        return jnp.stack([speed, critical_manifold(speed)])

    def verdict(self, y: FullState) -> Verdict:
        """Return STOP, certified for a state on the physical branch."""
        return _always_stops(y)._replace(equation=RotatorFull)

    def lyapunov(self, y: FullState) -> Real:
        """Compute V = ω(ϖ − ω/2), which grows along every motion: V′ = ϖ² + ω⁴ (appendix A)."""
        return y[0] * (y[1] - y[0] / 2)

    def domain(self, y: FullState) -> Domain:
        """Return the domain of the phase plane that contains a state (ω, ϖ)."""
        past = jnp.sign(separatrix(y[0]) - y[1])
        future = jnp.sign(y[1] - critical_manifold(y[0]))
        return Domain(past.astype("int32"), future.astype("int32"))

    @property
    def branch(self) -> RotatorBranch:
        """The equation on the physical branch, which has no runaways."""
        return RotatorBranch()

    @property
    def runaway_rate(self) -> float:
        """The rate at which distances from the physical branch grow near rest."""
        return 1.0
