"""Plane rotator (section 2 and appendix A of the paper): the dipole turns in a plane.

Dimensionless: ω about body axis 3, the dipole along axis 1, τ₀ = k d²/I, ϖ = ω′. The full
equation ω″ = ω′ + ω³ has one physical branch, ϖ = f(ω); every other motion runs away.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.chebyshev import collocation_rule
from .._base.checks import real, where_valid
from .._base.types import Outcome, Real, Stop, Vector, Verdict
from ..bodies import Body, axisymmetric
from .levels import Level

SERIES = 0.11  # |ω| up to which the divergent series of f serves, to rounding
TERMS = 34  # they fall until (2n + 8)ω² = 1, and what is left is as large as the last one
PANELS, WIDTH, NODES = 160, 0.25, 16  # of the tables over ln ω, from SERIES to 10¹⁶
NEWTON = 8

One = Float[Array, "1 *lanes"]
Pair = Float[Array, "2 *lanes"]


def _speed(omega0: Vector) -> Real:
    """The only component that a plane rotator has."""
    flat = (omega0[0] == 0) & (omega0[1] == 0)
    return where_valid("omega0", omega0[2], flat, "lie along axis 3 (a plane rotator)")


def _lift(self: Any, omega0: Vector) -> One:
    """Component 3 of ω₀; the others must be 0."""
    return _speed(omega0)[None]


def _about_axis_3(self: Any, y: Float[Array, "n *lanes"]) -> Vector:
    """(0, 0, ω)."""
    zero = jnp.zeros_like(y[0])
    return jnp.stack([zero, zero, y[0]])


def _stops(y: Float[Array, "n *lanes"]) -> Verdict:
    """STOP, always, on the physical branch: ω falls like (2τ)^{−1/2}."""
    zero = jnp.zeros_like(y[0])
    outcome = jnp.where(jnp.isfinite(y[0]), int(Outcome.STOP), int(Outcome.FAILED))
    return Verdict(outcome.astype("int32"), zero, zero == 0, int(Stop.AXIS))


def _rotator(self: Any) -> Body:
    """A body of moment 1 about axis 3, for energies and powers."""
    return axisymmetric(0.0)


class RotatorReduced(eqx.Module):
    """Reduced equation (2.3): ω′ = −ω³, state (ω,). Its solution is (2.4), `exact.rotator`.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> dt.RotatorReduced()(0.0, jnp.array([0.5])).tolist()
        [-0.125]
    """

    def __call__(self, t: Any, y: One, args: Any = None) -> One:
        """dω/dτ, shape (1,) or (1, B)."""
        return -(y**3)

    lift, omega = _lift, _about_axis_3

    def verdict(self, y: One) -> Verdict:
        """STOP, proven."""
        return _stops(y)._replace(equation=RotatorReduced)

    body = property(_rotator)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.ORDER_1.label


class RotatorBranch(eqx.Module):
    """The physical motions of the full equation: ω′ = f(ω), state (ω,), f the critical manifold."""

    def __call__(self, t: Any, y: One, args: Any = None) -> One:
        """dω/dτ, shape (1,) or (1, B)."""
        return critical_manifold(y)

    lift, omega = _lift, _about_axis_3

    def verdict(self, y: One) -> Verdict:
        """STOP, proven."""
        return _stops(y)._replace(equation=RotatorBranch)

    body = property(_rotator)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.FULL.label


class Domain(NamedTuple):
    """Between which infinities a motion of the full equation runs, as signs of ω.

    The separatrices AOC (`critical_manifold`) and BOD (`separatrix`) cut the phase plane into
    four domains, one for each pair.
    """

    past: Int[Array, "*lanes"]
    """Sign of ω at the blow-up in the past; 0 on BOD, which comes from rest."""
    future: Int[Array, "*lanes"]
    """Sign of ω at the runaway in the future; 0 on AOC, the physical branch, which stops."""


class RotatorFull(eqx.Module):
    """Full equation (2.2), dimensionless (A.1): ω″ = ω′ + ω³, state (ω, ϖ = ω′).

    From a start ω₀ of shape (3,), `simulate` and `classify` take the physical branch
    (`RotatorBranch`); a whole state (ω, ϖ) is taken as given, and runs away.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> run = dt.classify(dt.RotatorFull(), jnp.array([1.0, 0.0]))  # at rest in ϖ: off it
        >>> dt.Outcome(int(run.outcome)).name, f"{run.time:.4f}"  # blows up then
        ('FAILED', '1.6351')
    """

    def __call__(self, t: Any, y: Pair, args: Any = None) -> Pair:
        """d(ω, ϖ)/dτ, shape (2,) or (2, B)."""
        return jnp.stack([y[1], y[1] + y[0] ** 3])

    def lift(self, omega0: Vector) -> Pair:
        """Onto the physical branch, ϖ = f(ω)."""
        speed = _speed(omega0)
        return jnp.stack([speed, critical_manifold(speed)])

    omega = _about_axis_3

    def verdict(self, y: Pair) -> Verdict:
        """STOP, for a state on the physical branch."""
        return _stops(y)._replace(equation=RotatorFull)

    def lyapunov(self, y: Pair) -> Real:
        """V = ω(ϖ − ω/2), which grows along every motion: V′ = ϖ² + ω⁴ (appendix A)."""
        return y[0] * (y[1] - y[0] / 2)

    def domain(self, y: Pair) -> Domain:
        """In which of the four domains of the phase plane a state (ω, ϖ) lies."""
        past = jnp.sign(separatrix(y[0]) - y[1])
        future = jnp.sign(y[1] - critical_manifold(y[0]))
        return Domain(past.astype("int32"), future.astype("int32"))

    @property
    def branch(self) -> RotatorBranch:
        """The equation of its physical motions, which has no runaways."""
        return RotatorBranch()

    @property
    def runaway_rate(self) -> float:
        """At which what is off the physical branch grows, near rest."""
        return 1.0

    body = property(_rotator)

    @property
    def level(self) -> str:
        """Which equation this is, for labels."""
        return Level.FULL.label


def critical_manifold(w: Any) -> Float[Array, "*n"]:
    """f(ω) of the physical branch ϖ = f(ω): f f′ = f + ω³, f ~ −ω³ at 0 (A.16), curve AOC.

    The asymptotic series up to |ω| = 0.11, from there integration upwards, which is stable, made
    once and kept as polynomials. Relative error below 1e-14, any ω. May be jitted, mapped and
    differentiated.

    Args:
        w: ω, dimensionless, any shape; f is odd.

    Returns:
        f, of the shape of `w`.

    Example:
        >>> import dipoletop as dt
        >>> print(f"{dt.critical_manifold(0.3):.12f}")
        -0.022428220160
    """
    return _curve(-1, _real(w))


def separatrix(w: Any) -> Float[Array, "*n"]:
    """g(ω) of the curve BOD: g g′ = g + ω³, g ~ ω at 0: the motions that come from rest.

    Args:
        w: ω, dimensionless, any shape; g is odd.

    Returns:
        g, of the shape of `w`: ω′ on that curve.
    """
    return _curve(1, _real(w))


def closed_manifold(w: Any) -> Float[Array, "*n"]:
    """The paper's closed approximation of f(ω): −ω³/√(1 + 2ω²).

    Right to leading order at 0 and at infinity; 22 % too large at ω = 1.

    Args:
        w: ω, dimensionless, any shape.
    """
    w = _real(w)
    return -(w**3) / jnp.sqrt(1 + 2 * w**2)


def _real(w: Any) -> Float[Array, "*n"]:
    return real("w", w, np.shape(w))


@functools.partial(jax.jit, static_argnums=0)
def _curve(sign: int, array: Float[Array, "*n"]) -> Float[Array, "*n"]:
    small = jnp.abs(array) <= SERIES
    by_series = _series(sign, jnp.where(small, array, 0.0))
    risen = _risen(sign, jnp.where(small, SERIES, jnp.abs(array)))
    return jnp.where(small, by_series, sign * risen * array * jnp.abs(array))


@functools.cache
def _coefficients(sign: int) -> tuple[int | float, ...]:
    """cₙ of Σ cₙω^{2n+1}, from c₀ on: those of f (c₀ = 0, integers) or of g (c₀ = 1)."""
    c: list[int | float] = [max(sign, 0)]
    for n in range(1, TERMS):
        products = sum((2 * j + 1) * c[n - j] * c[j] for j in range(1, n))
        # Terms in which cₙ itself stands: −cₙ for f, (2n + 2)c₀cₙ − cₙ for g.
        c.append(products - (n == 1) if sign < 0 else ((n == 1) - products) / (2 * n + 1))
    return tuple(c)


def _series(sign: int, w: Any) -> Any:
    total = 0.0 * w
    for c in reversed(_coefficients(sign)):
        total = total * w**2 + float(c)
    return total * w


def _slope(sign: int, w: Any, r: Any) -> Any:
    """dr/d ln ω of r = |ϖ|/ω²."""
    return 1 / r + sign / w - 2 * r


@functools.cache
def _table(sign: int) -> np.ndarray:
    """Chebyshev coefficients of r over ln ω, panel by panel upwards from SERIES.

    By collocation and Newton's method. After the last panel 1/ω is less than rounding of r.
    """
    nodes, sums, coefficients = collocation_rule(NODES)
    r, panels = sign * _series(sign, SERIES) / SERIES**2, []
    for panel in range(PANELS):
        w = SERIES * np.exp(WIDTH * (panel + nodes))
        values = np.full(NODES, r)
        for _ in range(NEWTON):
            lack = values - r - WIDTH * sums @ _slope(sign, w, values)
            matrix = np.eye(NODES) + WIDTH * sums * (1 / values**2 + 2)
            values = values - np.linalg.solve(matrix, lack)
        panels.append(coefficients @ values)
        r = values[-1]
    return np.stack(panels)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _risen(sign: int, w: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The ratio |ϖ|/ω² at ω ≥ SERIES, by the table."""
    place = jnp.log(w / SERIES) / WIDTH
    panel = jnp.clip(jnp.floor(place), 0, PANELS - 1)
    x = jnp.minimum(2 * (place - panel) - 1, 1.0)
    c = jnp.moveaxis(jnp.asarray(_table(sign), w.dtype)[panel.astype("int32")], -1, 0)
    last, sum_ = jnp.zeros_like(x), jnp.zeros_like(x)
    for k in range(NODES - 1, 0, -1):  # Clenshaw
        last, sum_ = sum_, c[k] + 2 * x * sum_ - last
    return c[0] + x * sum_ - last


@_risen.defjvp
def _risen_jvp(sign: int, primals: Any, tangents: Any) -> Any:
    (w,), (dw,) = primals, tangents
    r = _risen(sign, w)
    return r, _slope(sign, w, r) / w * dw
