"""Averages of what a dipole radiates over the free rotation of its body, in closed form.

A body that radiates weakly turns freely for many periods. With pᵢ = 1/Jᵢ and yᵢ = Lᵢ²/L² its
angular momentum L (body axes) keeps L² and h = 2E/L² = Σ pᵢyᵢ, and moves round one axis: the axis
of the largest moment if h < p₂ (the low side), of the smallest if h > p₂ (the high side). Call it
c, the other extreme axis a and the middle one b, and write a, b, c for p_a, p_b, p_c.
With the differences Da = a − c, Db = b − c, Dab = a − b the orbit is

    y_a = x (Db/Da) cn²,   y_b = x sn²,   y_c = (q/Da) dn²,   q = Dab + (1 − x)Db,
    x = (h − c)/Db,   m = Dab x/q,   1 − m = (1 − x)Da/q.

x runs from 0 on the axis to 1 on the separatrix h = p₂.

A dipole along the unit vector n loses energy and angular momentum by dE/dt = −κ⟨Q⟩ and
d(L²)/dt = −2κ⟨R⟩ at first order in κ = k d², where Ω = pL, v = Ω̇×Ω, and

    Q = Ω²|Ω×n|² + |Ω̇×n|² − 2(n·Ω)(n·v),   R = 2E|Ω×n|² − (n·L)(n·v).

Terms with nᵢnⱼ, i ≠ j, average to zero. So r = ⟨R⟩/L⁴ and f = dh/ds = ⟨hR/L⁴ − Q/L⁴⟩, with
ds = 2κL²dt, are sums of nᵢ²rᵢ and nᵢ²fᵢ. For n along axis i, with j and k the other two,

    n·L n·v/L⁴ = yᵢ pⱼpₖ Σⱼ yⱼ(pᵢ − pⱼ),
    |Ω×n|²/L² = Σⱼ pⱼ²yⱼ,   |Ω̇×n|²/L⁴ = yᵢ Σⱼ pₖ²yⱼ(pᵢ − pⱼ)²,

and Ω²/L² − h² = Var, the variance of p with the weights y: it is linear in sn², so it equals
x Db [q cn² + (1 − x)Db sn²]. Hence, with the sums over the two axes j ≠ i,

    rᵢ = Σⱼ {pⱼ³⟨yⱼ²⟩ + pⱼ[pᵢpⱼ − pₖ(pᵢ − pⱼ)]⟨yᵢyⱼ⟩} + pⱼpₖ(pⱼ + pₖ)⟨yⱼyₖ⟩
    fᵢ = Σⱼ {−pⱼ²⟨yⱼ Var⟩ + ⟨yᵢyⱼ⟩(pᵢ − pⱼ) pₖ[(2pᵢ − h)pⱼ − pₖ(pᵢ − pⱼ)]}.

Both Var and every yᵢyⱼ(pᵢ − pⱼ) contain the factor x Db, which is divided out: f = x Db F. The
terms with sn⁴ of each sum cancel, so that both means are ⟨cn²⟩ times the value where sn = 0, plus
⟨sn²⟩ times that where cn = 0: as if L stood at these two places only, where y_a y_b = 0. All
differences are differences of moments. So the only cancellation in r and F is the one that makes
F zero, also for nearly spherical and nearly axisymmetric bodies, on the axes and next to the
separatrix.
"""

import math
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.linalg import components
from .._base.types import Real

AGM_STEPS = 9  # of the arithmetic-geometric mean: enough down to 1 − m = 1e-30


def gaps_of(moments: Float[Array, "3 *#lanes"]) -> tuple[Real, Real, Real]:
    """Compute the differences a − c, b − c and a − b of the reciprocals a, b, c of moments."""
    ja, jb, jc = components(moments)
    return (jc - ja) / (ja * jc), (jc - jb) / (jb * jc), (jb - ja) / (ja * jb)


def path(moments: Float[Array, "3 *#lanes"], x: Real, rest: Real) -> tuple[Real, ...]:
    """Return Da, Db, Dab, q, m and 1 − m, the path of L; for the arguments see `averages`."""
    to_a, to_b, a_to_b = gaps_of(moments)
    q = a_to_b + rest * to_b
    return to_a, to_b, a_to_b, q, a_to_b * x / q, rest * to_a / q


@jax.jit
def averages(
    moments: Float[Array, "3 *#lanes"], x: Real, rest: Real
) -> tuple[Float[Array, "3 *#lanes"], Float[Array, "3 *#lanes"]]:
    """Return the rates r = −d ln L²/ds and F = d ln x/ds of a dipole along a, b and c.

    Args:
        moments: J_a, J_b, J_c: the axis that L moves round comes last, the middle one second.
        x: (h − c)/Db, from 0 to 1.
        rest: 1 − x, to its own relative accuracy.
    """
    # Of a top the closed form gives values and derivatives by x; the general one those by moments.
    is_top, fixed = moments[0] == moments[1], jax.lax.stop_gradient
    exact = _averages_of_top(fixed(moments), x, rest)
    x, rest = (jnp.where(is_top, fixed(number), number) for number in (x, rest))
    a, b, c = p = components(1 / moments)
    to_a, to_b, a_to_b, q, m, m1 = path(moments, x, rest)
    h = rest * c + x * b
    sn2, _ = elliptic_means(m, m1)
    cn2 = 1 - sn2
    ya, yb, yc = x * to_b / to_a, x, q / to_a  # times cn², sn², dn², which is 1 or 1 − m
    # Of axis i: pᵢ³⟨yᵢ²⟩ and pᵢ²⟨yᵢ Var⟩. Of the axes j and k that follow it in the cycle a, b, c:
    # ⟨yⱼyₖ⟩, pᵢ(pⱼ − pₖ) and pᵢ⟨yⱼyₖ⟩(pⱼ − pₖ). Means with Var or a difference are over x Db.
    squares = a**3 * ya**2 * cn2, b**3 * yb**2 * sn2, c**3 * yc**2 * (cn2 + m1**2 * sn2)
    slope = rest * to_b
    losses = (
        a**2 * ya * q * cn2,
        b**2 * yb * slope * sn2,
        c**2 * yc * (q * cn2 + m1 * slope * sn2),
    )
    mixed = yb * yc * m1 * sn2, ya * yc * cn2, 0.0
    gaps = a * to_b, -b * to_a, c * a_to_b
    torques = a * yc * m1 * sn2, -b * yc * cn2, 0.0

    def of_dipole(i: int) -> tuple[Real, Real]:
        j, k = (i + 1) % 3, (i + 2) % 3
        with_j, with_k = p[i] * p[j] - gaps[k], p[i] * p[k] + gaps[j]
        r = p[j] * p[k] * (p[j] + p[k]) * mixed[i] + squares[j] + squares[k]
        r += p[j] * with_j * mixed[k] + p[k] * with_k * mixed[j]
        turned = p[i] - h
        growth = torques[k] * (with_j + turned * p[j]) - torques[j] * (with_k + turned * p[k])
        return r, growth - (losses[j] + losses[k])

    every = map(jnp.stack, zip(*map(of_dipole, range(3)), strict=True))
    r, growth = (
        jnp.where(is_top, known + _change(found), found)
        for known, found in zip(exact, every, strict=True)
    )
    return r, growth


def _change(value: Array) -> Array:
    """Return 0 with the derivatives of numbers, where these are finite."""
    return jnp.where(jnp.isfinite(value), value - jax.lax.stop_gradient(value), 0.0)


def _averages_of_top(
    moments: Float[Array, "3 *#lanes"], x: Real, rest: Real
) -> tuple[Float[Array, "3 *#lanes"], Float[Array, "3 *#lanes"]]:
    """Return `averages` for J_a = J_b, where L moves round the symmetry axis c on a circle.

    With ζ = J_c/J_a = 1 − δ (4.13)–(4.14) give, for a dipole across the axis,

        r = a³x²/2 + (3/2)ac²x(1 − x) + c³(1 − x)²,
        F = a³(1 − x){(1 + 2δ)x + (1 + δ³)(1 − x)/ζ²}/(2ζ),

    whose zero is found to rounding of the moments, however near it is to an end.
    """
    ja, _, jc = components(moments)
    a, c, zeta = 1 / ja, 1 / jc, jc / ja
    delta = 1 - zeta
    cubic = (2 - zeta) * (zeta + delta**2)  # 1 + δ³
    cube = a**3
    r = cube * x**2 / 2 + 1.5 * a * c**2 * x * rest + c**3 * rest**2
    growth = cube * rest * ((3 - 2 * zeta) * x + cubic * rest / zeta**2) / (2 * zeta)
    return jnp.stack([r, r, cube * x]), jnp.stack([growth, growth, -cube * rest])


def mean_square_speed(moments: Float[Array, "3 *#lanes"], x: Real, rest: Real) -> Real:
    """Compute ⟨Ω²⟩/L² = h² + ⟨Var⟩; for the arguments see `averages`."""
    _, jb, jc = components(moments)
    _, to_b, _, q, m, m1 = path(moments, x, rest)
    sn2, _ = elliptic_means(m, m1)
    return (rest / jc + x / jb) ** 2 + x * to_b * (q * (1 - sn2) + rest * to_b * sn2)


def period(
    moments: Float[Array, "3 *#lanes"], x: Real, rest: Real, longest: float = math.inf
) -> Real:
    """Return the period of L in the body, times L, with K ≤ `longest`; see `averages`."""
    _, to_b, _, q, _, m1 = path(moments, x, rest)
    quarter = jnp.minimum(quarter_period(m1), longest)
    return 4 * quarter / jnp.sqrt(to_b * q)  # the argument of sn is L t √(Db q)


def quarter_period(m1: Any, xp: ModuleType = jnp) -> Any:
    """Compute K(1 − m1) by the arithmetic-geometric mean, in JAX or, with `xp=np`, in NumPy."""
    mean, geometric = xp.ones_like(m1), xp.sqrt(m1)
    for _ in range(AGM_STEPS):
        mean, geometric = (mean + geometric) / 2, xp.sqrt(mean * geometric)
    return xp.pi / (2 * mean)


def elliptic_means(m: Real, m1: Real) -> tuple[Real, Real]:
    """Compute ⟨sn²⟩ and ⟨sn⁴⟩ over a period, for a parameter m in [0, 1] and m1 = 1 − m.

    The arithmetic-geometric mean aₙ of 1 and √m1, with cₙ₊₁ = (aₙ − gₙ)/2, gives E/K: the sum
    k = Σ 2ⁿ(cₙ/m)², n ≥ 1, is ⟨sn²⟩ = ½ + mk/2. A reduction of sn⁴ gives ⟨sn⁴⟩ = k/3 + ⅔⟨sn²⟩. The
    recurrence cₙ₊₁ = cₙ²/(4aₙ₊₁) is free of cancellation.

    Source: NIST Digital Library of Mathematical Functions, sections 19.8(i) and 22.14.
    """
    mean, geometric = jnp.ones_like(m1), jnp.sqrt(m1)
    both = mean + geometric
    part = total = 1 / (2 * both**2)  # 2ⁿ(cₙ/m)², n = 1
    for n in range(2, 1 + AGM_STEPS):
        mean, geometric = both / 2, jnp.sqrt(mean * geometric)
        both = mean + geometric
        part = (m * part / both) ** 2 / 2**n
        total = total + part
    sn2 = 0.5 + m * total / 2
    return sn2, total / 3 + 2 * sn2 / 3
