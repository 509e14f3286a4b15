"""Axisymmetric top with a longitudinal dipole (section 3.1, appendix B of the paper).

Dimensionless: I₁ = I₂ = 1, I₃ = ζ = 1 − δ, the dipole along axis 3, k d² = 1. The torque has no
component along axis 3, so ω₃ is constant at every level. The balance of torques is

    ω₁′ = ω₁″ + δω₂ω₃ − ω²ω₁ − 2ω₃ω₂′,   ω₂′ = ω₂″ − δω₁ω₃ − ω²ω₂ + 2ω₃ω₁′.

and every physical motion ends in rotation about the dipole, ω → (0, 0, ω₃).
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.linalg import components, dot
from .._base.types import Outcome, Real, Stop, Vector, Verdict
from ._common import LongitudinalTop, OfFull, OfOmega, OfOrder, first_and_second
from .levels import Level

FullState = Float[Array, "5 *lanes"]
"""(ω₁, ω₂, ω₃, ω₁′, ω₂′)."""
SLOW = 0.1  # |ω|² up to which orders 2–4 are taken to follow the physical branch


def _balance(delta: Real, w: Vector, rate: Vector, second: Vector) -> Vector:
    """Return ω′ from the balance of torques, with given ω′ and ω″ on its right-hand side."""
    w1, w2, w3 = components(w)
    p1, p2, _ = components(rate)
    s1, s2, _ = components(second)
    square = w1**2 + w2**2 + w3**2
    return jnp.stack(
        [
            s1 + delta * w2 * w3 - square * w1 - 2 * w3 * p2,
            s2 - delta * w1 * w3 - square * w2 + 2 * w3 * p1,
            jnp.zeros_like(w3),
        ]
    )


def _settled(w: Vector, certain: Bool[Array, "*lanes"], proven: bool) -> Verdict:
    """Return the verdict ω → (0, 0, ω₃) where it is certain, else undecided."""
    w3 = components(w)[2]
    rotating = w3 != 0
    outcome = jnp.where(rotating, int(Outcome.RESIDUAL), int(Outcome.STOP))
    return Verdict(
        jnp.where(certain, outcome, int(Outcome.UNDECIDED)).astype("int32"),
        jnp.where(certain, w3, jnp.nan),
        certain & proven,
        jnp.where(certain & ~rotating, int(Stop.AXIS), int(Stop.NONE)).astype("int32"),
    )


class LongitudinalReduced(OfOrder, LongitudinalTop):
    """Reduced equations (3.9)–(3.10): ω⊥′ = −(ω⊥² + ζ²ω₃²)ω⊥, φ′ = −δω₃, ω₃ constant.

    Order 1 is the paper's, in Cartesian components; `exact.longitudinal` is its solution. Order m
    inserts the rates of order m − 1 into the balance of torques.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        order: 1 … 4.

    Raises:
        ValueError: δ outside [−1, 1), or an order that is not 1, 2, 3 or 4.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> rate = dt.LongitudinalReduced(delta=0.5)(0.0, jnp.array([0.2, 0.0, 0.4]))
        >>> bool(jnp.allclose(rate, jnp.array([-0.016, -0.04, 0.0])))
        True
    """

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return dω/dτ, shape (3,) or (3, B)."""
        d = self.delta
        if self.order > 1:
            lower = LongitudinalReduced(d, self.order - 1)
            return _balance(d, y, *first_and_second(lambda w: lower(t, w), y))
        w1, w2, w3 = components(y)
        drag = w1**2 + w2**2 + ((1 - d) * w3) ** 2
        return jnp.stack([d * w2 * w3 - drag * w1, -d * w1 * w3 - drag * w2, jnp.zeros_like(w3)])

    def verdict(self, y: Vector) -> Verdict:
        """Return RESIDUAL: certified at order 1; at orders 2–4 uncertified, where |ω|² ≤ 0.1."""
        square = dot(y, y)
        certain = jnp.isfinite(square) if self.order == 1 else square <= SLOW
        verdict = _settled(y, certain, self.order == 1)
        return verdict._replace(equation=LongitudinalReduced)


class LongitudinalSemi(OfOmega, LongitudinalTop):
    """Semi-reduced equation: (1 − 2iω₃)w′ = −(ω² + δ²ω₃² + iδω₃)w of w = ω₁ + iω₂.

    Only ω″ is replaced, by its value in free precession. There are no runaways.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    level = Level.SEMI.label

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return dω/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w1, w2, w3 = components(y)
        drag = w1**2 + w2**2 + (1 + d**2) * w3**2
        r1, r2 = d * w2 * w3 - drag * w1, -d * w1 * w3 - drag * w2
        coupling = 2 * w3
        determinant = 1 + coupling**2
        p1, p2 = (r1 - coupling * r2) / determinant, (r2 + coupling * r1) / determinant
        return jnp.stack([p1, p2, jnp.zeros_like(w3)])

    def verdict(self, y: Vector) -> Verdict:
        """Return RESIDUAL, certified, since ω⊥′ = −(ω⊥² + ζ²ω₃²)ω⊥/(1 + 4ω₃²)."""
        verdict = _settled(y, jnp.isfinite(y[0] + y[1] + y[2]), True)
        return verdict._replace(equation=LongitudinalSemi)


class LongitudinalFull(OfFull, LongitudinalTop):
    """Full equations (3.6)–(3.8): the balance of torques, state (ω₁, ω₂, ω₃, ω₁′, ω₂′).

    From a start ω₀ of shape (3,), `simulate` and `classify` follow the physical branch. Distances
    from it grow at the rate 1.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    level = Level.FULL.label

    def __call__(self, t: Any, y: FullState, args: Any = None) -> FullState:
        """Return dy/dτ, shape (5,) or (5, B)."""
        rate = jnp.stack([y[3], y[4], jnp.zeros_like(y[2])])
        balance = _balance(self.delta, y[:3], rate, jnp.zeros_like(rate))  # ω′ − ω″
        return jnp.concatenate([rate, (rate - balance)[:2]])

    def verdict(self, y: FullState) -> Verdict:
        """Return RESIDUAL, uncertified, for a state on the physical branch.

        By the balance of energy a bounded motion ends where the radiated power |d₂|² vanishes,
        which is rotation about the dipole. It is not proven that the branch continues to that end.
        """
        verdict = _settled(y[:3], jnp.isfinite(y[0] + y[1] + y[2]), False)
        return verdict._replace(equation=LongitudinalFull)

    def fast(self, omega_dot: Vector) -> Float[Array, "2 *lanes"]:
        """Return the fast part of ω′, which is a part of the state: (ω₁′, ω₂′)."""
        return omega_dot[:2]

    def reduced(self, order: int) -> LongitudinalReduced:
        """Return the reduced level of that order."""
        return LongitudinalReduced(self.delta, order)

    @property
    def semi(self) -> LongitudinalSemi:
        """The semi-reduced level."""
        return LongitudinalSemi(self.delta)

    @property
    def runaway_rate(self) -> Real:
        """The rate at which distances from the physical branch grow near rest."""
        return jnp.ones_like(self.delta)
