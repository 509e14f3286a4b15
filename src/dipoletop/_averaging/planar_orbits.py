"""Single orbits of the limit of small amplitude, with u = ω⊥², from their own phase to their end.

The system is `dipoletop.planar` with (ln u)_σ = −2 sin²φ, and with an asymmetry as in `unfolding`.

Without asymmetry and for δ > 0, orbits come from z = ∞ turn by turn (z = −∞ is the mirror image).
Put q = 2δ|z|, a = −3δ/(2(1−δ)), θ = 2φ. On the sections θ = 2πk an orbit obeys, as an expansion in
1/q whose odd terms vanish,

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
import numpy as np
import optimistix
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_divisor, safe_sqrt
from .._base.integration import integrated
from .._base.roots import root
from .._base.types import Real
from ..equations._common import planar_rates
from ..equations._verdicts.transverse import WOBBLING_FROM
from .motion import HALVINGS

ENTRY = 24.0  # q/(1 + |a|) where the expansion takes over; its error is then below 1e-6
EXCESS = 1e-6  # the loss ln u below which states next to the residual line obey its linear law
NEAR = 1e-5  # the loss ln u at the residual line that is left to the linear law
MAX_STEPS = 60_000
FAST = 4.0  # q/√|η/u| above which a body rotates all the way round in spite of the asymmetry
HALF = 2.0  # ln u₀/u after which the energy has halved, if it falls to zero
ON_AXIS = 1e-13
FADED = 60.0  # ln u₀/u after which a needle above δ_c2 wobbles for ever; a captured one loses less
RTOL = 1e-10
ROUNDING = 1e-14

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


class PlanarMotion(NamedTuple):
    """The unfolded system of a given δ and η/u₀; states are (φ, z, ln u/u₀)."""

    delta: Real
    ratio: Real
    """η/u₀, where u₀ is the unit of u."""

    def asymmetry(self, y: Float[Array, "n"]) -> Real:
        """Return the asymmetry η/u."""
        return self.ratio * jnp.exp(-y[2])

    def __call__(self, t: Any, y: Float[Array, "n"], args: Any = None) -> Float[Array, "3"]:
        """Return d(φ, z, ln u)/dσ."""
        plane = planar_rates(self.delta, 1 - self.asymmetry(y) / 2, y[:2])
        return jnp.append(plane, -2 * jnp.sin(y[0]) ** 2)

    def line(self, y: Float[Array, "n"]) -> tuple[Real, Real]:
        """Return the determinant of the linear law at the residual line, and the remaining loss."""
        d, z = self.delta, y[1]
        phi = y[0] - jnp.pi * jnp.round(y[0] / jnp.pi)
        det = (1 + d * self.asymmetry(y)) / (1 - d)
        square = det * phi**2 + ((1 + 2 * d) / (1 - d) * phi - d * z) ** 2
        return det, square * (1 - d) / (2 + d) / jnp.where(det > 0, det, 1.0)

    def half_life(self, y: Float[Array, "n"]) -> tuple[Bool[Array, ""], Real]:
        """Return whether a state is next to a stable residual line, and σ until its loss halves.

        There x = (φ, z) obeys x′ = Lx, so that x(σ) = e^{mσ}{C x + S (L − m)x}, m = tr L/2,
        C = cosh sσ, S = sinh(sσ)/s, s² = m² − det L. On the line itself the slower rate counts.
        """
        det, left = self.line(y)
        m = -(2 + self.delta) / (1 - self.delta) / 2
        square = m**2 - det
        s = safe_sqrt(jnp.abs(square))
        rate = -m - jnp.where(square > 0, s, 0.0)
        near = (det > 0) & (left < EXCESS)
        x = jnp.stack([y[0] - jnp.pi * jnp.round(y[0] / jnp.pi), y[1]])
        moved = planar_rates(self.delta, 1 - self.asymmetry(y) / 2, x) - m * x

        def excess(sigma: Real) -> Real:
            up, down = jnp.exp((m + s) * sigma), jnp.exp((m - s) * sigma)
            swing = jnp.exp(m * sigma) * jnp.cos(s * sigma), jnp.exp(m * sigma) * jnp.sin(s * sigma)
            first = jnp.where(square > 0, (up + down) / 2, swing[0])
            second = jnp.where(square > 0, (up - down) / 2, swing[1]) / safe_divisor(s)
            at = first * x + jnp.where(s > 0, second, first * sigma) * moved
            return left / 2 - self.line(jnp.append(at, y[2]))[1]

        longest = 10 / jnp.where(near, rate, 1.0)
        half = root(excess, jnp.zeros_like(rate), longest, HALVINGS)
        return near, jnp.where(left == 0, np.log(2) / (2 * rate), half)

    def settles(self, y: Float[Array, "n"], loss: float = NEAR) -> Bool[Array, ""]:
        """Return whether the residual line attracts the state, and the remaining loss is small."""
        det, left = self.line(y)
        return (det > 0) & (left <= loss * det / (1 + det))

    def repels(self, y: Float[Array, "n"]) -> Bool[Array, ""]:
        """Return whether the residual line repels now and at all later times."""
        return 1 + self.delta * self.asymmetry(y) < 0

    def turns(self, y: Float[Array, "n"]) -> Bool[Array, ""]:
        """Return whether the rotation about the symmetry axis is fast, see `entry_q`."""
        return 2 * jnp.abs(self.delta * y[1]) > entry_q(self.delta, self.asymmetry(y))

    def ended(self, y: Float[Array, "n"]) -> Bool[Array, ""]:
        """Return whether the end is known, and the energy has halved if it falls to zero."""
        stops = self.repels(y) | self.stays(y) | (self.delta < 0) & self.turns(y)
        wobbles = (y[2] < -FADED) & (self.delta > WOBBLING_FROM) & (self.ratio == 0)
        return self.settles(y) | stops & (y[2] < -HALF) | wobbles

    def stays(self, y: Float[Array, "n"]) -> Bool[Array, ""]:
        """Return whether it spins about axis 2, across dipole and symmetry axis, for J₂ = J₁."""
        return (jnp.abs(y[1]) < ON_AXIS) & (jnp.abs(jnp.cos(y[0])) < ON_AXIS) & (self.ratio == 0)

    def section(self, y: Float[Array, "3"], turn: Real) -> Float[Array, "3"]:
        """Return the state `turn` half turns after the next multiple of π that φ passes."""
        heading = -jnp.sign(self.delta * y[1])
        target = heading * jnp.pi * (jnp.ceil(heading * y[0] / jnp.pi) + turn)

        def slope(phi: Any, rest: Array, args: Any) -> Array:
            phi_rate, *others = self(phi, jnp.stack([phi, *rest]))
            return jnp.stack(others) / phi_rate

        return jnp.append(target, state_after(slope, (y[0], target), y[1:]))


def settle(plane: PlanarMotion, y: Float[Array, "3"], max_steps: int = MAX_STEPS) -> Settled:
    """Return the end of the orbit from a state."""
    y = follow(plane, y, lambda t, y, args, **_: plane.ended(y), max_steps).ys[-1]
    residual = plane.settles(y)
    _, left = plane.line(y)
    along = jnp.cos(y[0]) > 0
    log_ratio = jnp.where(residual, (y[2] - left) / 2, -jnp.inf)
    return Settled(residual, ~residual & plane.ended(y), residual & along, log_ratio, y)


def entry_q(delta: Real, asymmetry: Real) -> Real:
    """Return the q from which rotation about the symmetry axis is fast, at an asymmetry η/u.

    The averages over it are then the averages of the slow flow. Their corrections are of the order
    1/q², as for η = 0, with the relative error |η|/(uq²).
    """
    size = jnp.abs(asymmetry)
    expansion = ENTRY * (1 + 1.5 * jnp.abs(delta / (1 - delta))) * jnp.sqrt(jnp.sqrt(1 + size))
    return jnp.maximum(expansion, FAST * safe_sqrt(size))


def follow(
    field: Any,
    y0: Array,
    ends: Any,
    max_steps: int = MAX_STEPS,
    *,
    dense: bool = False,
    exact: bool = False,
) -> Any:
    """Return the solution of an autonomous system up to the first step after which `ends` holds.

    If `exact`, it is a number, and the solution ends where that becomes positive.
    """
    pid, saveat = diffrax.PIDController(RTOL, RTOL), diffrax.SaveAt(t1=True, dense=dense)
    finder = optimistix.Bisection(ROUNDING, ROUNDING, flip=False) if exact else None
    options = {"saveat": saveat, "event": diffrax.Event(ends, finder)}
    return integrated(field, (0.0, jnp.inf), y0, pid, max_steps, 0.01, **options)


def state_after(rates: Any, span: tuple[Any, Any], y0: Array) -> Array:
    """Return the state after the independent variable, such as φ, has gone through a span."""
    pid = diffrax.PIDController(RTOL, RTOL)
    return integrated(rates, span, y0, pid, MAX_STEPS).ys[-1]


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
