"""The emission of a freely rotating dipole: the lines of its spectrum, and their polarisation.

The angular momentum L moves round an axis in the body with a period T, and the body turns about L
meanwhile, at the mean rate Φ̇. So the dipole has the angular frequencies j·2π/T along L and
Φ̇ + j·2π/T across L, with whole numbers j. Radiation changes them slowly: the lines belong to a
time that is long compared with T and short compared with the braking time.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ._averaging.dipole_series import Series, series
from ._averaging.landen import Descent
from ._averaging.orbit import MomentumOrbit, Spin, motion_of
from ._averaging.principal_axes import principal_axes
from ._base.checks import (
    ArrayLike,
    NumberLike,
    concrete,
    finite,
    instance,
    positive,
    shape_of,
    where_valid,
)
from ._base.compiling import compiled_soon
from ._base.linalg import cross, dot, trace
from ._base.refusals import refuse
from ._base.tolerances import budget
from ._base.types import Real
from .bodies import Body
from .particles import RADIATION, Particle
from .particles.units import BOLTZMANN

STRONGEST = 3  # number of lines in the text
UNSEEN = 1e-13  # share of the power that counts as rounding
HARMONICS = 32

Rotor = Body | Particle
Vector3 = Float[Array, "3"]


class Lines(NamedTuple):
    """The lines that a rotating dipole emits, in a frame with axis 3 along L.

    First the lines along L at j·2π/T, j = 1 … n, then the lines across L at |Φ̇ + j·2π/T|,
    j = −n … n. At the time t the dipole is Re Σ aₖ exp(−iωₖt) plus a constant along L. At t = 0 the
    angular velocity is `omega`, and the dipole lies in the half plane of axes 3 and 1.
    """

    frequency: Float[Array, "*batch m"]
    """Angular frequencies ω, not negative; rad/s for a particle."""
    power: Float[Array, "*batch m"]
    """Mean power of each line, ½ω⁴|a|²; W for a particle."""
    amplitude: Complex[Array, "*batch m 3"]
    """Amplitudes a of the dipole; C m for a particle. (1, i, 0) turns in the positive sense about
    L, (1, −i, 0) in the negative sense."""
    total: Float[Array, "*batch"]
    """The mean power of all lines, neglected ones included, in closed form."""
    precession: Float[Array, "*batch"]
    """Φ̇."""
    libration: Float[Array, "*batch"]
    """2π/T."""

    @property
    def missing(self) -> Float[Array, "*batch"]:
        """The neglected share of the power, 1 − Σ power/total; 0 if nothing radiates."""
        shines = self.total > 0
        share = jnp.sum(self.power, axis=-1) / jnp.where(shines, self.total, 1.0)
        return jnp.where(shines, 1 - share, 0.0)

    def __repr__(self) -> str:
        if not concrete(*self) or np.ndim(self.total) > 0:
            return f"Lines(frequency: {np.shape(self.frequency)}, power: {np.shape(self.power)})"
        strongest = np.argsort(-np.asarray(self.power), stable=True)[:STRONGEST]
        shown = [
            f"{power:.4g} at {frequency:.6g}"
            for frequency, power in np.stack([self.frequency, self.power], axis=1)[strongest]
            if power > 0
        ]
        lines = "; ".join(shown) or "none"
        left = f"={float(self.missing):.1g}" if self.missing > UNSEEN else f"<{UNSEEN:.0e}"
        return f"Lines(total={float(self.total):.6g}, missing{left}, strongest: {lines})"


class Stokes(NamedTuple):
    """The Stokes parameters of the light of a rotating dipole towards one direction.

    For the observer, Q > 0 is linear polarisation along the projection of L on the sky, U > 0 is
    linear at 45° from it, counter-clockwise, and V > 0 turns counter-clockwise.
    """

    frequency: Float[Array, "*batch m"]
    """Angular frequencies ω of the lines; rad/s for a particle."""
    lines: Float[Array, "*batch m 4"]
    """I, Q, U, V of each line, power per unit solid angle; W/sr for a particle."""
    total: Float[Array, "*batch 4"]
    """The sums over the lines."""

    def __repr__(self) -> str:
        if not concrete(*self) or np.ndim(self.total) > 1:
            return f"Stokes(lines: {np.shape(self.lines)})"
        i, q, u, v = map(float, self.total)
        return f"Stokes(I={i:.6g}, Q={q:.6g}, U={u:.6g}, V={v:.6g}; {self.frequency.size} lines)"


def lines(body: Rotor, omega: Any, *, n: int = HARMONICS) -> Lines:
    """Compute the lines ω = j·2π/T and |Φ̇ + j·2π/T| of free rotation, with powers P = ½ω⁴|a|².

    The sum of all powers is the mean ⟨|d̈|²⟩ over the motion. The n-th harmonic is smaller than the
    dipole by about exp(−πnK′/2K), where K′/K falls to 0, slowly, towards the separatrix: `missing`
    of the result shows whether more harmonics are needed. Lines that are closer together than the
    inverse of the time of observation cannot be resolved.

    `jax.vmap` takes batches; derivatives are taken by `body` and `omega` at fixed n.

    Args:
        body: a dimensionless body; or a particle, whose results are in SI units, with
            P = ½ω⁴|a|²/(6πε₀c³).
        omega: angular velocity Ω in body axes, shape (3,); rad/s for a particle. Zero emits
            nothing.
        n: number of harmonics of 2π/T.

    Returns:
        3n + 1 lines.

    Raises:
        ValueError: a `body` that is neither, or is a batch; a bad `omega`; an `n` that is not a
            positive whole number.

    Source: E. T. Whittaker, Analytical Dynamics, section 69.

    Example:
        A dipole that turns about an axis across it emits one line, with the power |d|²Ω⁴.

        >>> import dipoletop as dt
        >>> dt.lines(dt.axisymmetric(-0.5), [0, 0, 2.0])
        Lines(total=16, missing<1e-13, strongest: 16 at 2)
    """
    omega = _checked(body, omega)
    k = RADIATION if isinstance(body, Particle) else 1.0
    return _lines(body.inertia, body.dipole, omega, k, budget("n", n))


@compiled_soon
def _lines(
    inertia: Float[Array, "3 3"], dipole: Vector3, omega: Vector3, k: float | Real, n: int
) -> Lines:
    # All in units of order one: SI values would be near the smallest floating-point numbers.
    largest = jnp.max(jnp.abs(dipole))
    moment = largest * jnp.linalg.norm(dipole / largest)
    speed = jnp.max(jnp.abs(omega))
    upward = jnp.zeros_like(omega).at[2].set(1.0)
    direction = jnp.where(speed > 0, omega / jnp.where(speed > 0, speed, 1.0), upward)
    orbit, spin = motion_of(inertia / jnp.max(jnp.abs(inertia)), dipole / moment, direction)
    steps = orbit.steps
    precession, libration, total, terms = _of_unit_dipole(orbit, steps, spin, n)
    j = jnp.arange(1.0, n + 1, dtype=speed.dtype)
    rates = precession + libration * jnp.concatenate([-j[::-1], jnp.zeros((1,), j.dtype), j])
    frequency = speed * jnp.concatenate([jnp.abs(libration) * j, jnp.abs(rates)])
    # Powers do not use the phases, whose derivatives are large next to an axis.
    squares = jnp.concatenate([4 * _square(terms.along), 2 * _square(terms.across)])
    along, across = _from_now(terms, orbit.phase(steps))
    amplitude = _amplitudes(jnp.where(libration < 0, along, jnp.conj(along)), across, rates)
    return Lines(
        frequency,
        k * moment**2 * frequency**4 * squares / 2,
        jax.lax.complex(moment * amplitude.real, moment * amplitude.imag),
        k * moment**2 * speed**4 * total,
        speed * precession,
        speed * jnp.abs(libration),
    )


def _of_unit_dipole(
    orbit: MomentumOrbit, steps: Descent, spin: Spin, n: int
) -> tuple[Real, Real, Real, Series]:
    """Return Φ̇, the signed 2π/T, ⟨|d̈|²⟩ and the series of a dipole of length 1."""
    precession, libration = orbit.rates(steps)
    along, across = series(orbit, steps, n)
    single = jnp.where(jnp.arange(-n, n + 1) == 0, spin.across, 0.0)
    single = jax.lax.complex(single, jnp.zeros_like(single))
    spinning = spin.rate, 0.0, spin.rate**4 * spin.across**2, Series(jnp.zeros_like(along), single)
    moving = precession, libration, orbit.power(), Series(along, across)
    return jax.tree.map(lambda a, b: jnp.where(spin.holds, a, b), spinning, moving)


def _from_now(terms: Series, phase: Real) -> Series:
    """Return the series in θ − θ₀, with axis 1 in the plane of L and the dipole at θ = θ₀."""
    n = terms.along.size
    theta = phase * jnp.arange(-float(n), n + 1, dtype=phase.dtype)
    turns = jax.lax.complex(jnp.cos(theta), jnp.sin(theta))
    along, across = terms.along * turns[n + 1 :], terms.across * turns
    now = jnp.sum(across)
    known = (now.real != 0) | (now.imag != 0)
    real = jnp.where(known, now.real, 1.0)
    size = jnp.sqrt(real**2 + now.imag**2)
    return Series(along, across * jax.lax.complex(real / size, -now.imag / size))


def _square(values: Complex[Array, "k"]) -> Float[Array, "k"]:
    """Return the squares of the moduli, with derivatives at 0."""
    return values.real**2 + values.imag**2


def _amplitudes(
    along: Complex[Array, "n"], across: Complex[Array, "m"], rates: Float[Array, "m"]
) -> Complex[Array, "lines 3"]:
    """Compute the amplitudes a of a dipole with d₃ = Re Σ 2c exp(−iωt) and d₁ + id₂ = Σ w exp(iνt).

    A line with ν < 0 has the frequency −ν and turns in the negative sense.
    """
    forwards = rates >= 0
    first = jnp.where(forwards, jnp.conj(across), across)
    turned = jax.lax.complex(-first.imag, first.real)  # i · first
    second = jnp.where(forwards, turned, -turned)
    vectors = jnp.stack([first, second, jnp.zeros_like(first)], axis=-1)
    none = jnp.zeros_like(along)
    return jnp.concatenate([jnp.stack([none, none, 2 * along], axis=-1), vectors])


def damping_time(particle: Particle, temperature: ArrayLike | NumberLike) -> Float[Array, "..."]:
    """Compute τ_ed, the time in which dipole radiation damps thermal rotation of a grain.

    With Ω = L/J₃, at isotropic directions of L in the body,

        1/τ_ed = (3kT/J₃²Ω³)⟨Σ mP/ω⟩ = 3kTκJ₃ Σᵢ nᵢ²⟨rᵢ⟩,    κ = k d²,

    with the sum over the lines of power P and sense m about L, which carry off the angular
    momentum mP/ω, and n the direction of the dipole in principal axes. The mean over the
    directions of L is a polynomial in the reciprocal moments pᵢ,

        ⟨rᵢ⟩ = Σⱼ {pⱼ³/5 + pⱼ[pᵢpⱼ − pₖ(pᵢ − pⱼ)]/15} + pⱼpₖ(pⱼ + pₖ)/15,

    with i, j, k different. For a sphere τ_ed = J²/(2kTκ).

    Args:
        particle: a single grain of any shape; `jax.vmap` takes a batch.
        temperature: T, K, of any shape.

    Returns:
        τ_ed, s, of the shape of T; infinite without a dipole.

    Raises:
        ValueError: another `particle`, or a batch; a `temperature` that is not positive.

    Source: B. T. Draine and A. Lazarian, Astrophys. J. 508 (1998) 157; K. Silsbee,
    Y. Ali-Haïmoud and C. M. Hirata, Mon. Not. R. Astron. Soc. 411 (2011) 2750, for wobbling discs.

    Example:
        >>> import dipoletop as dt
        >>> grain = dt.Particle.sphere(1e-9, [3.1e-29, 0, 0], density=2000)
        >>> f"{damping_time(grain, 100.0) / 3.15576e7:.0f} years"
        '603 years'
    """
    instance("particle", particle, Particle)
    _checked(particle, jnp.zeros(3))
    heat = BOLTZMANN * positive(
        "temperature", temperature, shape_of(temperature), batch=False, unit="K"
    )
    moments, axes = principal_axes(particle.inertia / trace(particle.inertia))
    p = 1 / moments
    j, k = jnp.roll(p, -1), jnp.roll(p, -2)

    def of_axis(j: Array, k: Array) -> Array:
        return j**3 / 5 + j * (p * j - k * (p - j)) / 15

    means = of_axis(j, k) + of_axis(k, j) + j * k * (j + k) / 15
    strength = RADIATION * dot((axes.T @ particle.dipole) ** 2, means) * moments[2]
    # Moments were divided by the trace: J₃p³ has the dimension of 1/J².
    return trace(particle.inertia) ** 2 / (3 * heat * strength)


def stokes(body: Rotor, omega: Any, direction: Any, *, n: int = HARMONICS) -> Stokes:
    """Compute I, Q, U, V of each line towards an observer, in power per unit solid angle.

    A line of amplitude a has the field E ∝ ω²(a − s(s·a)) towards the direction s, and emits
    I = (3/8π)·½ω⁴|a − s(s·a)|² per unit solid angle there; the integral of I over all directions
    is its power. With N the projection of L on the sky, and M = s×N at 90° counter-clockwise from
    it,

        I = |E_N|² + |E_M|²,  Q = |E_N|² − |E_M|²,  U = 2Re(E_N* E_M),  V = 2Im(E_N* E_M),

    for fields that vary as exp(−iωt). So V is positive if the field turns counter-clockwise for the
    observer, as it does if the dipole rotates about an L that points at the observer. Seen across
    L, the light of such a dipole is linear, along M. U = 0, since every line is symmetric about L.
    (V has the sign that the International Astronomical Union fixed in 1973; angles count from N,
    not from north.) Towards ±L itself N is axis 1. Different lines do not interfere.

    Args:
        body: a dimensionless body, or a particle, as for `lines`.
        omega: angular velocity Ω in body axes, shape (3,); rad/s for a particle.
        direction: the direction from the dipole to the observer, shape (3,), not 0, in a frame
            with axis 3 along L and the dipole at t = 0 in the half plane of axes 3 and 1. The
            parameters of a line depend only on its angle with L.
        n: number of harmonics, as for `lines`.

    Returns:
        The parameters of the 3n + 1 lines and their sums.

    Raises:
        ValueError: as for `lines`; a `direction` of zero, or of a wrong shape.

    Source: J. D. Jackson, Classical Electrodynamics, sections 7.2 and 9.2.

    Example:
        Seen along its axis a rotator emits 3/8π of its power per unit solid angle, all circular.

        >>> import dipoletop as dt
        >>> dt.stokes(dt.axisymmetric(-0.5), [0, 0, 1.0], [0, 0, 1])
        Stokes(I=0.119366, Q=0, U=0, V=0.119366; 97 lines)
    """
    s = finite("direction", direction, (3,), batch=False)
    s = where_valid("direction", s, jnp.any(s != 0), "not be zero")
    s = s / jnp.max(jnp.abs(s))
    s = s / jnp.sqrt(dot(s, s))
    found = lines(body, omega, n=n)
    scale = RADIATION if isinstance(body, Particle) else 1.0
    east, north = _sky(s)
    weight = jnp.sqrt(3 / (16 * math.pi) * scale) * found.frequency**2
    (nr, ni), (er, ei) = (
        (weight * (found.amplitude.real @ axis), weight * (found.amplitude.imag @ axis))
        for axis in (north, east)
    )
    along_north, along_east = nr**2 + ni**2, er**2 + ei**2
    parameters = jnp.stack(
        [
            along_north + along_east,
            along_north - along_east,
            2 * (nr * er + ni * ei),
            2 * (nr * ei - ni * er),
        ],
        axis=-1,
    )
    return Stokes(found.frequency, parameters, jnp.sum(parameters, axis=0))


def _sky(s: Vector3) -> tuple[Vector3, Vector3]:
    """Return the axes M = s×N and N of an observer in the direction s."""
    across2 = s[0] ** 2 + s[1] ** 2
    tilted = across2 > 0
    across = jnp.sqrt(jnp.where(tilted, across2, 1.0))
    zero, one = jnp.zeros_like(across), jnp.ones_like(across)
    projected = jnp.stack([-s[0] * s[2], -s[1] * s[2], across2]) / across
    north = jnp.where(tilted, projected, jnp.stack([one, zero, zero]))
    return cross(s, north), north


def _checked(body: Rotor, omega: Any) -> Vector3:
    """Check and return the angular velocity of a single body."""
    instance("body", body, Rotor, "be a Body or a Particle")
    if body.inertia.ndim != 2:
        refuse("body", "be a single one (`jax.vmap` takes a batch)", "is a batch of them")
    return finite("omega", omega, (3,), batch=False)
