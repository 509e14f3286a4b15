"""Exact solutions and asymptotics of the rotator and of the axisymmetric top.

All quantities are dimensionless and in body axes; τ = 0 at the initial condition ω₀. A negative
time is refused (NaN, if traced).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import finite, on_host, real, where_valid
from .._base.compiling import compiled_soon
from .._base.refusals import refuse
from .._base.types import Real, Vector
from ..equations._common import shape_parameter
from ..equations.coordinates import from_cylindrical
from .averaged_quadrature import AveragedOrbit, mesh, solve

Times = Float[Array, "*n"]


def rotator(w: Any, tau: Any) -> Times:
    """Compute ω = ω₀/√(1 + 2ω₀²τ), the reduced plane rotator (2.4).

    Args:
        w: ω₀, one number.
        tau: τ, shape () or (T,).

    Returns:
        ω, of the shape of `tau`.

    Raises:
        ValueError: a value that is not finite, or τ < 0.

    Example:
        >>> import dipoletop as dt
        >>> print(f"{dt.exact.rotator(1.0, 4.0):.6f}")
        0.333333
    """
    w0, time = finite("w", w, batch=False), _times(tau)
    return w0 * _decay_factor(w0**2, jnp.zeros(()), time)


def rotator_closed_time(w: Any) -> Times:
    """Compute G(ω) = √(1+2ω²)/(2ω²) + arsinh(1/(√2 ω)), τ − τᵢ = G(ω) − G(ωᵢ).

    This is the solution of ω′ = f(ω) with f by `closed_manifold`.

    Args:
        w: ω > 0, any shape.

    Returns:
        G, of the shape of ω, in units of τ₀.

    Raises:
        ValueError: ω ≤ 0, or a value that is not real.
    """
    array = real("w", w, np.shape(w))
    array = where_valid("w", array, on_host(array) > 0, "be positive")
    return jnp.sqrt(1 + 2 * array**2) / (2 * array**2) + jnp.arcsinh(1 / (jnp.sqrt(2) * array))


def rotator_late(tau: Any) -> Times:
    """Compute ω → (2τ)^{−1/2} [1 + 3 ln(2τ)/(4τ)], the late physical motion of the rotator (A.4).

    The logarithm is missing in the paper. The neglected terms, O(1/τ) in the bracket, depend on ω₀.

    Args:
        tau: τ > 0, shape () or (T,).

    Returns:
        ω, of the shape of τ.

    Raises:
        ValueError: τ < 0, or a value that is not finite.
    """
    time = _times(tau)
    return (1 + 3 * jnp.log(2 * time) / (4 * time)) / jnp.sqrt(2 * time)


def longitudinal(delta: Any, omega0: Any, tau: Any) -> Float[Array, "*n 3"]:
    """Compute ω⊥ = s/√((1 + s²/u₀)e^{2s²τ} − 1), s = ζω₃, φ = φ₀ − δω₃τ, ω₃ constant (3.11)–(3.12).

    Order 1. The limits s → 0 are included: a rod, δ = 1, and ω₃ = 0 (3.13).

    Args:
        delta: shape δ = 1 − ζ in [−1, 1], including 1, a rod without inertia about its axis.
        omega0: ω₀, shape (3,).
        tau: τ, shape () or (T,).

    Returns:
        ω, shape (3,) or (T, 3).

    Raises:
        ValueError: δ outside [−1, 1], a value that is not finite, or τ < 0.

    Example:
        >>> import dipoletop as dt
        >>> dt.exact.longitudinal(1.0, [0.3, 0.4, 0.0], 48.0).round(12).tolist()
        [0.06, 0.08, 0.0]
    """
    d = real("delta", delta, batch=False)
    d = where_valid("delta", d, (on_host(d) >= -1) & (on_host(d) <= 1), "lie in [-1, 1]")
    return _longitudinal(d, finite("omega0", omega0, (3,), batch=False), _times(tau))


@compiled_soon
def _longitudinal(d: Real, omega0: Vector, time: Times) -> Float[Array, "*n 3"]:
    w1, w2, w3 = omega0
    factor = _decay_factor(w1**2 + w2**2, (1 - d) * w3, time)
    angle = d * w3 * time
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    across = factor * (w1 * cos + w2 * sin), factor * (w2 * cos - w1 * sin)
    return jnp.stack([*across, jnp.full_like(time, w3)], axis=-1)


def longitudinal_exponents(delta: Any, w3: Any) -> tuple[Times, Times, Times]:
    """Compute α₋, α₊ = ½ ∓ ½√(½(1 + √(1+16s²))) and B = s/(1 − 2α₋), s = ζω₃ (B.10)–(B.11).

    In the full equation ω⊥ ~ e^{α₋τ} and φ′ → B − ω₃ on the physical branch; off it, ω⊥ ~ e^{α₊τ}.

    Args:
        delta: shape δ in [−1, 1).
        w3: ω₃, any shape.

    Returns:
        α₋, α₊ and B, each of the shape of ω₃.

    Raises:
        ValueError: δ outside [−1, 1), or a value that is not real.
    """
    s = (1 - shape_parameter(delta)) * real("w3", w3, np.shape(w3))
    inner = jnp.sqrt(1 + 16 * s**2)
    outer = jnp.sqrt((1 + inner) / 2)
    alpha = -4 * s**2 / ((1 + inner) * (1 + outer))  # α₋ = (1 − outer)/2, without cancellation
    return alpha, 1 - alpha, s / outer


def transverse(delta: Any, omega0: Any, tau: Any) -> Float[Array, "*n 3"]:
    """Compute the closed solutions of order 1 of the transverse top: (4.5), (4.6), and the sphere.

        ω₃ = 0, or δ = 0:   ω₁ constant, x = |(ω₂, ω₃)|:  x′ = −(ω₁² + x²)x
        ω⊥ = 0:             ω₃ = ω₃₀/√(1 + 2ω₃₀²τ/(1−δ))

    Args:
        delta: shape δ in [−1, 1).
        omega0: ω₀, shape (3,); on ω₃ = 0 or on ω⊥ = 0, unless δ = 0.
        tau: τ, shape () or (T,).

    Returns:
        ω, shape (3,) or (T, 3).

    Raises:
        ValueError: a start without a closed solution, δ outside [−1, 1), τ < 0.

    Example:
        >>> import dipoletop as dt
        >>> dt.exact.transverse(0.5, [0.0, 0.0, 1.0], 0.75).tolist()
        [0.0, 0.0, 0.5]
    """
    d = shape_parameter(finite("delta", delta, batch=False))
    w = finite("omega0", omega0, (3,), batch=False)
    known = on_host(w)
    solvable = (known[2] == 0) | ((known[0] == 0) & (known[1] == 0)) | (on_host(d) == 0)
    must = "have ω₃ = 0 or ω₁ = ω₂ = 0 where δ is not 0, to be solved"
    return _transverse(d, where_valid("omega0", w, solvable, must), _times(tau))


@compiled_soon
def _transverse(d: Real, omega0: Vector, time: Times) -> Float[Array, "*n 3"]:
    w1, w2, w3 = omega0
    axial = (w1 == 0) & (w2 == 0)
    in_plane = _decay_factor(w2**2 + w3**2, w1, time)
    on_axis = _decay_factor(w3**2, jnp.zeros(()), time / (1 - d))
    factor = jnp.where(axial, on_axis, in_plane)
    return jnp.stack([jnp.full_like(time, w1), w2 * factor, w3 * factor], axis=-1)


def averaged(delta: Any, omega0: Any, tau: Any) -> Float[Array, "*n 3"]:
    """Compute the averaged transverse top (4.13)–(4.15) at given times, by (4.16)–(4.19).

        v = Cξ^{−q}|(1+2δ)ξ + 1+δ³|^p,   u = ξv,   τ = (1−δ) ∫ dξ/{ξv[(1+2δ)ξ + 1+δ³]}

    with u = ω⊥², v = ω₃², ξ = u/v, q = 2/(1+δ³) and the corrected exponent
    p = δ(1−δ)(3+3δ+δ²)/[(1+2δ)(1+δ³)]; the limits δ = −1, −1/2, 0 are included. The time integral
    is inverted by bisection and a step of Newton's method.

    Args:
        delta: shape δ in [−1, 1).
        omega0: ω₀, shape (3,).
        tau: τ, shape () or (T,).

    Returns:
        ω, shape (3,) or (T, 3), with the averaged angle φ̄.

    Raises:
        ValueError: δ outside [−1, 1), a value that is not finite, or τ < 0.

    Example:
        >>> import dipoletop as dt
        >>> late = dt.exact.averaged(0.3, [0.2, 0.0, 0.2], 1e8)  # ω⊥² → 1/τ, (4.21)
        >>> print(f"{late[0] ** 2 + late[1] ** 2:.3e}")
        1.000e-08
    """
    d = shape_parameter(finite("delta", delta, batch=False))
    return _averaged(d, finite("omega0", omega0, (3,), batch=False), _times(tau))


@compiled_soon
def _averaged(d: Real, w: Vector, time: Times) -> Float[Array, "*n 3"]:
    u, v = w[0] ** 2 + w[1] ** 2, w[2] ** 2
    off_axes = (u > 0) & (v > 0)
    orbit = AveragedOrbit(d, jnp.where(off_axes, u, 1.0), jnp.where(off_axes, v, 1.0))
    point, turned = solve(orbit, jnp.atleast_1d(time))
    # If u or v is 0, the other has a closed solution.
    across = _decay_factor(u / 2, jnp.zeros(()), time)
    along = _decay_factor(v, jnp.zeros(()), time / (1 - d))
    across = jnp.where(off_axes, jnp.exp(point.log_u / 2).reshape(time.shape), across)
    along = jnp.where(off_axes, jnp.exp(point.log_v / 2).reshape(time.shape), along)
    angle = jnp.arctan2(w[1], w[0]) - d * jnp.sign(w[2]) * jnp.where(
        off_axes, turned.reshape(time.shape), 0.0
    )
    omega = from_cylindrical(jnp.sqrt(u) * across, w[2] * along, angle)
    return jnp.moveaxis(omega, 0, -1)


def averaged_time(delta: Any, omega0: Any, xi: Any) -> Float[Array, ""]:
    """Compute the time at which ω⊥²/ω₃² of the averaged top reaches ξ, by the integral (4.17).

    Args:
        delta: shape δ in [−1, 1).
        omega0: ω₀, shape (3,), with ω⊥ ≠ 0 and ω₃ ≠ 0.
        xi: ξ, one number, between ξ₀ and its limit for τ → ∞: ξ* = −(1+δ³)/(1+2δ) for δ < −1/2,
            ∞ otherwise.

    Returns:
        τ ≥ 0.

    Raises:
        ValueError: ξ outside that interval, or a start on an axis.
    """
    d = shape_parameter(finite("delta", delta, batch=False))
    w = finite("omega0", omega0, (3,), batch=False)
    u, v = w[0] ** 2 + w[1] ** 2, w[2] ** 2
    where_valid("omega0", w, (u > 0) & (v > 0), "have ω⊥ ≠ 0 and ω₃ ≠ 0")
    orbit = AveragedOrbit(d, u, v)
    x = orbit.parameter(finite("xi", xi, batch=False))
    x = where_valid("xi", jnp.where(x >= 0, x, jnp.nan), x >= 0, "lie between ξ₀ and its limit")
    return mesh(orbit, x)[1][-1]


def averaged_late(delta: Any, omega0: Any, tau: Any) -> tuple[Times, Times]:
    """Compute ω⊥² and ω₃² of the averaged top for τ → ∞, to leading order: (4.20), (4.21).

        −1 < δ < −1/2:  v → (1−δ)/{[(2+δ)ξ* + 2]τ},  u → ξ*v,  ξ* = −(1+δ³)/(1+2δ)
        −1/2 < δ < 1:   u → 1/τ,  v → K(Kτ)^{−(2+δ)/(1−δ)},  K = C(1+2δ)^p
        δ = −1/2:       u → 1/τ,  v → (12/7)/(τ ln τ)
        δ = −1:         u → 2/(τ ln τ),  v → 1/τ

    The logarithms of the last two cases are missing in the paper.

    Args:
        delta: shape δ in [−1, 1), one number.
        omega0: ω₀, shape (3,), with ω⊥ ≠ 0 and ω₃ ≠ 0.
        tau: τ > 1, shape () or (T,).

    Returns:
        ω⊥² and ω₃², each of the shape of τ.

    Raises:
        ValueError: δ outside [−1, 1), a value that is not finite, or τ < 0.
    """
    d = shape_parameter(finite("delta", delta, batch=False))
    return _averaged_late(d, finite("omega0", omega0, (3,), batch=False), _times(tau))


@compiled_soon
def _averaged_late(d: Real, w: Vector, time: Times) -> tuple[Times, Times]:
    a, b = 1 + 2 * d, 1 + d**3
    xi = (w[0] ** 2 + w[1] ** 2) / w[2] ** 2
    # K from ln v = ln K − (2+δ)/a ln ξ, which (4.16) becomes for large ξ.
    positive_a = jnp.where(a > 0, a, 1.0)
    p = d * (1 - d) * (3 + 3 * d + d**2) / (positive_a * jnp.where(b > 0, b, 1.0))
    k = w[2] ** 2 * xi ** ((2 + d) / positive_a) * (1 + b / (positive_a * xi)) ** -p
    xi_limit = -b / jnp.where(a < 0, a, -1.0)
    v_oblate = (1 - d) / (((2 + d) * xi_limit + 2) * time)
    log = jnp.log(time)
    cases = [d == -1, d < -0.5, d == -0.5]
    u = jnp.select(cases, [2 / (time * log), xi_limit * v_oblate, 1 / time], 1 / time)
    v_power = k * (k * time) ** (-(2 + d) / (1 - d))
    return u, jnp.select(cases, [1 / time, v_oblate, 12 / (7 * time * log)], v_power)


@compiled_soon
def _decay_factor(u: Float[Array, ""], s: Float[Array, ""], time: Times) -> Times:
    """Compute √(u/u₀) of u′ = −2(s² + u)u: e^{−s²τ}/√(1 + 2u₀τ (1 − e^{−2s²τ})/(2s²τ))."""
    x = 2 * s**2 * time
    divisor = jnp.where(x > 0, x, 1.0)
    mean = jnp.where(x > 0, -jnp.expm1(-divisor) / divisor, 1.0)
    return jnp.exp(-x / 2) / jnp.sqrt(1 + 2 * u * time * mean)


def _times(tau: Any) -> Times:
    """Return τ ≥ 0 as an array of at least one time."""
    time = finite("tau", tau)
    if time.size == 0:
        refuse("tau", "hold at least one time", "holds none")
    return where_valid("tau", time, on_host(time) >= 0, "not be before the start, τ = 0")
