"""Axisymmetric top with a transverse dipole (section 4 of the paper): closed forms.

Dimensionless: I₁ = I₂ = 1, I₃ = 1 − δ, the dipole along axis 1, k d² = 1. The torque has no
component along the dipole, so ω₁′ = δω₂ω₃ at every level. The other components of the balance of
torques are

    ω₂′        = ω₂″ − δω₁ω₃ − ω²ω₂ − ω₁′ω₃ − 2ω₁ω₃′
    (1−δ)ω₃′   = ω₃″ − ω²ω₃ + ω₁′ω₂ + 2ω₁ω₂′

and the levels differ in the ω′ and ω″ that they insert on the right.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.linalg import components
from .._base.types import Real, Vector, Verdict
from ._common import OfFull, OfOmega, OfOrder, TransverseTop, first_and_second, reciprocal
from ._verdicts import transverse as regions
from .levels import Level

FullState = Float[Array, "5 *lanes"]
"""(ω₁, ω₂, ω₃, ω₂′, ω₃′)."""


def _balance(delta: Real, w: Vector, rate: Vector, second: Vector) -> Vector:
    """Return ω′ from the balance of torques, with given ω′ and ω″ on its right-hand side."""
    w1, w2, w3 = components(w)
    p1, p2, p3 = components(rate)
    _, s2, s3 = components(second)
    square = w1**2 + w2**2 + w3**2
    return jnp.stack(
        [
            delta * w2 * w3,
            s2 - delta * w1 * w3 - square * w2 - p1 * w3 - 2 * w1 * p3,
            (s3 - square * w3 + p1 * w2 + 2 * w1 * p2) * reciprocal(1 - delta),
        ]
    )


def _reduced(delta: Real, w: Vector, order: int) -> Vector:
    """Return ω′ of a reduced level."""
    if order > 1:
        rate, second = first_and_second(lambda w: _reduced(delta, w, order - 1), w)
        return _balance(delta, w, rate, second)
    # Factors of δ alone are grouped, so that all stages of a step share them.
    d, (w1, w2, w3) = delta, components(w)
    precession = d * w3
    drag = w1**2 + w2**2 + (1 + d + d**2) * w3**2
    inverse = reciprocal(1 - d)
    axial = (1 + 2 * d) * inverse * w1**2 + w2**2 + inverse * w3**2
    return jnp.stack([precession * w2, -precession * w1 - drag * w2, -axial * w3])


class TransverseReduced(OfOrder, TransverseTop):
    """Reduced equation (4.2)–(4.4): ω₁′ = δω₂ω₃, ω₂′ = −δω₁ω₃ − {ω² + δ(1+δ)ω₃²}ω₂, ….

    Order 1 is the paper's. Order m inserts the rates of order m − 1 into the balance of torques.
    The sequence is the asymptotic expansion of the physical branch of the full equation.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        order: 1 … 4.

    Raises:
        ValueError: δ outside [−1, 1), or an order that is not 1, 2, 3 or 4.

    Example:
        The plane ω₃ = 0 is invariant; in it ω₁ is constant and ω₂′ = −ω²ω₂:

        >>> import jax.numpy as jnp, dipoletop as dt
        >>> rate = dt.TransverseReduced(delta=-0.2)(0.0, jnp.array([0.3, 0.4, 0.0]))
        >>> bool(jnp.allclose(rate, jnp.array([0.0, -0.1, 0.0])))
        True
    """

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return dω/dτ, shape (3,) or (3, B)."""
        return _reduced(self.delta, y, self.order)

    def verdict(self, y: Vector) -> Verdict:
        """Return the verdict: certified at order 1; by semi-reduced regions at orders 2–4."""
        verdict = regions.of_level(self.delta, y, Level.of_order(self.order))
        return verdict._replace(equation=TransverseReduced)


class TransverseSemi(OfOmega, TransverseTop):
    """Semi-reduced equation: only ω″ is replaced, by its value in free precession.

        [[1, 2ω₁], [−2ω₁, 1−δ]] (ω₂′, ω₃′)ᵀ
            = (−δω₁ω₃ − ω²ω₂ − δ(1+δ)ω₂ω₃², −ω²ω₃ + δω₂²ω₃)ᵀ,   ω₁′ = δω₂ω₃.

    There are no runaways, and no spurious threshold at δ = −1/2.

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
        square = w1**2 + w2**2 + w3**2
        r2 = -d * w1 * w3 - (square + d * (1 + d) * w3**2) * w2
        r3 = (d * w2**2 - square) * w3
        inverse = reciprocal(1 - d + 4 * w1**2)
        p2 = ((1 - d) * r2 - 2 * w1 * r3) * inverse
        p3 = (r3 + 2 * w1 * r2) * inverse
        return jnp.stack([d * w2 * w3, p2, p3])

    def verdict(self, y: Vector, numbers: regions.ShapeNumbers | None = None) -> Verdict:
        """Return residual rotation, a rotating or a wobbling stop, by semi-reduced regions."""
        return regions.semi_reduced(self.delta, y, numbers)._replace(equation=TransverseSemi)

    def prepare(self) -> regions.ShapeNumbers:
        """Return the numbers that verdicts need and that depend on δ alone."""
        return regions.shape_numbers(self.delta)


class TransverseFull(OfFull, TransverseTop):
    """Full equation: the balance of torques itself, state (ω₁, ω₂, ω₃, ω₂′, ω₃′).

    Physical motions lie on a slow manifold that repels forwards in time, at the rates 1 and 1 − δ
    near rest. This class is the vector field; `simulate` and `classify` follow the manifold.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    level = Level.FULL.label

    def __call__(self, t: Any, y: FullState, args: Any = None) -> FullState:
        """Return dy/dτ, shape (5,) or (5, B)."""
        _, w2, w3, p2, p3 = components(y)
        p1 = self.delta * w2 * w3
        rate = jnp.stack([p1, p2, p3])
        # ω′ − (0, ω₂″, ω₃″/(1−δ))
        _, r2, r3 = components(_balance(self.delta, y[:3], rate, jnp.zeros_like(rate)))
        return jnp.stack([p1, p2, p3, p2 - r2, (1 - self.delta) * (p3 - r3)])

    def verdict(self, y: FullState) -> Verdict:
        """Return the verdict on a state of the physical branch, uncertified."""
        return regions.full(self.delta, self.omega(y))._replace(equation=TransverseFull)

    def fast(self, omega_dot: Vector) -> Float[Array, "2 *lanes"]:
        """Return the fast part of ω′, which is a part of the state: (ω₂′, ω₃′)."""
        return omega_dot[1:]

    def reduced(self, order: int) -> TransverseReduced:
        """Return the reduced level of that order."""
        return TransverseReduced(self.delta, order)

    @property
    def semi(self) -> TransverseSemi:
        """The semi-reduced level."""
        return TransverseSemi(self.delta)

    @property
    def runaway_rate(self) -> Real:
        """The slower of the rates 1 and 1 − δ at which distances from the branch grow near rest."""
        return jnp.minimum(1.0, 1 - self.delta)


def equation_at(
    level: Level | str, delta: Any
) -> TransverseReduced | TransverseSemi | TransverseFull:
    """Return the equation of the transverse top at a level.

    Args:
        level: a `Level`, or its value, such as "semi".
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Returns:
        The equation of motion.

    Raises:
        ValueError: an unknown level, or δ outside [−1, 1).

    Example:
        >>> import dipoletop as dt
        >>> dt.equation_at(dt.Level.ORDER_2, -0.2).level
        'reduced, order 2'
    """
    level = Level.named(level)
    if level.order is not None:
        return TransverseReduced(delta, level.order)
    return TransverseSemi(delta) if level is Level.SEMI else TransverseFull(delta)
