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

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.guards import safe_divisor
from .._base.linalg import components
from .._base.roots import root
from .._base.types import Real
from .free_rotation import gaps_of
from .motion import HALVINGS, SlowMotion
from .planar_orbits import Expansion, PlanarMotion, entry_q, log_scale_of
from .principal_axes import FreeRotation

PHASES = 256  # phases that sample a random start
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
    def time_unit(self) -> Real:
        """The unit 1/u₀ of τ, in that of `SlowMotion`."""
        return 2 * self.moment / self.flat**2

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

    def energy(self, y: Float[Array, "3"]) -> Real:
        """Return the energy of a state in the units of `start`, over J₁u₀/2."""
        return self.moments @ self.omega_at(y, self.log_u) ** 2


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
