"""Axisymmetric top with a transverse dipole (section 4 of the paper): closed forms.

Dimensionless: I₁ = I₂ = 1, I₃ = 1 − δ, the dipole along axis 1, k d² = 1. The balance of
torques, with ω₁′ = δ ω₂ω₃ exact at every level, is

    ω₂′        = ω₂″ − δω₁ω₃ − ω²ω₂ − ω₁′ω₃ − 2ω₁ω₃′
    (1−δ)ω₃′   = ω₃″ − ω²ω₃ + ω₁′ω₂ + 2ω₁ω₂′

and the levels differ in what they put for ω′ and ω″ on the right.
"""

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import finite, refuse, where_valid
from .._base.types import Real, Vector, Verdict
from ..bodies import Body, axisymmetric
from ._common import check_order, one_order_up, reciprocal, shape_parameter, unchanged
from ._verdicts import transverse as _regions
from .levels import Level


def top(self: Any) -> Body:
    """The top that the equation moves, for energies and powers."""
    return axisymmetric(self.delta)


def to_cylindrical(self: Any, omega0: Vector) -> Vector:
    """(ω⊥, ω₃, φ) of a Cartesian ω."""
    w1, w2, w3 = omega0
    return jnp.stack([jnp.hypot(w1, w2), w3, jnp.arctan2(w2, w1)])


def to_cartesian(self: Any, y: Vector) -> Vector:
    """ω of a state (ω⊥, ω₃, φ)."""
    return from_cylindrical(y[0], y[1], y[2])


def scales(omega: Vector) -> Vector:
    """What errors of ω are measured by: ω₁ and ω₂ by ω⊥, ω₃ by itself or by ω⊥ min(ω⊥, 1).

    Near the residual line, and at a capture, ω₃ ~ ω⊥² where that is small.
    """
    w1, w2, w3 = jnp.abs(omega)
    across = jnp.maximum(w1, w2)
    return jnp.stack([across, across, jnp.maximum(w3, across * jnp.minimum(across, 1.0))])


def _balance(delta: Real, w: Vector, rate: Vector, second: Vector) -> Vector:
    """ω′ from the balance of torques, with ω′ and ω″ on its right given."""
    w1, w2, w3 = w
    p1, p2, p3 = rate
    square = w1**2 + w2**2 + w3**2
    return jnp.stack(
        [
            delta * w2 * w3,
            second[1] - delta * w1 * w3 - square * w2 - p1 * w3 - 2 * w1 * p3,
            (second[2] - square * w3 + p1 * w2 + 2 * w1 * p2) * reciprocal(1 - delta),
        ]
    )


def _reduced(delta: Real, w: Vector, order: int) -> Vector:
    """ω′ of a reduced level."""
    if order > 1:

        def lower(t: Any, w: Vector) -> Vector:
            return _reduced(delta, w, order - 1)

        return _balance(delta, w, *one_order_up(lower, 0.0, w))
    # What depends on δ alone stands together: the stages of a step share it.
    d, (w1, w2, w3) = delta, w
    turn = d * w3
    drag = w1**2 + w2**2 + (1 + d + d**2) * w3**2
    light = reciprocal(1 - d)
    axial = (1 + 2 * d) * light * w1**2 + w2**2 + light * w3**2
    return jnp.stack([turn * w2, -turn * w1 - drag * w2, -axial * w3])


class TransverseReduced(eqx.Module):
    """Reduced equation (4.2)–(4.4): ω₁′ = δω₂ω₃, ω₂′ = −δω₁ω₃ − {ω² + δ(1+δ)ω₃²}ω₂, ….

    Order 1 is the paper's. Order m puts the rates of order m − 1 into the balance of torques:
    the asymptotic expansion of the physical branch of the full equation.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        order: 1 … 4.

    Raises:
        ValueError: δ outside [−1, 1), or an order that is not 1, 2, 3 or 4.

    Example:
        Where ω₃ = 0 it stays so, ω₁ is constant, and ω₂′ = −ω²ω₂:

        >>> import jax.numpy as jnp, dipoletop as dt
        >>> rate = dt.TransverseReduced(delta=-0.2)(0.0, jnp.array([0.3, 0.4, 0.0]))
        >>> bool(jnp.allclose(rate, jnp.array([0.0, -0.1, 0.0])))
        True
    """

    delta: Real = eqx.field(converter=shape_parameter)
    order: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        check_order(self.order)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """dω/dτ, shape (3,) or (3, B)."""
        return _reduced(self.delta, y, self.order)

    lift = omega = unchanged
    scales = staticmethod(scales)

    def verdict(self, y: Vector) -> Verdict:
        """Order 1: the proven regions. Orders 2–4: those of the semi-reduced level, uncertified."""
        found = _regions.of_level(self.delta, y, Level.of_order(self.order))
        return found._replace(equation=TransverseReduced)

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.of_order(self.order).label


class TransverseSemi(eqx.Module):
    """Semi-reduced equation: only ω″ is replaced, by that of free precession.

        [[1, 2ω₁], [−2ω₁, 1−δ]] (ω₂′, ω₃′)ᵀ
            = (−δω₁ω₃ − ω²ω₂ − δ(1+δ)ω₂ω₃², −ω²ω₃ + δω₂²ω₃)ᵀ,   ω₁′ = δω₂ω₃.

    It has no runaways, and no spurious threshold at δ = −1/2.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    delta: Real = eqx.field(converter=shape_parameter)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """dω/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w1, w2, w3 = y
        square = w1**2 + w2**2 + w3**2
        r2 = -d * w1 * w3 - (square + d * (1 + d) * w3**2) * w2
        r3 = (d * w2**2 - square) * w3
        inverse = reciprocal(1 - d + 4 * w1**2)
        p2 = ((1 - d) * r2 - 2 * w1 * r3) * inverse
        p3 = (r3 + 2 * w1 * r2) * inverse
        return jnp.stack([d * w2 * w3, p2, p3])

    lift = omega = unchanged
    scales = staticmethod(scales)

    def verdict(self, y: Vector) -> Verdict:
        """The regions of the semi-reduced level: residual, rotating stop, wobbling stop."""
        return _regions.semi_reduced(self.delta, y)._replace(equation=TransverseSemi)

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.SEMI.label


class TransverseFull(eqx.Module):
    """Full equation: the balance of torques itself, state (ω₁, ω₂, ω₃, ω₂′, ω₃′).

    Physical motions lie on a slow manifold that repels forwards in time (runaway rates 1 and
    1 − δ); this is the vector field.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    delta: Real = eqx.field(converter=shape_parameter)

    def __call__(
        self, t: Any, y: Float[Array, "5 *lanes"], args: Any = None
    ) -> Float[Array, "5 *lanes"]:
        """dy/dτ, shape (5,) or (5, B)."""
        w, p2, p3 = y[:3], y[3], y[4]
        zero = jnp.zeros_like(w)
        rate = self.omega_dot(y)
        balance = _balance(self.delta, w, rate, zero)  # ω′ − (0, ω₂″, ω₃″/(1−δ))
        return jnp.stack([rate[0], p2, p3, p2 - balance[1], (1 - self.delta) * (p3 - balance[2])])

    def lift(self, omega0: Vector) -> Float[Array, "5 *lanes"]:
        """Onto the physical branch as the reduction of order 3 has it: error O(ω⁹) at most."""
        rate = TransverseReduced(self.delta, 3)(0.0, omega0)
        return jnp.concatenate([omega0, rate[1:]])

    def omega(self, y: Float[Array, "5 *lanes"]) -> Vector:
        """The first three components."""
        return y[:3]

    def verdict(self, y: Float[Array, "5 *lanes"]) -> Verdict:
        """That of a state on the physical branch: the semi-reduced regions, uncertified."""
        return _regions.full(self.delta, self.omega(y))._replace(equation=TransverseFull)

    scales = staticmethod(scales)

    def fast(self, omega_dot: Vector) -> Float[Array, "2 *lanes"]:
        """The part of ω′ that is state, and runs away: (ω₂′, ω₃′)."""
        return omega_dot[1:]

    def omega_dot(self, y: Float[Array, "5 *lanes"]) -> Vector:
        """ω′ of a state."""
        return jnp.stack([self.delta * y[1] * y[2], y[3], y[4]])

    def reduced(self, order: int) -> TransverseReduced:
        """The reduced level of that order."""
        return TransverseReduced(self.delta, order)

    @property
    def semi(self) -> TransverseSemi:
        """The semi-reduced level."""
        return TransverseSemi(self.delta)

    @property
    def runaway_rate(self) -> Real:
        """The slower of the rates at which what is off the physical branch grows: 1 and 1 − δ."""
        return jnp.minimum(1.0, 1 - self.delta)

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.FULL.label


def equation_at(
    level: Level | str, delta: Any
) -> TransverseReduced | TransverseSemi | TransverseFull:
    """The equation of the transverse top at a level.

    Args:
        level: a `Level`, or its word.
        delta: δ = 1 − I₃/I₁, from −1 (a disc) up to but not 1 (a needle).

    Raises:
        ValueError: an unknown level, or δ out of range.

    Example:
        >>> import dipoletop as dt
        >>> dt.equation_at(dt.Level.ORDER_2, -0.2).level
        'reduced, order 2'
    """
    level = Level.named(level)
    if level.order is not None:
        return TransverseReduced(delta, level.order)
    return TransverseSemi(delta) if level is Level.SEMI else TransverseFull(delta)


class TransverseCylindrical(eqx.Module):
    """Order 1 in cylindrical variables (4.9)–(4.11), state (ω⊥, ω₃, φ).

        ω⊥′ = −(ω⊥² + Mω₃²) ω⊥ sin²φ
        ω₃′ = −{ω² + δ(2cos²φ − sin²φ)ω⊥²} ω₃/(1−δ)
        φ′  = −δω₃ − (ω⊥² + Mω₃²) sin φ cos φ,        M = 1 + δ + δ²

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    delta: Real = eqx.field(converter=shape_parameter)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """d(ω⊥, ω₃, φ)/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w, w3, phi = y
        sin, cos = jnp.sin(phi), jnp.cos(phi)
        drag = w**2 + (1 + d + d**2) * w3**2
        axial = w**2 + w3**2 + d * (2 * cos**2 - sin**2) * w**2
        return jnp.stack([-drag * w * sin**2, -axial * w3 / (1 - d), -d * w3 - drag * sin * cos])

    lift, omega = to_cylindrical, to_cartesian
    scales = staticmethod(scales)

    def verdict(self, y: Vector) -> Verdict:
        """As order 1 in Cartesian components."""
        found = _regions.first_order(self.delta, self.omega(y))
        return found._replace(equation=TransverseCylindrical)

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.ORDER_1.label


class TransverseAveraged(eqx.Module):
    """Order 1 averaged over the precession angle (4.13)–(4.15), state (ω⊥, ω₃, φ̄).

        ω⊥′ = −½(ω⊥² + Mω₃²) ω⊥,   ω₃′ = −{(1 + δ/2)ω⊥² + ω₃²} ω₃/(1−δ),   φ̄′ = −δω₃

    Its solutions always stop, so it has no verdict: it cannot show a residual rotation.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    delta: Real = eqx.field(converter=shape_parameter)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """d(ω⊥, ω₃, φ̄)/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w, w3, _ = y
        return jnp.stack(
            [
                -(w**2 + (1 + d + d**2) * w3**2) * w / 2,
                -((1 + d / 2) * w**2 + w3**2) * w3 / (1 - d),
                -d * w3,
            ]
        )

    lift, omega = to_cylindrical, to_cartesian

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return f"{Level.ORDER_1.label}, averaged"


class TransverseLinearised(eqx.Module):
    """Order 1 near the residual rotation (w, 0, 0), (4.22)–(4.24), state (ω⊥, ω₃, φ).

        ω⊥′ = 0,   ω₃′ = −(1+2δ)/(1−δ) w² ω₃,   φ′ = −δω₃ − w²φ

    It has no verdict: it is about one end, and cannot say which starts come to it.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        w: angular velocity w of the residual rotation, dimensionless.

    Raises:
        ValueError: δ outside [−1, 1), or w not finite.
    """

    delta: Real = eqx.field(converter=shape_parameter)
    w: Real = eqx.field(converter=functools.partial(finite, "w"))

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """d(ω⊥, ω₃, φ)/dτ, shape (3,) or (3, B)."""
        d, square = self.delta, self.w**2
        _, w3, phi = y
        axial = (1 + 2 * d) / (1 - d) * square * w3
        return jnp.stack([jnp.zeros_like(w3), -axial, -d * w3 - square * phi])

    lift, omega = to_cylindrical, to_cartesian

    body = property(top)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return f"{Level.ORDER_1.label}, linearised"


def cylindrical(w_perp: Any, w3: Any, phi: Any) -> Vector:
    """Angular velocity ω = (ω⊥ cos φ, ω⊥ sin φ, ω₃) in body axes.

    Args:
        w_perp: ω⊥ ≥ 0 across the symmetry axis, dimensionless.
        w3: ω₃ along the symmetry axis, dimensionless.
        phi: φ from the dipole, radians.

    Returns:
        Shape (3,), or (3, B) for arguments of shape (B,).

    Raises:
        ValueError: ω⊥ < 0, or a value that is not finite. A traced one gives NaN.

    Example:
        >>> import dipoletop as dt
        >>> dt.cylindrical(w_perp=0.2, w3=0.1, phi=0.0)
        Array([0.2, 0. , 0.1], dtype=float64)
    """
    across = finite("w_perp", w_perp)
    across = where_valid("w_perp", across, across >= 0, "not be negative")
    given = across, finite("w3", w3), finite("phi", phi)
    if len({x.shape for x in given} - {()}) > 1:
        shapes = ", ".join(str(x.shape) for x in given)
        refuse("w_perp", "have, with `w3` and `phi`, one batch size", f"they have shapes {shapes}")
    return from_cylindrical(*jnp.broadcast_arrays(*given))


def from_cylindrical(w: Real, axial: Real, angle: Real) -> Vector:
    """ω of cylindrical variables of one shape; a right angle gives a component of exactly 0."""
    quarter = jnp.round(angle / (jnp.pi / 2))
    rest = angle - quarter * (jnp.pi / 2)  # exactly 0 at multiples of π/2, where ω₁ or ω₂ is 0
    cos, sin = jnp.cos(rest), jnp.sin(rest)
    turn = jnp.mod(quarter, 4)
    w1 = jnp.select([turn == 0, turn == 1, turn == 2], [cos, -sin, -cos], sin)
    w2 = jnp.select([turn == 0, turn == 1, turn == 2], [sin, cos, -sin], -cos)
    return jnp.stack([w * w1, w * w2, axial])
