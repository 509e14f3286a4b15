"""Elliptic integrals by Landen's descent to a smaller modulus, which squares it at every step.

With r₀ = √(1 − m) and rₙ₊₁ = 2√rₙ/(1 + rₙ) the arithmetic-geometric mean of 1 and r₀ is the product
of the (1 + rₙ)/2. 1 − rₙ has a recurrence of its own, so nothing cancels at m = 0 or near m = 1.

Source: NIST Digital Library of Mathematical Functions, sections 19.8, 20.9 and 22.20; for the
integral of the third kind R. Bulirsch, Numerische Mathematik 13, 305 (1969).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.types import Real
from .free_rotation import AGM_STEPS


class Descent(NamedTuple):
    """The quantities that depend on the parameter m alone."""

    ratios: Float[Array, "steps"]
    """rₙ."""
    gaps: Float[Array, "steps"]
    """1 − rₙ."""
    mean: Real
    """The arithmetic-geometric mean of 1 and √(1 − m), which is π/2K."""
    root: Real
    """√(q/m), with q = exp(−πK′/K), the nome."""


def descent(m: Real, m1: Real) -> Descent:
    """Compute the descent from the parameter m in [0, 1), with m1 = 1 − m > 0."""

    def step(now: tuple[Real, Real], _: None) -> tuple[tuple[Real, Real], tuple[Real, Real]]:
        ratio, gap = now
        root = jnp.sqrt(ratio)
        following = 2 * root / (1 + ratio), gap**2 / ((1 + ratio) * (1 + root) ** 2)
        return following, now

    first = jnp.sqrt(m1)
    _, (ratios, gaps) = jax.lax.scan(step, (first, m / (1 + first)), length=AGM_STEPS)
    halves = 1 - gaps / 2  # (1 + rₙ)/2
    weights = 0.5 ** jnp.arange(AGM_STEPS, dtype=ratios.dtype).at[0].set(0.0)
    return Descent(ratios, gaps, jnp.prod(halves), jnp.prod(halves**-weights) / 4)


def lag(steps: Descent, t: Real, s: Real, z: Real) -> Real:
    """Return the lag artanh t − (π/2K) F(arcsin t | 1 − m), which is not negative.

    On the imaginary axis the descent reads ψₙ₊₁ = ψₙ + artanh(rₙ tanh ψₙ), where ψₙ/2ⁿ tends to the
    integral. So it is Σ δₙ/2ⁿ⁺¹ with δₙ = ψₙ − artanh(rₙ tanh ψₙ).

    Args:
        steps: the descent from m.
        t: tanh ψ₀.
        s: 1 − t².
        z: (1 − r₀)/s, at most about 10: both may be 0.
    """

    def step(now: tuple[Real, ...], row: tuple[Real, Real]) -> tuple[tuple[Real, ...], Real]:
        (t, s, z), (r, gap) = now, row
        delta = (jnp.log1p(z * t * (1 + t)) - jnp.log1p(-gap * t / (1 + t))) / 2
        grown = 1 + z * (1 + r) * t**2  # (1 − r²t²)/s
        sum_ = 1 + r * t**2
        z = z**2 * sum_**2 / ((1 + r) * (1 + jnp.sqrt(r)) ** 2 * grown)
        return (t * (1 + r) / sum_, s**2 * grown / sum_**2, z), delta

    _, deltas = jax.lax.scan(step, (t, s, z), (steps.ratios, steps.gaps))
    return jnp.sum(deltas * 0.5 ** jnp.arange(1.0, AGM_STEPS + 1, dtype=t.dtype))


def uniform_phase(steps: Descent, amplitude: Real) -> Real:
    """Compute (π/2K) F(φ | m) of an amplitude φ, by ψₙ₊₁ = ψₙ + arctan(rₙ tan ψₙ), ψ₀ = φ."""

    def step(psi: Real, row: tuple[Real, Real]) -> tuple[Real, None]:
        (r, gap), sine, cosine = row, jnp.sin(psi), jnp.cos(psi)
        return 2 * psi - jnp.arctan2(gap * sine * cosine, cosine**2 + r * sine**2), None

    psi, _ = jax.lax.scan(step, amplitude, (steps.ratios, steps.gaps))
    return psi / 2.0**AGM_STEPS


def mean_of_ratio(steps: Descent, g: Real, p: Real, q: Real) -> Real:
    """Return the mean of (p g cn² + q sn²)/(g cn² + sn²) over a period, for g > 0."""

    def step(now: tuple[Real, ...], _: None) -> tuple[tuple[Real, ...], None]:
        first, second, root, mean, ratio, product = now
        part = product / root
        first, second = first + second / root, 2 * (second + first * part)
        mean = mean + ratio
        ratio = 2 * jnp.sqrt(product)
        return (first, second, root + part, mean, ratio, ratio * mean), None

    r, root = steps.ratios[0], 1 / jnp.sqrt(g)
    start = p, q * root, root, jnp.ones_like(g), r, r
    (first, second, root, mean, _, _), _ = jax.lax.scan(step, start, length=AGM_STEPS)
    return steps.mean * (second + first * mean) / (mean * (mean + root))
