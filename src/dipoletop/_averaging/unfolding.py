"""The unfolding: a nearly axisymmetric body at small amplitude, its dipole across the axis.

Let the dipole lie on axis 1, and let the moments be J₁ = 1, J₂ = 1 − η and J₃ = 1 − δ. Where |η| is
not large against u = ω⊥², neither averages over free rotation hold nor those over the rotation of
an axisymmetric top. With φ = atan2(ω₂, ω₁), z = ω₃/u and dσ = u dτ, every consistent level of the
equation of motion tends, as u → 0 at constant η/u, to

    φ_σ = −δz − ½ sin 2φ,   z_σ = z {1 − (2+δ)/(1−δ) cos²φ} − c sin 2φ/(1−δ),
    (ln u)_σ = −2 sin²φ,   c = 1 − η/(2u),

so an asymmetry only adds the torque of a pendulum, which grows as u falls. The time is τ = ∫dσ/u.

Residual line, φ = 0 (mod π), z = 0: the linear law has the trace −(2+δ)/(1−δ) and the determinant
(1 + δη/u)/(1−δ). The remaining loss is −Δ ln u = 2∫φ²dσ, a quadratic form of φ and z. If δη < 0
(the dipole lies on the middle axis) and u < −δη, the line repels, and will always do so, since u
falls: the rotation stops.

A needle, δ > 0, comes from fast rotation about its symmetry axis, as in `capture`: where q = 2δ|z|
is large against √|η/u| its phase is random, and uniform in the number of turns. Until then it
obeys the slow flow. A disc, δ < 0, that rotates so fast keeps doing so, and obeys the slow flow
from then on.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_divisor, safe_sqrt
from .._base.linalg import components
from .._base.roots import root
from .._base.types import Real
from ..equations._common import planar_rates
from .free_rotation import gaps_of
from .motion import HALVINGS, SlowMotion
from .planar_orbits import ENTRY, Expansion, Settled, follow, log_scale_of, state_after
from .principal_axes import FreeRotation

PHASES = 256  # phases that sample a random start
EXCESS = 1e-6  # the loss ln u below which states next to the residual line obey its linear law
NEAR = 1e-5  # the loss ln u at the residual line that is left to the linear law
MAX_STEPS = 60_000
FAST = 4.0  # q/√|η/u| above which a body rotates all the way round in spite of the asymmetry
HALF = 2.0  # ln u₀/u after which the energy has halved, if it falls to zero
ON_AXIS = 1e-13
FADED = 60.0  # ln u₀/u after which a needle of two equal moments is taken to stop
LARGEST = 2e4
"""The |η/u| beyond which the pendulum swings too often to be followed."""


class Top(NamedTuple):
    """A nearly axisymmetric body in the axes of its dipole and of its symmetry."""

    delta: Real
    """δ = 1 − J₃/J₁."""
    eta: Real
    """η = 1 − J₂/J₁."""
    moment: Real
    """J₁, in units of the largest moment."""
    frame: Float[Array, "3 3"]
    """Its axes 1, 2, 3 as rows, in the principal axes of the body, moments ascending."""
    omega: Float[Array, "3"]
    """Ω along them, in units of L₀ over the largest moment."""
    log_unit: Real
    """The logarithm of the unit of `omega` times κ/J₁."""

    @property
    def flat(self) -> Real:
        """The part √u₀ of `omega` across axis 3."""
        return jnp.hypot(self.omega[0], self.omega[1])

    @property
    def log_u(self) -> Real:
        """The logarithm of u."""
        return 2 * (jnp.log(self.flat) + self.log_unit)

    @property
    def ratio(self) -> Real:
        """The asymmetry η/u."""
        return jnp.where(self.eta == 0, 0.0, self.eta * jnp.exp(-self.log_u))

    @property
    def moments(self) -> Float[Array, "3"]:
        """The moments about axes 1, 2, 3, over J₁."""
        return jnp.stack([jnp.ones_like(self.eta), 1 - self.eta, 1 - self.delta])

    @property
    def start(self) -> Float[Array, "3"]:
        """The state (φ, z, ln u/u₀)."""
        w1, w2, w3 = components(self.omega)
        z = w3 / (w1**2 + w2**2) * jnp.exp(-self.log_unit)
        return jnp.stack([jnp.arctan2(w2, w1), z, jnp.zeros_like(z)])

    def omega_at(self, y: Float[Array, "3"], log_u0: Real) -> Float[Array, "3"]:
        """Return the Ω of a state, in units of √u₀."""
        phi, z, fall = y
        flat = jnp.exp(fall / 2)
        third = z * jnp.exp(fall + log_u0 / 2)
        return jnp.stack([flat * jnp.cos(phi), flat * jnp.sin(phi), third])


def top_of(rotation: FreeRotation, axial: int, weakness: Real) -> Top:
    """Return the body in the frame of its dipole.

    Args:
        rotation: in units of the largest moment and of L₀; its dipole is across the symmetry axis
            and on a principal axis, unless the two moments across are equal.
        axial: the principal axis, 0 or 2, that counts as the symmetry axis.
        weakness: κL₀/J² of the largest moment.
    """
    axis = jnp.eye(3)[axial]
    n = rotation.dipole
    across = jnp.cross(axis, n)
    moments = rotation.moments
    first, second = moments @ n**2, moments @ across**2
    eta = jnp.where(moments[1] == moments[2 - axial], 0.0, (first - second) / first)
    frame = jnp.stack([n, across, axis])
    delta = (first - moments[axial]) / first
    omega = frame @ (rotation.momentum / moments)
    return Top(delta, eta, first, frame, omega, jnp.log(weakness / first))


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
        faded = (y[2] < -FADED) & (self.delta > 0)  # for instance by wobbling for ever
        return self.settles(y) | stops & (y[2] < -HALF) | faded & (self.ratio == 0)

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

        return jnp.append(target, state_after(slope, (y[0], target), y[1:], MAX_STEPS))


def settle(plane: PlanarMotion, y: Float[Array, "3"]) -> Settled:
    """Return the end of the orbit from a state."""
    y = follow(plane, y, lambda t, y, args, **_: plane.ended(y), MAX_STEPS).ys[-1]
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


def asymmetry_at_entry(top: Top) -> Real:
    """Estimate η/u where a needle that turns fast comes to `entry_q`, with W of η = 0."""
    d = top.delta
    w3 = top.omega[2]
    log_w3 = jnp.log(jnp.abs(jnp.where(w3 == 0, 1.0, w3))) + top.log_unit
    log_w = log_scale_of(d, top.log_u / 2, log_w3, jnp.zeros_like(d))
    expansion = Expansion(-1.5 * d / (1 - d))

    def asymmetry(log_q: Real) -> Real:
        return top.eta * jnp.exp(2 * expansion.log_w(jnp.exp(log_q)) - 2 * log_w)

    def above(log_q: Real) -> Real:
        return log_q - jnp.log(entry_q(d, asymmetry(log_q)))

    low = jnp.log(entry_q(d, jnp.zeros_like(d)))
    return asymmetry(root(above, low, low + 80.0, HALVINGS))


def entry_of(rotation: FreeRotation, motion: SlowMotion, top: Top) -> tuple[Real, Real, Real]:
    """Return where the slow flow of a needle leads into the unfolded system: ln time, q and ln u.

    It is where q has fallen to `entry_q`, or the start if q is smaller there. The time is in the
    unit of `SlowMotion`, and u is that where φ = 0.

    From there to capture q²u/δ² is small, and W of `capture` is constant. W follows from the slow
    flow, which includes corrections of that order, and u in the plane follows from W.
    """
    stage = motion.stage(0)
    moments = stage.interval.side.moments
    to_a, to_b, a_to_b = gaps_of(moments)
    on_middle = rotation.dipole[1] ** 2 > 0.5

    def place(y: Real, log: Real) -> tuple[Real, Real, Real]:
        """Compute the logarithms of ω₁ and ω₃ where φ = 0, and of q over `entry_q`."""
        x, rest = stage.interval.position(y)
        first = jnp.where(on_middle, x, x * to_b / to_a)
        third = jnp.where(on_middle, rest, (a_to_b + rest * to_b) / to_a)
        log_w1 = (log + jnp.log(first)) / 2 - jnp.log(top.moment) + top.log_unit
        log_w3 = (log + jnp.log(third)) / 2 - jnp.log(moments[2]) + top.log_unit
        log_q = jnp.log(2 * jnp.abs(top.delta)) + log_w3 - 2 * log_w1
        size = top.eta * jnp.exp(-2 * log_w1)
        return log_w1, log_w3, log_q - jnp.log(entry_q(top.delta, size))

    knots = stage.knots
    _, _, excess = jax.vmap(place)(knots, stage.states.log)
    piece = stage.piece(jnp.sum(jnp.isfinite(knots) & (excess > 0)) - 1)

    def lacks(part: Real) -> Real:
        y, state = piece.at(part)
        return -place(y, state.log)[2]

    zero = jnp.zeros_like(top.delta)
    part = root(lacks, zero, zero + 1, HALVINGS)
    y, state = piece.at(part)
    log_w1, log_w3, _ = place(y, state.log)
    log_q = jnp.log(2 * jnp.abs(top.delta)) + log_w3 - 2 * log_w1
    log_w = log_scale_of(top.delta, log_w1, log_w3, zero)
    expansion = Expansion(-1.5 * top.delta / (1 - top.delta))
    q = jnp.exp(log_q)
    return state.log_time, q, 2 * (log_w - expansion.log_w(q))


def phases(plane: PlanarMotion, q: Real, number: int = PHASES) -> Float[Array, "n 3"]:
    """Return states φ = 0, uniform in the number of turns, from one passage at q to the next."""
    z = q / (2 * plane.delta)
    zero = jnp.zeros_like(z)
    _, after, fall = plane.section(jnp.stack([zero, z, zero]), zero + 1)
    part = jnp.asarray((np.arange(number) + 0.5) / number)
    z_at = z + part * (after - z)
    falls = fall * jnp.log(z_at / z) / safe_divisor(jnp.log(after / z))
    return jnp.stack([jnp.zeros(number), z_at, falls], axis=1)
