"""Capture of the axisymmetric top with transverse dipole, δ > 0, in the limit of small amplitude.

While |ω₃| ≫ u = ω⊥² the top turns fast about its symmetry axis, and (4.13)–(4.15) hold. z = ω₃/u
falls, and where q = 2δ|z| is of order 1 the rotation is captured: it becomes residual or, above
δ_c2, perhaps wobbles to a stop. The planar system (`dipoletop.planar`) with u,

    φ_σ = −δz − ½ sin 2φ,   z_σ = z {1 − (2+δ)/(1−δ) cos²φ} − sin 2φ/(1−δ),   (ln u)_σ = −2 sin²φ,

decides which, by the phase. The phase belongs to a very fast rotation, so it is random. Far from
capture an orbit has a number of turns N and a constant W (`planar_orbits`). A random phase means
that N mod 1 is uniform, which is the only distribution that is invariant from turn to turn.

Residual orbits are those whose N lies between N_A and N_B (mod 1) of the orbits that end in the
saddles. Below δ_c2 there is one such orbit, and all others are residual. X = |ω∞|/W vanishes like
the square root of the distance in N from either end. With N = N₁ + P sin²(πs/2) it is smooth in s,
and a polynomial through few values of s gives its distribution.
"""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._base.chebyshev import collocation_rule
from .._base.checks import namespace, or_nan
from .._base.compiling import compiled_soon
from .._base.types import Real
from ..equations._verdicts import transverse
from ..planar import Planar, saddle
from .planar_orbits import (
    ENTRY,
    Expansion,
    PlanarMotion,
    Scalar,
    follow,
    log_scale_of,
    settle,
)

SMALLEST, LARGEST = 0.005, 0.995  # δ between which the distribution of X is computed
NEARLY_SPHERICAL = 0.005, 0.0075, 0.01, 0.0125  # δ from which it is extrapolated towards 0
ADIABATIC = 0.209594686555
"""The limit of δ ln X for δ → 0.

There Z = δz obeys φ_σ = −Z − S/2, Z_σ = −Z cos 2φ, S = sin 2φ, and C = S/Z − 2 ln Z is constant. It
rises slowly, by (ln u)_C = −∫sin²φ dφ/(Z + S/2) / δ∫(3Z cos²φ + S)Z⁻² dφ over half a turn, to the
separatrix, C = 2 ln 2 − 2. The limit is that of ½δ Δln u + ⅓ ln 2Z, from Z → ∞ to there.
"""
EXTRAPOLATED, INTERPOLATED, COMPUTED = 2e-3, 3e-5, 1e-6  # errors of X
NEAR = 1e-8  # distance from a saddle at which its stable manifold is straight
NODES = 34  # nodes in s, including the two ends, where X = 0
FINE = 8000  # intervals of s for the distribution
PARTS = 512  # parts of equal probability
STEPS_OF_PHASE = 16_384  # from a known phase; nearly spherical needles take more, and have no end
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The levels of `Capture.log_quantiles`."""


class Capture(NamedTuple):
    """How the rotation of a given δ is captured: the distribution of X = |ω∞|/W."""

    residual: Real
    """The probability of residual rotation, half of it for either sense; the rest wobbles."""
    log_mean: Real
    """The logarithm of the mean of X over residual rotations."""
    log_table: Float[Array, "*any k"]
    """ln X in k equally probable parts of the residual rotations, ascending."""
    error: Real | float = 0.0
    """The estimated relative error of X."""

    def log_quantiles(self, levels: Any = LEVELS) -> Float[Array, "l"]:
        """Return the logarithms of the quantiles of X over residual rotations."""
        table = self.log_table
        return jnp.interp(jnp.asarray(levels), _middles(table.size), table)

    def log_quantiles_of_all(self, levels: Any = LEVELS) -> Float[Array, "l"]:
        """Return the logarithms of the quantiles of X, where a stop counts as X = 0."""
        stop = 1 - self.residual
        within = (jnp.asarray(levels) - stop) / jnp.where(self.residual > 0, self.residual, 1.0)
        return jnp.where(within > 0, self.log_quantiles(within), -jnp.inf)


class TopEnd(NamedTuple):
    """How a start of the averaged top ends. Logarithms, for they may not fit a number."""

    along: Real
    """The probability of residual rotation along the dipole, ω₁ > 0."""
    against: Real
    """The probability of residual rotation against the dipole, ω₁ < 0."""
    wobbling: Real
    """The probability of a stop by wobbling."""
    symmetry_axis: Real
    """1 where the start is a spin about the symmetry axis, which stops; else 0."""
    across: Real
    """1 where the start is a spin across both the dipole and the symmetry axis, which stops."""
    log_scale: Real
    """ln W/|ω₀|."""
    capture: Capture
    """The distribution of |ω∞|/|ω₀|; a single value where the phase at capture is known."""
    random: Bool[Array, "*any"]
    """Whether the start turns many times before it is captured, so that chance decides."""


def capture(delta: Scalar) -> Capture:
    """Return the distribution of X = |ω∞|/W of a random phase, W² = lim u (2δ|z|)^{−2(1−δ)/(3δ)}.

    It is computed for 0.005 ≤ δ ≤ 0.995. Beyond, the number of steps would grow like 1/δ or
    1/(1 − δ). For δ → 0 a needle is captured adiabatically, and

        ln X = A/δ + B ln δ + C + Dδ ln δ + Eδ + …

    with A = `ADIABATIC` and B … E from four computed values. For δ → 1, ln X + (ε/3δ) ln ε,
    ε = 1 − δ, is linear in ε up to its limit (`_of_rods`).

    May be jitted, vmapped, and differentiated forwards.

    Args:
        delta: δ between 0 and 1; NaN outside.
    """
    points, count = computed_at(delta, jnp)

    def add(number: Any, found: Float[Array, "4 n"]) -> Float[Array, "4 n"]:
        return found.at[number].set(distribution(*residual_orbits(points[number])))

    none = jnp.zeros((points.size, 2 + PARTS), points.dtype)
    return capture_from(delta, jax.lax.fori_loop(0, count, add, none))


def computed_at(delta: Any, xp: Any) -> tuple[Any, Any]:
    """Return the δ whose `distribution` the capture of a given δ needs, and how many they are."""
    points = xp.clip(xp.where(delta > 0, delta, 0.5), SMALLEST, LARGEST)
    low = (delta > 0) & (delta < SMALLEST)
    small = np.asarray(NEARLY_SPHERICAL)
    return xp.where(low, small, points), xp.where(low, small.size, 1)


def capture_from(delta: Scalar, found: Float[Array, "4 n"]) -> Capture:
    """Return the capture of a given δ, given the distributions where `computed_at` wants them."""
    inside, low, high = (delta > 0) & (delta < 1), delta < SMALLEST, delta > LARGEST
    delta = jnp.where(inside, delta, 0.5)
    small, first = np.asarray(NEARLY_SPHERICAL), found[0]
    share = (1 - delta) / (1 - LARGEST)
    is_log = np.where(np.arange(2 + PARTS) > 0, 1.0, 0.0)  # not the probability
    stretch = is_log * _stretch(delta)
    rod = _of_rods() + share * (first + is_log * _stretch(LARGEST) - _of_rods()) - stretch
    factors = np.linalg.inv(_powers(small, np)) @ (found - ADIABATIC / small[:, None])
    sphere = _powers(delta, jnp) @ factors + ADIABATIC / delta
    residual, log_mean, *_ = values = jnp.where(low, sphere, jnp.where(high, rod, first))
    residual = jnp.where(low, 1.0, residual)
    # The part of X that is extrapolated or interpolated is far larger than the rest of its error.
    error = jnp.where(low, EXTRAPOLATED, jnp.where(high, INTERPOLATED, COMPUTED))
    residual, log_mean, table = (or_nan(x, inside) for x in (residual, log_mean, values[2:]))
    return Capture(residual, log_mean, table, or_nan(error, inside))


def known_capture(delta: float) -> Capture:
    """Return the capture of a known δ; what it is computed from is kept for the process."""
    points, _ = computed_at(delta, np)
    found = np.stack([_kept_distribution(float(point)) for point in np.broadcast_to(points, 4)])
    return _capture_from(jnp.asarray(delta), jnp.asarray(found))


@functools.lru_cache(maxsize=1024)
def _kept_distribution(delta: float) -> np.ndarray:
    return distribution(*map(np.asarray, residual_orbits(jnp.asarray(delta))))


_capture_from = compiled_soon(capture_from)


@compiled_soon
def residual_orbits(delta: Scalar) -> tuple[Scalar, Float[Array, "n"]]:
    """Return the probability of residual rotation, and ln X at the inner `NODES` in s."""
    expansion = Expansion(-1.5 * delta / (1 - delta))
    first, residual = _residual_turns(delta, expansion)
    s = jnp.asarray(collocation_rule(NODES).nodes)
    q = expansion.q(first + residual * jnp.sin(jnp.pi * s[1:-1] / 2) ** 2)
    plane, zero = PlanarMotion(delta, jnp.zeros_like(delta)), jnp.zeros_like(q)
    ends = jax.vmap(functools.partial(settle, plane))(jnp.stack([zero, q / (2 * delta), zero], 1))
    log_x = ends.log_ratio - expansion.log_w(q)
    return residual, or_nan(log_x, jnp.all(ends.residual))


def distribution(residual: Any, log_x: Any) -> Any:
    """Return the probability of residual rotation, ln of the mean X, and ln X in `PARTS` parts.

    Args:
        residual: the probability.
        log_x: ln X at the inner nodes in s, in NumPy or JAX; at the two ends X = 0.
    """
    xp = namespace(residual, log_x)
    largest = xp.max(log_x)
    coefficients = collocation_rule(NODES).coefficients @ xp.pad(xp.exp(log_x - largest), 1)
    fine = _middles(FINE)
    x = np.polynomial.chebyshev.chebvander(2 * fine - 1, NODES - 1) @ coefficients
    weights = np.sin(np.pi * fine)
    order = xp.argsort(x)
    x = xp.maximum(x[order], np.finfo(x.dtype).tiny)
    part = xp.asarray(weights / np.sum(weights))[order]
    return xp.append(residual, largest + _log_means(part, x))


def _log_means(weights: Any, x: Any) -> Any:
    """Return ln of the mean of x, which rises, and of its means in `PARTS` parts of equal weight.

    X takes each value at two s, so the derivative of a quantile is a mean of two. Means over the
    parts have this derivative; single values in the parts do not.
    """
    xp = namespace(weights)
    sums = (xp.append(0.0, xp.cumsum(values)) for values in (weights, weights * x))
    sums = xp.interp(np.arange(PARTS + 1) / PARTS, *sums)
    return xp.append(xp.log(sums[-1]), xp.log(PARTS * xp.diff(sums)))


def _powers(delta: Any, xp: Any) -> Any:
    """Return ln δ, 1, δ ln δ and δ, on the last axis."""
    log = xp.log(delta)
    return xp.stack([log, xp.ones_like(log), delta * log, delta], axis=-1)


def _stretch(delta: Any) -> Any:
    """Return (ε/3δ) ln ε, ε = 1 − δ: z then counts in units of 1/ε."""
    return (1 - delta) / (3 * delta) * jnp.log1p(-delta)


@functools.cache
def _of_rods() -> np.ndarray:
    """Return the values of `distribution` for δ → 1.

    With ẑ = εz and dσ′ = dσ/ε the plane tends to φ′ = −ẑ, ẑ′ = −3ẑ cos²φ. So ẑ falls by (3/2)π
    each half turn, and where it has come to 0, φ has a density of cos²φ. Then z is the slow
    −sin 2φ/(3 cos²φ), and u(3 cos²φ − 2) is constant: X² = 3 cos²φ − 2 if that is positive.
    """
    edge = math.acos(math.sqrt(2 / 3))
    phi = edge * (1 - _middles(FINE) ** 2)  # dense where X vanishes; X rises
    weights = np.cos(phi) ** 2 * _middles(FINE)
    weights, x = weights / np.sum(weights), np.sqrt(3 * np.cos(phi) ** 2 - 2)
    residual = (edge + math.sin(2 * edge) / 2) / (math.pi / 2)
    return np.append(residual, _log_means(weights, x))


def is_random(delta: Any, omega0: Any, xp: Any = jnp) -> Any:
    """Return whether a start turns many times before its capture, so that chance decides.

    `xp` is JAX, or NumPy for known values.
    """
    w1, w2, w3 = omega0
    d = xp.where((delta > 0) & (delta < 1), delta, 0.5)
    log_perp, log_w3 = _log_sizes(omega0, xp)
    log_entry = xp.log(ENTRY * (1 + 1.5 * d / (1 - d)) / (2 * d))
    turns = (w3 != 0) & ((w1 != 0) | (w2 != 0))
    return turns & (log_w3 - 2 * log_perp > log_entry)


def _log_sizes(omega0: Any, xp: Any = jnp) -> tuple[Any, Any]:
    """Return ln ω⊥ and ln |ω₃|; 0 for a size of 0."""
    w1, w2, w3 = omega0
    flat = xp.where((w1 == 0) & (w2 == 0), 1.0, xp.hypot(w1, w2))
    return xp.log(flat), xp.log(xp.where(w3 == 0, 1.0, xp.abs(w3)))


def end_of_top(delta: Scalar, omega0: Float[Array, "3"], chance: Capture) -> TopEnd:
    """Return how a start of the averaged top (4.13)–(4.15) ends.

    A start with q = 2δ|ω₃|/ω⊥² below `ENTRY` (1 + |a|) has a known phase; so has one with ω₃ = 0.

    Args:
        delta: δ between 0 and 1; NaN outside.
        omega0: ω₀, not 0, of any small size: it enters by logarithms.
        chance: the `capture` of this δ.
    """
    random = is_random(delta, omega0)
    soon = jnp.array([1.0, 0.0, 0.0])  # on the residual line, in place of a phase that is not known
    ends = (
        end_by_chance(delta, omega0, chance),
        end_of_phase(delta, jnp.where(random, soon, omega0)),
    )
    return jax.tree.map(lambda x, y: jnp.where(random, x, y), *ends)


def end_by_chance(delta: Scalar, omega0: Float[Array, "3"], chance: Capture) -> TopEnd:
    """Return how a start whose phase is random (`is_random`) ends: |ω∞| = X W.

    W² = (2δ)^{−2κ} K^{1+κ}, κ = (1−δ)/(3δ), where K is the constant of (4.21), so W scales like
    |ω₀|^{1+κ}. Errors are of the order |ω₀|.
    """
    w1, w2, w3 = omega0
    flat = jnp.where((w1 == 0) & (w2 == 0), 1.0, jnp.hypot(w1, w2))
    log_perp, log_w3 = _log_sizes(omega0)
    turned = jnp.sign(w3) * 2 * (w1 / flat) * (w2 / flat)
    log_scale = log_scale_of(_within(delta), log_perp, log_w3, turned) - _log_size(omega0)
    moved = chance.log_mean + log_scale, chance.log_table + log_scale
    half, none = chance.residual / 2, jnp.zeros_like(log_scale)
    found = chance._replace(log_mean=moved[0], log_table=moved[1])
    wobbling = 1 - chance.residual
    return TopEnd(half, half, wobbling, none, none, log_scale, found, jnp.asarray(True))


def end_of_phase(delta: Scalar, omega0: Float[Array, "3"]) -> TopEnd:
    """Return how a start whose phase is known ends: it is followed in the plane."""
    w1, w2, w3 = omega0
    symmetry_axis = (w1 == 0) & (w2 == 0)
    across = (w1 == 0) & (w3 == 0) & ~symmetry_axis
    stops = symmetry_axis | across
    log_perp, log_w3 = _log_sizes(omega0)
    z = jnp.where(w3 == 0, 0.0, jnp.sign(w3) * jnp.exp(log_w3 - 2 * log_perp))
    phi = jnp.where(stops, 0.0, jnp.arctan2(w2, w1))
    zero = jnp.zeros_like(z)
    start = jnp.stack([phi, z, zero])
    known = settle(PlanarMotion(_within(delta), zero), start, STEPS_OF_PHASE)
    residual = jnp.where(stops, 0.0, _share(known.residual))
    wobbling = jnp.where(stops, 0.0, _share(known.stops))
    found = (delta > 0) & (delta < 1) & (stops | known.residual | known.stops)
    log_ratio = log_perp - _log_size(omega0) + known.log_ratio
    log_ratio = jnp.where(residual > 0, log_ratio, jnp.nan)
    along = _share(known.along)
    table = jnp.full(PARTS, log_ratio)
    error = jnp.full_like(log_ratio, COMPUTED)
    return TopEnd(
        or_nan(residual * along, found),
        or_nan(residual * (1 - along), found),
        or_nan(wobbling, found),
        _share(symmetry_axis),
        _share(across),
        jnp.full_like(log_ratio, jnp.nan),
        Capture(or_nan(residual, found), log_ratio, table, error),
        jnp.asarray(False),
    )


def _within(delta: Scalar) -> Scalar:
    """Return δ, or another one if it is not between 0 and 1."""
    return jnp.where((delta > 0) & (delta < 1), delta, 0.5)


def _log_size(omega0: Float[Array, "3"]) -> Scalar:
    """Return ln |ω₀|."""
    log_perp, log_w3 = _log_sizes(omega0)
    return jnp.logaddexp(2 * log_perp, jnp.where(omega0[2] == 0, -jnp.inf, 2 * log_w3)) / 2


def _residual_turns(delta: Scalar, expansion: Expansion) -> tuple[Scalar, Scalar]:
    """Return the interval of N in which orbits become residual: its lower end and its width P.

    Orbits of z > 0 end in the saddle (−φ*, |z*|). Above δ_c2 other orbits cross the wobbling cycle
    and end in (φ*, −|z*|).
    """
    plane, at = PlanarMotion(delta, jnp.zeros_like(delta)), saddle(Planar(delta))
    height = ENTRY * (1 - expansion.a) / (2 * delta)

    def arrival(side: Scalar) -> tuple[Scalar, Bool[Array, ""]]:
        off = [NEAR - side * at.phi, NEAR * at.stable_slope - side * at.z, jnp.zeros_like(side)]
        y = follow(
            lambda t, y, args: -plane(t, y),
            jnp.stack(off),
            lambda t, y, args, **_: (y[1] > height) | (y[1] < -height),
        ).ys[-1]
        arrives = y[1] > height
        _, z, _ = plane.section(y.at[1].max(height), -jnp.ones_like(side))
        return expansion.turns(2 * delta * z), arrives

    wobbles = delta > transverse.WOBBLING_FROM
    sides = jnp.stack([jnp.ones_like(delta), jnp.where(wobbles, -1.0, 1.0)])
    turns, arrives = jax.lax.map(arrival, sides)  # `vmap` takes longer to compile
    # Next to δ_c2, where the gap is 0 up to rounding, the second orbit may not arrive.
    gap = jnp.where(wobbles & arrives[1], turns[1] - turns[0], 0.0)
    gap = jnp.maximum(gap - jnp.floor(gap + 1e-6), 0.0)
    return or_nan(turns[0] + gap, arrives[0]), 1 - gap


def _share(certain: Bool[Array, ""]) -> Scalar:
    """Return 1 where the event is certain, else 0."""
    return jnp.where(certain, 1.0, 0.0)


def _middles(n: int) -> np.ndarray:
    """Return the middles of n equal parts of the interval from 0 to 1."""
    return (np.arange(n) + 0.5) / n
