"""Small amplitudes of the transverse top: a planar system, its saddle, boundary and wobbling.

With φ = atan2(ω₂, ω₁), u = ω⊥², z = ω₃/u and dσ = u dτ every level of the equation of motion tends,
as u → 0, to an autonomous system in the plane (φ, z),

    φ_σ = −δz − ½ sin 2φ        z_σ = z {1 − (2+δ)/(1−δ) cos²φ} − c sin 2φ/(1−δ)

with c = 0 at order 1 and c = 1 ("corrected") at the levels that hold every term of leading order:
orders 2–4, the semi-reduced and the full equation (`Level.consistent`). The first equation is the
limit of (4.11), the second the limit of z_σ = ω₃′/u² + 2z sin²φ, as u_σ = −2u sin²φ. So the outcome
at small amplitude depends on φ and z only. Symmetries: φ → φ + π, and (φ, z) → (−φ, −z).

The manifolds of the saddle are integrated as graphs z(φ), dz/dφ = z_σ/φ_σ, up to the fold where
φ_σ = 0, and orbits round (π/2, 0) as graphs over the polar angle.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._base.checks import finite, instance, or_nan
from ._base.integration import integrated
from ._base.refusals import refuse
from ._base.roots import bisect
from ._base.types import Real
from .equations._common import planar_rates, shape_parameter
from .equations._verdicts.transverse import WOBBLING_FROM
from .equations.levels import Level

Scalar = Float[Array, ""]
Point = Float[Array, "2 *#lanes"]
"""A state (φ, z): φ in radians, z = ω₃/ω⊥² in units of τ₀."""

PRECISION = 512.0  # relative tolerance of the curves, in units of the last place
LAST_STEP = 1e-6  # relative last step of Newton's method; the error is then about its square
NEWTON_STEPS = 8  # steps to the cycle, whose z lies within 3 % of the first guess for every δ
HALVINGS = 52  # halvings in search of its largest swing


class Planar(eqx.Module):
    """Small-amplitude limit: φ_σ = −δz − ½ sin 2φ, z_σ = z{1 − (2+δ)/(1−δ) cos²φ} − ….

    The last term is −sin 2φ/(1−δ) at the consistent levels, and 0 at order 1. σ = ∫ω⊥²dτ.

    Args:
        delta: shape δ = 1 − I₃/I₁ in [−1, 1), dimensionless.
        corrected: True for the limit of orders 2–4, the semi-reduced and the full equation, False
            for the limit of order 1: `Level.consistent` of the level.

    Raises:
        ValueError: δ outside [−1, 1).

    Example:
        At order 1 a top that rotates across its symmetry axis keeps ω₃ = 0; at the consistent
        levels it does not:

        >>> import jax.numpy as jnp
        >>> from dipoletop.planar import Planar
        >>> across = jnp.array([jnp.pi / 4, 0.0])
        >>> Planar(-0.25, corrected=False)(0.0, across).round(6)
        Array([-0.5,  0. ], dtype=float64)
        >>> Planar(-0.25)(0.0, across).round(6)
        Array([-0.5, -0.8], dtype=float64)
    """

    delta: Real = eqx.field(converter=shape_parameter)
    corrected: bool = eqx.field(static=True, default=True)

    def __call__(self, t: Any, y: Point, args: Any = None) -> Point:
        """Return d(φ, z)/dσ, shape (2,) or (2, B)."""
        return planar_rates(self.delta, 1.0 if self.corrected else 0.0, y)

    @property
    def level(self) -> str:
        """The label in tables and pictures: of order 1, or corrected."""
        return f"small amplitude, {'corrected' if self.corrected else Level.ORDER_1.label}"


class Saddle(NamedTuple):
    """The saddle of a planar system; NaN where there is none."""

    phi: Real
    """φ* in (0, π/2), radians."""
    z: Real
    """z*, with the sign of −δ."""
    unstable: Real
    """The positive eigenvalue, per unit of σ."""
    stable: Real
    """The negative eigenvalue."""
    unstable_slope: Real
    """dz/dφ along the unstable direction."""
    stable_slope: Real
    """dz/dφ along the stable direction."""


def saddle(system: Planar) -> Saddle:
    """Compute the saddle z* = −sin 2φ*/(2δ), cos²φ* = (1+δ)/(2+δ); at order 1 cos²φ* = (1−δ)/(2+δ).

    There is one in 0 < φ < π/2; the others follow by φ → φ + π and (φ, z) → (−φ, −z).

    Args:
        system: the planar system; its δ may have any shape.

    Returns:
        A `Saddle` whose fields have the shape of δ. NaN at δ = 0, at δ = −1, and for δ ≤ −1/2 at
        order 1.

    Example:
        >>> from dipoletop.planar import Planar, saddle
        >>> at = saddle(Planar(-0.2, corrected=False))
        >>> f"{at.phi:.9f} {at.z:.9f} {at.unstable:.6f} {at.stable:.1f}"
        '0.615479709 2.357022604 0.666667 -1.0'
    """
    return _saddle(instance("system", system, Planar))


@eqx.filter_jit
def _saddle(system: Planar) -> Saddle:
    d = system.delta
    exists = (d != 0) & (d > (-1.0 if system.corrected else -0.5))
    d = jnp.where(exists, d, 0.5)
    if system.corrected:
        cos2 = (1 + d) / (2 + d)
        unstable, stable = 2 / (2 + d), -(1 + d) / (1 - d)
    else:
        cos2 = (1 - d) / (2 + d)
        unstable, stable = 2 * (1 + 2 * d) / (2 + d), -jnp.ones_like(d)
    cos, sin = jnp.sqrt(cos2), jnp.sqrt(1 - cos2)
    cosine = 2 * cos2 - 1  # cos 2φ*
    values = (
        jnp.arctan2(sin, cos),
        -sin * cos / d,
        unstable,
        stable,
        -(unstable + cosine) / d,
        -(stable + cosine) / d,
    )
    return Saddle(*(or_nan(x, exists) for x in values))


def boundary(system: Planar, phi: Any) -> Float[Array, "*n"]:
    """Compute z_s(φ), the universal basin boundary, by φ_σ z_s′ = z_σ on a stable manifold.

    At small amplitude, starts at φ with ω₃ > z_s ω⊥² lead to a rotating stop, starts just below it
    to residual rotation. Further below, only starts in a narrow tongue between the fold (see below)
    and φ = π/2 lead to a stop. For ω₃ < 0 the boundary is −z_s(−φ). At finite amplitude it differs
    by O(ω⊥²).

    The stable manifold of each saddle arrives from smaller φ as a graph, which begins at a fold,
    where its slope is infinite. Between the fold and the next saddle at smaller φ, the highest
    curve is the other half of the manifold of that saddle. So z_s, the upper envelope, jumps at the
    fold; its period is π. May be jitted, vmapped, and differentiated forwards (`jax.jacfwd`).

    Args:
        system: the planar system, with a single δ.
        phi: φ, shape () or (n,), radians.

    Returns:
        z_s, of the shape of φ; NaN for δ ≥ 0, and for δ ≤ −1/2 at order 1. With `corrected` and
        δ < δ_c1 = −0.8598… (`critical_delta`) z_s only separates the two senses of rotation: the
        basin of residual rotation is the inside of a cycle, and z_s is NaN between φ = π/2 and
        the fold.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> from dipoletop.planar import Planar, boundary
        >>> f"{boundary(Planar(-0.2, corrected=False), 0.0):.10f}"
        '4.2553355749'
        >>> import jax
        >>> f"{jax.jacfwd(lambda d: boundary(Planar(d, corrected=False), 0.0))(-0.2):.6f}"
        '32.685861'
    """
    instance("system", system, Planar)
    if system.delta.ndim:
        refuse("system", "have a single delta", f"has deltas of shape {system.delta.shape}")
    angles = finite("phi", phi)
    stable, sides = jnp.array([True, True]), jnp.array([-1.0, 1.0])
    left, right = _branches(system, stable, sides, jnp.stack([angles.ravel()] * 2))
    z = jnp.where(jnp.isfinite(left), left, right).reshape(angles.shape)
    return or_nan(z, system.delta < 0)


@eqx.filter_jit
def _branches(
    system: Planar, stable: Bool[Array, "b"], side: Float[Array, "b"], phi: Float[Array, "b n"]
) -> Float[Array, "b n"]:
    """Return z of several branches of the manifolds at once, each at several angles."""
    at_angles = jax.vmap(_branch, in_axes=(None, None, None, 0))
    return jax.vmap(at_angles, in_axes=(None, 0, 0, 0))(system, stable, side, phi)


def _branch(system: Planar, stable: Bool[Array, ""], side: Scalar, phi: Scalar) -> Scalar:
    """Return z at which one half of a manifold of the saddle first reaches φ (modulo π).

    The curve is followed away from the saddle, backwards in σ on the stable and forwards on the
    unstable manifold, since errors decay in this direction. NaN if there is a fold before φ.
    """
    origin = _saddle(system)
    slope = jnp.where(stable, origin.stable_slope, origin.unstable_slope)
    heading = jnp.where(stable, -side, side)  # the sign of φ_σ
    near = float(jnp.finfo(phi.dtype).eps) ** 0.5  # distance at which curvature is below rounding

    def rate(distance: Scalar, z: Scalar, args: Any) -> Scalar:
        phi_rate, z_rate = system(distance, jnp.stack([origin.phi + side * distance, z]))
        is_graph = heading * phi_rate > 0
        return jnp.where(is_graph, side * z_rate / jnp.where(is_graph, phi_rate, 1.0), jnp.nan)

    distance = jnp.mod(side * (phi - origin.phi), jnp.pi)
    z0 = origin.z + side * slope * near
    curve = _solve(rate, (near, jnp.maximum(distance, near)), near, z0)
    z = jnp.where(distance > near, curve.ys[-1], origin.z + side * slope * distance)
    return or_nan(z, diffrax.is_successful(curve.result))


def _solve(rate: Any, span: tuple[Any, Any], step: float, y0: Array, *, dense: bool = False) -> Any:
    """Integrate a curve as precisely as its type allows; `step` is the first step."""
    eps = float(jnp.finfo(y0.dtype).eps)
    controller = diffrax.PIDController(PRECISION * eps, PRECISION * eps, dtmin=eps)
    saveat = diffrax.SaveAt(t1=True, dense=dense)
    return integrated(rate, span, y0, controller, 4096, step, saveat=saveat)


class Wobble(NamedTuple):
    """The limit cycle round (π/2, 0) on which a top wobbles; NaN where there is none."""

    z: Real
    """|z| where it crosses φ = π/2."""
    swing: Real
    """The largest |φ − π/2|, radians."""
    period: Real
    """The period, in units of σ."""
    multiplier: Real
    """Floquet multiplier of a whole period; the cycle is stable if it is below 1."""
    boundary: Real
    """z_W: from φ = π/2 a top wobbles to a stop if |z| < z_W, and keeps rotating if |z| > z_W."""


def wobble(delta: Any) -> Wobble:
    """Compute the limit cycle of φ_σ = −δz − ½ sin 2φ, z_σ = …, the wobbling stop of a needle.

    Half a period maps (π/2, z) to (π/2, −P(z)). The cycle solves P(z) = z, by Newton's method with
    P′ = (z/P) exp ∫div dσ. Its basin ends at z_W, where the stable manifold of the saddle crosses
    φ = π/2. May be jitted and vmapped.

    Args:
        delta: shape δ, dimensionless, a number.

    Returns:
        A `Wobble`; NaN for δ ≤ δ_c2 = 0.7532…, see `critical_delta`. Within 1e-6 above δ_c2
        Newton's method may fail, and all fields except `boundary` are NaN. As δ → 1, z → 4/√3, the
        swing → √(8(1−δ)/3) and the period → 2π√((1−δ)/2).

    Raises:
        ValueError: δ outside [−1, 1), or not a single number.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from dipoletop.planar import wobble
        >>> jax.vmap(wobble)(jnp.array([0.75, 0.8, 0.9])).boundary.round(4)
        Array([   nan, 3.0625, 6.7202], dtype=float64)
    """
    system = Planar(delta)
    if system.delta.ndim:
        refuse("delta", "be a single number", f"has shape {system.delta.shape}")
    z_boundary, _ = _crossings(system, True, True)  # twice, to share the program of critical_delta
    return _wobble(system.delta, z_boundary)


@eqx.filter_jit
def _wobble(delta: Scalar, z_boundary: Scalar) -> Wobble:
    exists = delta > WOBBLING_FROM
    system = Planar(jnp.where(exists, delta, 0.9))  # any value at which there is a cycle

    def newton(_: Any, cycle: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        z = cycle[0]
        after, time, divergence, swing = _half_turn(system, z)
        nearer = z + (after - z) / (1 - z / after * jnp.exp(divergence))
        return nearer, swing, 2 * time, jnp.exp(2 * divergence), jnp.abs(nearer - z)

    unknown = jnp.full_like(delta, jnp.nan)
    guess = jnp.full_like(delta, 4 / 3**0.5), *([unknown] * 4)  # the limit δ → 1
    z, swing, period, multiplier, step = jax.lax.fori_loop(0, NEWTON_STEPS, newton, guess)
    # Close to δ_c2 orbits linger at the saddles, and Newton's method may leave the basin.
    converged = exists & (step <= LAST_STEP * z) & (z < z_boundary)
    z, swing, period, multiplier = (or_nan(x, converged) for x in (z, swing, period, multiplier))
    return Wobble(z, swing, period, multiplier, or_nan(z_boundary, exists))


def _half_turn(system: Planar, z: Scalar) -> tuple[Scalar, ...]:
    """Follow an orbit from (π/2, z) to (π/2, −|z|): this |z|, ∫dσ, ∫div dσ, the largest swing.

    The integration is over the polar angle θ round (π/2, 0), with z stretched so that orbits near
    this focus are circles. θ_σ > 0 up to the saddles and their manifolds.
    """
    d = system.delta
    stretch = jnp.sqrt(d * (1 - d) / 2)

    def point(theta: Scalar, y: Float[Array, "3"]) -> Point:
        r = jnp.exp(y[0])
        return jnp.stack([jnp.pi / 2 + r * jnp.cos(theta), r * jnp.sin(theta) / stretch])

    def rate(theta: Scalar, y: Float[Array, "3"], args: Any) -> Float[Array, "3"]:
        cos, sin = jnp.cos(theta), jnp.sin(theta)
        phi_rate, z_rate = system(theta, point(theta, y)) * jnp.exp(-y[0])
        divergence = jnp.trace(jax.jacfwd(lambda x: system(theta, x))(point(theta, y)))
        theta_rate = cos * stretch * z_rate - sin * phi_rate
        is_graph = theta_rate > 0
        log_r_rate = cos * phi_rate + sin * stretch * z_rate
        change = jnp.stack([log_r_rate, jnp.ones_like(d), divergence])
        return jnp.where(is_graph, change / jnp.where(is_graph, theta_rate, 1.0), jnp.nan)

    ends = jnp.pi / 2, 3 * jnp.pi / 2
    y0 = jnp.stack([jnp.log(z * stretch), jnp.zeros_like(z), jnp.zeros_like(z)])
    orbit = _solve(rate, ends, 0.01, y0, dense=True)
    log_r, time, divergence = orbit.ys[-1]

    def returns(theta: Scalar) -> Bool[Array, ""]:
        return system(theta, point(theta, orbit.evaluate(theta)))[0] > 0  # φ_σ > 0

    low, high = (jnp.asarray(end, z.dtype) for end in ends)
    farthest, _ = bisect(returns, low, high, HALVINGS)
    swing = jnp.pi / 2 - point(farthest, orbit.evaluate(farthest))[0]
    return jnp.exp(log_r) / stretch, time, divergence, swing


def _crossings(system: Planar, *stable: bool) -> Float[Array, "b"]:
    """Return z at which manifolds of the saddle cross φ = π/2 (δ > 0) or φ = 0 (δ < 0).

    `stable` chooses the stable or the unstable manifold for each.
    """
    prolate, each = system.delta > 0, jnp.ones(len(stable))
    sides = jnp.where(prolate, 1.0, -1.0) * each
    section = jnp.where(prolate, jnp.pi / 2, 0.0) * each
    return _branches(system, jnp.array(stable), sides, section[:, None])[:, 0]


def critical_delta(*, prolate: bool = True) -> float:
    """Compute δ_c2 = 0.7532… or δ_c1 = −0.8598…, the heteroclinic bifurcation z_s + z_u = 0.

    There the unstable manifold of the saddle meets the stable one of its mirror image, and a cycle
    is born. Above δ_c2 a stable cycle round (π/2, 0) is the wobbling stop. Below δ_c1 an unstable
    cycle round (0, 0) bounds the basin of residual rotation. Order 1 has neither. Not traceable.

    Args:
        prolate: True for δ_c2, False for δ_c1.

    Returns:
        The critical δ, dimensionless.

    Example:
        >>> from dipoletop.planar import critical_delta
        >>> f"{critical_delta():.11f} {critical_delta(prolate=False):.5f}"
        '0.75323579939 -0.85980'
    """
    from scipy.optimize import brentq

    bracket = (0.7, 0.8) if prolate else (-0.9, -0.8)

    def gap(delta: float) -> Array:  # by symmetry: stable manifold from the unstable one
        return jnp.sum(_crossings(Planar(delta), True, False))

    root: Any = brentq(gap, *bracket, xtol=1e-14)
    return float(root)
