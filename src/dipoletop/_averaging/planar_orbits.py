"""Single orbits of the planar system with u = ω⊥², from their own phase to their end; δ > 0.

The system is `dipoletop.planar` with (ln u)_σ = −2 sin²φ, the limit of small amplitude. Orbits come
from z = ∞ turn by turn (z = −∞ is the mirror image). Put q = 2δ|z|, a = −3δ/(2(1−δ)), θ = 2φ. On
the sections θ = 2πk an orbit obeys, as an expansion in 1/q whose odd terms vanish,

    dq/dθ = −a (1 + g₁/q² + g₂/q⁴ + …),   d ln u/d ln q = −(1/a)(1 + k₁/q² + k₂/q⁴ + …),

without any oscillation, because the phase is the same on all sections. The expansion is made by
substitution of q⁻¹ = E + ΣBₙ(θ)Eⁿ, Bₙ(0) = 0, order by order. So on a section

    N(q) = ∫dq/(2π dq/dθ)  is the number of turns, up to a constant of the orbit, and
    W² = u q^{1/a} exp(−[k₁/(2q²) + k₂/(4q⁴) + …]/a)  is the invariant of the averaged motion.
"""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.checks import or_nan
from .._base.integration import integrated
from .._base.types import Outcome, Real
from ..equations._verdicts import transverse
from ..planar import Planar

ENTRY = 24.0  # q/(1 + |a|) where the expansion takes over; its error is then below 1e-6
AMPLITUDE = 1e-6  # ω⊥ at which the semi-reduced regions coincide with the regions of the plane
PRECISION = 1e-7  # relative error of ω∞ by its series
MAX_STEPS = 16384
RTOL = 1e-10

Scalar = Float[Array, ""]


class Settled(NamedTuple):
    """The end of an orbit of the plane."""

    residual: Bool[Array, "*any"]
    stops: Bool[Array, "*any"]
    along: Bool[Array, "*any"]
    """Whether ω∞ > 0."""
    log_ratio: Real
    """ln |ω∞|/ω⊥ if it is residual, with ω⊥ at the start."""
    state: Float[Array, "*any 3"]
    """The last state."""


def settle(delta: Scalar, phi: Scalar, z: Scalar) -> Settled:
    """Return the end of the orbit from a point of the plane, at the consistent levels; δ > 0."""
    plane = Planar(delta)

    def field(t: Any, y: Array, args: Any) -> Array:
        return jnp.append(plane(t, y[:2]), -2 * jnp.sin(y[0]) ** 2)

    def ends(t: Any, y: Array, args: Any, **_: Any) -> Bool[Array, ""]:
        return jnp.logical_or(*_end_at(delta, y)[:2])

    y = follow(field, jnp.stack([phi, z, jnp.zeros_like(z)]), ends).ys[-1]
    residual, stops, omega_inf = _end_at(delta, y)
    last = jnp.where(residual, omega_inf, AMPLITUDE) / AMPLITUDE
    log_ratio = or_nan(jnp.log(jnp.abs(last)) + y[2] / 2, residual)
    return Settled(residual, stops, residual & (last > 0), log_ratio, y)


def _end_at(delta: Scalar, y: Array) -> tuple[Array, Array, Array]:
    """Return the semi-reduced verdict on a point of the plane.

    That is whether the end is residual, whether it is a stop, and ω∞ for ω⊥ = `AMPLITUDE`.
    """
    across = AMPLITUDE * jnp.stack([jnp.cos(y[0]), jnp.sin(y[0])])
    at = transverse.semi_reduced(delta, jnp.append(across, AMPLITUDE**2 * y[1]))
    residual = (at.outcome == Outcome.RESIDUAL) & (at.error < PRECISION)
    return residual, at.outcome == Outcome.STOP, at.omega_inf


def follow(
    field: Any, y0: Array, ends: Any, max_steps: int = MAX_STEPS, *, dense: bool = False
) -> Any:
    """Return the solution of an autonomous system up to the first step after which `ends` holds."""
    pid, saveat = diffrax.PIDController(RTOL, RTOL), diffrax.SaveAt(t1=True, dense=dense)
    options = {"saveat": saveat, "event": diffrax.Event(ends)}
    return integrated(field, (0.0, jnp.inf), y0, pid, max_steps, 0.01, **options)


def state_after(rates: Any, span: tuple[Any, Any], y0: Array, max_steps: int) -> Array:
    """Return the state after the independent variable, such as φ, has gone through a span."""
    pid = diffrax.PIDController(RTOL, RTOL)
    return integrated(rates, span, y0, pid, max_steps).ys[-1]


class Expansion(NamedTuple):
    """The expansion in 1/q on the sections θ = 2πk, which depends on a = −3δ/(2(1−δ)) only."""

    a: Real

    @property
    def turn(self) -> tuple[Real, Real]:
        """The coefficients g₁, g₂."""
        a = self.a
        return (a - 7) / 12, -(1275 + a * (934 + a * (126 * a - 3095))) / 576

    @property
    def decay(self) -> tuple[Real, Real]:
        """The coefficients k₁, k₂: the series d ln u/dθ = (1/q)(1 + h₁/q² + …) divided by dq/dθ."""
        a, (g1, g2) = self.a, self.turn
        h1 = (9 + a * (5 - 12 * a)) / 4
        h2 = 5 * (1125 + a * (1042 + a * (-4569 + a * (4656 * a - 2710)))) / 576
        return h1 - g1, h2 - g2 - g1 * (h1 - g1)

    def turns(self, q: Real) -> Real:
        """Return the number of turns N, up to a constant."""
        g1, g2 = self.turn
        return (q + g1 / q + (g2 - g1**2) / (3 * q**3)) / (2 * jnp.pi * jnp.abs(self.a))

    def q(self, turns: Real) -> Real:
        """Return the q after N turns."""
        g1, g2 = self.turn
        leading = q = 2 * jnp.pi * jnp.abs(self.a) * turns
        for _ in range(8):  # each gains a factor g₁/q²
            q = leading - g1 / q - (g2 - g1**2) / (3 * q**3)
        return q

    def log_w(self, q: Real) -> Real:
        """Return the logarithm of W/√u."""
        k1, k2 = self.decay
        return (jnp.log(q) - k1 / (2 * q**2) - k2 / (4 * q**4)) / (2 * self.a)


def log_scale_of(delta: Scalar, log_perp: Scalar, log_w3: Scalar, s: Scalar) -> Scalar:
    """Compute ln W of a start of the averaged top by (4.16), ξ = ω⊥²/ω₃², s = sgn ω₃ sin 2φ.

    A start oscillates about the averages. By (4.2)–(4.4) the oscillations of (ln u)′ and (ln v)′
    are (u + Mv) cos 2φ and −3δu cos 2φ/(1−δ), and φ′ = −δω₃. Their integrals are subtracted from
    ln K.
    """
    a, b = 1 + 2 * delta, 1 + delta**3
    p = delta * (1 - delta) * (3 + 3 * delta + delta**2) / (a * b)
    log_xi = 2 * (log_perp - log_w3)
    log_ratio = jnp.log(b / a) - log_xi
    log_k = 2 * log_w3 + (2 + delta) / a * log_xi - p * jnp.logaddexp(log_ratio, 0.0)
    slope = (2 + delta) / a + p * jax.nn.sigmoid(log_ratio)  # d ln K/d ln ξ at constant v
    u, v = jnp.exp(2 * log_perp - log_w3), jnp.exp(log_w3)  # over |ω₃|
    m = 1 + delta + delta**2
    oscillation = slope * (u + m * v) - (1 - slope) * 3 * delta / (1 - delta) * u
    log_k = log_k + s * oscillation / (2 * delta)
    return a / (6 * delta) * log_k - (1 - delta) / (3 * delta) * jnp.log(2 * delta)
