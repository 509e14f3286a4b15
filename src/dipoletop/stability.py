"""Equilibria and their spectra, which show how perturbations of a constant rotation decay.

In the frame (n, a, b) of the dipole, n = d/|d| a principal axis, every level of the equation of
motion, linearised at ω = w n, is

    w′ = 0,    x′ = S x,    x = (a·ω, b·ω).

A full equation has c = x′ in its state, too, with c′ = Cx + Dc. Then λ² − λD − C factorises into
(λ − (D − S))(λ − S) for every solution S of S² = DS + C. The S with the small eigenvalues belongs
to physical motions, and D − S to the runaways.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ._base.checks import check_body, check_single, concrete, finite, or_nan, where_valid
from ._base.guards import rounding, safe_divisor, safe_sqrt
from ._base.linalg import dot, scale
from ._base.refusals import described, refuse
from ._base.types import Equation
from .bodies import Body
from .equations._common import is_full, rate_of_omega
from .equations._verdicts.dipole_frame import body_frame
from .equations.torque_driven import DrivenEquation
from .equations.transverse_approximations import TransverseAveraged

ITERATIONS = 128  # of S ← −(D − S)⁻¹C: enough while |slow| ≤ 0.8 |fast|, up to ω ≈ 50

Scalar = Float[Array, ""]
Across = Float[Array, "2"]
"""The two components across the dipole, along a and b."""
AcrossMatrix = Float[Array, "2 2"]
Axes = Float[Array, "3 3"]
"""The unit vectors n, a and b, as rows."""


class Equilibria(NamedTuple):
    """The constant solutions: rest, and perhaps a line {w n} along the dipole."""

    direction: Float[Array, "*batch 3"]
    """n, a unit vector; NaN where rest is the only equilibrium."""

    def state(self, w: Any) -> Float[Array, "*batch 3"]:
        """Return the angular velocity w n; NaN for w ≠ 0 where rest is the only equilibrium."""
        w = finite("w", w, batch=False)
        return jnp.where(w == 0, 0.0, w * self.direction)


class Spectrum(NamedTuple):
    """Eigenvalues of an equation at an equilibrium, in units of 1/τ₀.

    From `jax.vmap` every field and property has the batch axis in front.
    """

    slow: Complex[Array, "*batch 3"]
    """Eigenvalues of physical motions: 0 along the dipole, then two, the larger real part first."""
    fast: Complex[Array, "*batch runaways"]
    """Eigenvalues of the runaways: two for a full equation, none otherwise."""
    across: Float[Array, "*batch 2 2"]
    """S, the linear part of physical motions across the dipole, in the principal axes a, b."""

    def __repr__(self) -> str:
        """The numbers of a single spectrum."""
        if not concrete(*self) or np.ndim(self.slow) > 1:
            return f"Spectrum(slow: {np.shape(self.slow)}, fast: {np.shape(self.fast)})"
        lines = [
            "stable" if self.stable else "not stable",
            f"slow: {_listed(self.slow)}",
            f"fast: {_listed(self.fast)}",
            f"return_time={self.return_time:.6g}, reactivity={self.reactivity:.6g}",
        ]
        return "Spectrum({})".format("\n         ".join(lines))

    @property
    def eigenvalues(self) -> Complex[Array, "*batch n"]:
        """All eigenvalues, the slow ones first."""
        return jnp.concatenate([self.slow, self.fast], axis=-1)

    @property
    def growth(self) -> Float[Array, "*batch"]:
        """Largest real part of the slow eigenvalues, without the 0 along the dipole."""
        return jnp.real(self.slow[..., 1])

    @property
    def stable(self) -> Bool[Array, "*batch"]:
        """Whether perturbations across the dipole decay to first order; False at rest."""
        return self.growth < 0

    @property
    def return_time(self) -> Float[Array, "*batch"]:
        """−1/growth, in units of τ₀; infinite where perturbations do not decay."""
        returns = ~(self.growth >= 0)  # NaN stays NaN
        return jnp.where(returns, -1 / jnp.where(returns, self.growth, -1.0), jnp.inf)

    @property
    def reactivity(self) -> Float[Array, "*batch"]:
        """Largest d ln|x|/dτ: the larger eigenvalue of (S + Sᵀ)/2, never below `growth`."""
        s = self.across
        mean, half = (s[..., 0, 0] + s[..., 1, 1]) / 2, (s[..., 0, 0] - s[..., 1, 1]) / 2
        square = half**2 + ((s[..., 0, 1] + s[..., 1, 0]) / 2) ** 2
        return mean + safe_sqrt(square, otherwise=square)  # NaN stays NaN


def _listed(eigenvalues: Complex[Array, "n"]) -> str:
    """Numbers, with their imaginary parts where these are not 0."""
    numbers = np.asarray(eigenvalues).tolist()
    return ", ".join(f"{x if x.imag else x.real:.10g}" for x in numbers) or "none"


def equilibria(equation: Any) -> Equilibria:
    """Return the equilibria: rest, and the line ω = w n along the dipole iff n × In = 0.

    Args:
        equation: any equation with a `body`.

    Returns:
        The direction n, shape (3,). As in `verdict`, n counts as a principal axis if
        |n × In| ≤ 4096 eps tr I, which is 9e-13 tr I in float64.

    Raises:
        ValueError: an equation without a body, or one that cannot keep rotation along the dipole,
            such as the plane rotator, and the averaged top, whose motions all stop.

    Source: section 4, for a transverse dipole; for any body N = n × In = 0 in (3.3).

    Example:
        >>> from dipoletop import Body, Full
        >>> from dipoletop.stability import equilibria
        >>> inertia = [[2, 0, 0], [0, 3, 0], [0, 0, 4]]
        >>> equilibria(Full(Body(inertia, [0, 5, 0]))).direction.round(12).tolist()
        [0.0, 1.0, 0.0]
        >>> equilibria(Full(Body(inertia, [3, 4, 0]))).direction.tolist()
        [nan, nan, nan]
    """
    check_single(equation)
    return Equilibria(_direction(equation))


def spectrum(equation: Any, state: Any) -> Spectrum:
    """Compute the eigenvalues at an equilibrium: 0 along the dipole, two of S, two of D − S.

    The equation is linearised by automatic differentiation. The slow and the fast matrix are
    separated before their eigenvalues are computed. If the principal axes are the body axes,
    rounding leaves an error below 1e-12 in the real and in the imaginary part, however small w is.
    In other axes rounding changes the elements of S by about eps |w|: relative to Re λ ~ w² this is
    eps/|w|, and eps/w² for an axisymmetric body with its dipole across the axis, for which no digit
    is right below |w| = 1e-8.

    Args:
        equation: any level; off the principal axes of the body, rest is the only equilibrium.
        state: the angular velocity ω, shape (3,): 0 or along the dipole, dimensionless.

    Returns:
        The spectrum. NaN at rest in cylindrical variables, which are singular there, and where
        slow and fast eigenvalues are too close to be separated (ω far above 1).

    Raises:
        ValueError: as `equilibria`, or a state that is not an equilibrium. A traced one gives NaN.

    Source: (4.22)–(4.24) at order 1.

    Example:
        At order 1 they are 0, −w² and −(1+2δ)/(1−δ) w².

        >>> import jax.numpy as jnp
        >>> from dipoletop import TransverseReduced
        >>> from dipoletop.stability import spectrum
        >>> line = spectrum(TransverseReduced(delta=-0.2), jnp.array([0.1, 0, 0]))
        >>> [f"{x:.6f}" for x in line.eigenvalues.real.tolist()]
        ['0.000000', '-0.005000', '-0.010000']
        >>> bool(line.stable)
        True
    """
    check_single(equation)
    state = finite("state", state, (3,), batch=False)
    found, is_equilibrium = _spectrum(equation, state)
    where_valid(
        "state", state, is_equilibrium, "be 0, or along a dipole that is on a principal axis"
    )
    return found


def threshold(family: Callable[[float], Any], w: float, lower: float, upper: float) -> float:
    """Solve growth(δ) = 0 on the line ω = w n for δ between `lower` and `upper`.

    Brent's method runs in Python, and is not traceable. It compiles once if the equations differ
    only in their numbers.

    Args:
        family: a function from the parameter, δ or any other, to the equation.
        w: the angular velocity along the dipole, dimensionless.
        lower: one end of the bracket.
        upper: the other end.

    Returns:
        δ to 1e-15 or rounding; NaN if the line is stable at both ends of the bracket or at neither.

    Raises:
        ValueError: as `spectrum`.

    Example:
        At order 1 the threshold is δ = −1/2. The consistent levels have no threshold (orders from 2
        on, as long as |w| is well below 1 − δ).

        >>> from dipoletop import TransverseReduced, TransverseSemi
        >>> from dipoletop.stability import threshold
        >>> print(f"{threshold(TransverseReduced, 0.1, -0.9, 0.5):.9f}")
        -0.500000000
        >>> threshold(TransverseSemi, 0.1, -0.9, 0.5)
        nan
    """
    from scipy.optimize import root_scalar

    if not callable(family):
        refuse("family", "be a function that gives the equation of a number", described(family))
    lower = float(finite("lower", lower, batch=False))
    upper = float(finite("upper", upper, batch=False))

    def growth(parameter: float) -> float:
        equation = family(parameter)
        return float(spectrum(equation, equilibria(equation).state(w)).growth)

    ends = growth(lower), growth(upper)
    if not np.all(np.isfinite(ends)) or (ends[0] < 0) == (ends[1] < 0):
        return float("nan")
    return root_scalar(growth, bracket=(lower, upper), method="brentq", xtol=1e-15).root


def _body_on_line(equation: Any) -> Body:
    """Return the body of an equation that can stay on the line along its dipole."""
    body = check_body(equation)
    spatial = jax.eval_shape(equation.lift, jax.ShapeDtypeStruct((3,), float)).shape[0] >= 3
    if isinstance(equation, TransverseAveraged | DrivenEquation) or not spatial:
        kind = type(equation).__name__
        refuse("equation", "keep rotation along the dipole among its motions", f"is {kind}")
    return body


@eqx.filter_jit
def _direction(equation: Equation) -> Float[Array, "3"]:
    frame = body_frame(_body_on_line(equation)).of(jnp.eye(3))
    return or_nan(frame.w, frame.principal)


@eqx.filter_jit
def _spectrum(equation: Equation, omega: Float[Array, "3"]) -> tuple[Spectrum, Bool[Array, ""]]:
    """Return the spectrum, NaN unless ω is an equilibrium to rounding, and whether it is one."""
    # The columns of the unit matrix give the components of n, a and b.
    frame = body_frame(_body_on_line(equation)).of(jnp.column_stack([jnp.eye(3), omega]))
    components = jnp.stack([frame.w, frame.xa, frame.xb])
    axes, w, off_line = components[:, :3], components[0, 3], components[1:, 3]
    at_rest = jnp.all(omega == 0)
    is_equilibrium = at_rest | (frame.principal & jnp.all(_negligible(off_line, w)))
    w = or_nan(w, is_equilibrium)
    zero = jax.lax.complex(w - w, w - w)
    if is_full(equation):
        slow, runaway = _slow_and_fast(*_second_order(equation, axes, w))
        fast = _eigenvalues(runaway)
    else:
        slow, fast = _first_order(equation, axes, w), jnp.zeros((0,), zero.dtype)
    return Spectrum(jnp.append(zero, _eigenvalues(slow)), fast, slow), is_equilibrium


def _negligible(x: Float[Array, "*any"], size: Scalar) -> Bool[Array, "*any"]:
    """Return whether x is at most the rounding of numbers of the given size."""
    return jnp.abs(x) <= rounding(x) * jnp.abs(size)


def _vector_across(axes: Axes, x: Across) -> Float[Array, "3"]:
    """Return the vector across the dipole with components x."""
    return scale(x[0], axes[1]) + scale(x[1], axes[2])


def _first_order(equation: Equation, axes: Axes, w: Scalar) -> AcrossMatrix:
    """Compute S of an equation without runaways, x′ = Sx, whatever its variables."""

    def rate(x: Across) -> Across:
        y = equation.lift(scale(w, axes[0]) + _vector_across(axes, x))
        omega_dot = rate_of_omega(equation, 0.0, y)
        return jnp.stack([dot(axes[1], omega_dot), dot(axes[2], omega_dot)])

    return jax.jacfwd(rate)(jnp.zeros(2, w.dtype))


def _second_order(equation: Any, axes: Axes, w: Scalar) -> tuple[AcrossMatrix, AcrossMatrix]:
    """Compute C and D of a full equation, x″ = Cx + Dx′: its state is (ω, fast part of ω′)."""
    a, b = equation.fast(axes[1]), equation.fast(axes[2])  # also unit vectors

    def second_derivative(x: Across, c: Across) -> Across:
        omega = scale(w, axes[0]) + _vector_across(axes, x)
        runaway = equation(0.0, jnp.concatenate([omega, c[0] * a + c[1] * b]))[3:]
        return jnp.stack([jnp.sum(a * runaway), jnp.sum(b * runaway)])

    zero = jnp.zeros(2, w.dtype)
    return jax.jacfwd(second_derivative, argnums=(0, 1))(zero, zero)


def _slow_and_fast(c: AcrossMatrix, d: AcrossMatrix) -> tuple[AcrossMatrix, AcrossMatrix]:
    """Compute S with S² = DS + C and small eigenvalues, and D − S; NaN without convergence.

    Each iteration S ← −(D − S)⁻¹C damps the error by the ratio of slow to fast eigenvalues. No
    element is a small difference of large numbers, so all elements, of different powers of w, are
    right to rounding.
    """

    def iterate(_: Any, s: AcrossMatrix) -> AcrossMatrix:
        (p, q), (r, t) = d - s
        adjugate = jnp.stack([jnp.stack([t, -q]), jnp.stack([-r, p])])
        return jnp.matmul(adjugate, c, precision="highest") / (q * r - p * t)

    before = jax.lax.fori_loop(0, ITERATIONS, iterate, jnp.zeros_like(c))
    s = iterate(None, before)
    converged = jnp.all(_negligible(s - before, jnp.max(jnp.abs(s))))
    s = or_nan(s, converged)
    return s, d - s


def _eigenvalues(m: AcrossMatrix) -> Complex[Array, "2"]:
    """Compute λ = (a+d)/2 ± √(((a−d)/2)² + bc); if both are real, the smaller is det/larger."""
    (a, b), (c, d) = m
    mean, square = (a + d) / 2, ((a - d) / 2) ** 2 + b * c
    size, complex_pair = jnp.abs(square), square < 0
    root = safe_sqrt(size, otherwise=size)  # NaN stays NaN
    large = jnp.where(mean < 0, mean - root, mean + root)
    small = (a * d - b * c) / safe_divisor(large)
    falling = jnp.where(mean < 0, jnp.stack([small, large]), jnp.stack([large, small]))
    real = jnp.where(complex_pair, jnp.stack([mean, mean]), falling)
    return jax.lax.complex(real, jnp.where(complex_pair, jnp.stack([root, -root]), 0.0))
