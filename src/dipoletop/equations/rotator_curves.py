"""Two curves ϖ(ω) in the phase plane of the rotator: the critical manifold and the separatrix.

Both solve ϖ dϖ/dω = ϖ + ω³, which is the full equation ω″ = ω′ + ω³ with ϖ = ω′. The critical
manifold f ~ −ω³ is the physical branch (curve AOC of the paper). The separatrix g ~ ω (curve BOD)
holds the motions that come from rest.

Near 0 both are given by power series. These diverge, but up to `SERIES_UP_TO` they are exact to
rounding. From there on the ratio r = |ϖ|/ω² obeys dr/d ln ω = 1/r ∓ 1/ω − 2r (upper sign for f),
whose solutions converge towards large ω. It is integrated in that direction by collocation on
panels of ln ω, once, and kept as Chebyshev coefficients.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.chebyshev import collocation_rule
from .._base.checks import real

SERIES_UP_TO = 0.11  # |ω| up to which the divergent series of f are exact to rounding
TERMS = 34  # terms decrease until (2n + 8)ω² = 1; the last one estimates the error
PANELS, WIDTH, NODES = 160, 0.25, 16  # of the tables over ln ω, from SERIES_UP_TO to 10¹⁶
NEWTON_STEPS = 8


def critical_manifold(w: Any) -> Float[Array, "*n"]:
    """Compute f(ω) of the physical branch ϖ = f(ω): f f′ = f + ω³, f ~ −ω³ at 0 (A.16), curve AOC.

    Relative error below 1e-14 for any ω. May be jitted, vmapped and differentiated.

    Args:
        w: ω, dimensionless, any shape; f is odd.

    Returns:
        f, of the shape of `w`.

    Example:
        >>> import dipoletop as dt
        >>> print(f"{dt.critical_manifold(0.3):.12f}")
        -0.022428220160
    """
    return _curve(-1, real("w", w, np.shape(w)))


def separatrix(w: Any) -> Float[Array, "*n"]:
    """Compute g(ω) of the curve BOD, the motions that come from rest: g g′ = g + ω³, g ~ ω at 0.

    Args:
        w: ω, dimensionless, any shape; g is odd.

    Returns:
        g, of the shape of `w`: ω′ on that curve.
    """
    return _curve(1, real("w", w, np.shape(w)))


def closed_manifold(w: Any) -> Float[Array, "*n"]:
    """Return the paper's closed approximation of f(ω): −ω³/√(1 + 2ω²).

    Exact to leading order at 0 and at infinity; 22 % too large at ω = 1.

    Args:
        w: ω, dimensionless, any shape.

    Returns:
        The approximation, of the shape of `w`.
    """
    w = real("w", w, np.shape(w))
    return -(w**3) / jnp.sqrt(1 + 2 * w**2)


@functools.partial(jax.jit, static_argnums=0)
def _curve(sign: int, array: Float[Array, "*n"]) -> Float[Array, "*n"]:
    in_series = jnp.abs(array) <= SERIES_UP_TO
    by_series = _series(sign, jnp.where(in_series, array, 0.0))
    ratio = _tabulated_ratio(sign, jnp.where(in_series, SERIES_UP_TO, jnp.abs(array)))
    return jnp.where(in_series, by_series, sign * ratio * array * jnp.abs(array))


@functools.cache
def _coefficients(sign: int) -> tuple[int | float, ...]:
    """Compute cₙ of Σ cₙω^{2n+1}: of f (sign −1, c₀ = 0, integers) or of g (sign 1, c₀ = 1)."""
    c: list[int | float] = [max(sign, 0)]
    for n in range(1, TERMS):
        products = sum((2 * j + 1) * c[n - j] * c[j] for j in range(1, n))
        # cₙ itself occurs as −cₙ for f, and as (2n + 2)c₀cₙ − cₙ for g.
        c.append(products - (n == 1) if sign < 0 else ((n == 1) - products) / (2 * n + 1))
    return tuple(c)


def _series(sign: int, w: Any) -> Any:
    total = 0.0 * w
    for c in reversed(_coefficients(sign)):
        total = total * w**2 + float(c)
    return total * w


def _ratio_slope(sign: int, w: Any, r: Any) -> Any:
    """Compute dr/d ln ω of r = |ϖ|/ω²."""
    return 1 / r + sign / w - 2 * r


@functools.cache
def _table(sign: int) -> np.ndarray:
    """Return Chebyshev coefficients of r over ln ω, panel by panel upwards from SERIES_UP_TO.

    Collocation, solved by Newton's method. Beyond the last panel 1/ω is below the rounding of r.
    """
    nodes, sums, coefficients = collocation_rule(NODES)
    r = sign * _series(sign, SERIES_UP_TO) / SERIES_UP_TO**2
    panels = []
    for panel in range(PANELS):
        w = SERIES_UP_TO * np.exp(WIDTH * (panel + nodes))
        values = np.full(NODES, r)
        for _ in range(NEWTON_STEPS):
            residual = values - r - WIDTH * sums @ _ratio_slope(sign, w, values)
            jacobian = np.eye(NODES) + WIDTH * sums * (1 / values**2 + 2)
            values = values - np.linalg.solve(jacobian, residual)
        panels.append(coefficients @ values)
        r = values[-1]
    return np.stack(panels)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _tabulated_ratio(sign: int, w: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the ratio |ϖ|/ω² at ω ≥ SERIES_UP_TO, from the table."""
    position = jnp.log(w / SERIES_UP_TO) / WIDTH
    panel = jnp.clip(jnp.floor(position), 0, PANELS - 1)
    x = jnp.minimum(2 * (position - panel) - 1, 1.0)
    c = jnp.moveaxis(jnp.asarray(_table(sign), w.dtype)[panel.astype("int32")], -1, 0)
    last, sum_ = jnp.zeros_like(x), jnp.zeros_like(x)
    for k in range(NODES - 1, 0, -1):  # Clenshaw
        last, sum_ = sum_, c[k] + 2 * x * sum_ - last
    return c[0] + x * sum_ - last


@_tabulated_ratio.defjvp
def _tabulated_ratio_jvp(sign: int, primals: Any, tangents: Any) -> Any:
    (w,), (dw,) = primals, tangents
    r = _tabulated_ratio(sign, w)
    return r, _ratio_slope(sign, w, r) / w * dw
