"""Cylindrical form of order 1 of the transverse top, and its approximations (section 4).

The state is (ω⊥, ω₃, φ) with ω = (ω⊥ cos φ, ω⊥ sin φ, ω₃). With M = 1 + δ + δ² order 1 reads
(4.9)–(4.11). Averaging over φ neglects the terms that oscillate while ω precesses fast;
linearisation keeps the first powers of ω₃ and φ near the residual line.
"""

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._base.checks import finite
from .._base.types import Real, Vector, Verdict
from ._common import Cylindrical, TransverseTop
from ._verdicts import transverse as regions
from .levels import Level


class TransverseCylindrical(Cylindrical, TransverseTop):
    """Order 1 in cylindrical variables (4.9)–(4.11), state (ω⊥, ω₃, φ).

        ω⊥′ = −(ω⊥² + Mω₃²) ω⊥ sin²φ
        ω₃′ = −{ω² + δ(2cos²φ − sin²φ)ω⊥²} ω₃/(1−δ)
        φ′  = −δω₃ − (ω⊥² + Mω₃²) sin φ cos φ,        M = 1 + δ + δ²

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    level = Level.ORDER_1.label

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return d(ω⊥, ω₃, φ)/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w, w3, phi = y
        sin, cos = jnp.sin(phi), jnp.cos(phi)
        drag = w**2 + (1 + d + d**2) * w3**2
        axial = w**2 + w3**2 + d * (2 * cos**2 - sin**2) * w**2
        return jnp.stack([-drag * w * sin**2, -axial * w3 / (1 - d), -d * w3 - drag * sin * cos])

    def verdict(self, y: Vector) -> Verdict:
        """Return the verdict of order 1 in Cartesian components."""
        verdict = regions.first_order(self.delta, self.omega(y))
        return verdict._replace(equation=TransverseCylindrical)


class TransverseAveraged(Cylindrical, TransverseTop):
    """Order 1 averaged over the precession angle (4.13)–(4.15), state (ω⊥, ω₃, φ̄).

        ω⊥′ = −½(ω⊥² + Mω₃²) ω⊥,   ω₃′ = −{(1 + δ/2)ω⊥² + ω₃²} ω₃/(1−δ),   φ̄′ = −δω₃

    All solutions stop, so there is no verdict: the averaged top has no residual rotation.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.

    Raises:
        ValueError: δ outside [−1, 1).
    """

    level = f"{Level.ORDER_1.label}, averaged"

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return d(ω⊥, ω₃, φ̄)/dτ, shape (3,) or (3, B)."""
        d = self.delta
        w, w3, _ = y
        return jnp.stack(
            [
                -(w**2 + (1 + d + d**2) * w3**2) * w / 2,
                -((1 + d / 2) * w**2 + w3**2) * w3 / (1 - d),
                -d * w3,
            ]
        )


class TransverseLinearised(Cylindrical, TransverseTop):
    """Order 1 near the residual rotation (w, 0, 0), (4.22)–(4.24), state (ω⊥, ω₃, φ).

        ω⊥′ = 0,   ω₃′ = −(1+2δ)/(1−δ) w² ω₃,   φ′ = −δω₃ − w²φ

    There is no verdict: the equation describes one final state, not which starts end there.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        w: angular velocity w of the residual rotation, dimensionless.

    Raises:
        ValueError: δ outside [−1, 1), or w not finite.
    """

    w: Real = eqx.field(converter=functools.partial(finite, "w"))

    level = f"{Level.ORDER_1.label}, linearised"

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return d(ω⊥, ω₃, φ)/dτ, shape (3,) or (3, B)."""
        d, square = self.delta, self.w**2
        _, w3, phi = y
        axial = (1 + 2 * d) / (1 - d) * square * w3
        return jnp.stack([jnp.zeros_like(w3), -axial, -d * w3 - square * phi])
