"""The Fourier series of a dipole that turns freely with its body, in a frame with axis 3 along L.

In units of the phase θ = π v/2K of the orbit, with w = πK′/2K, β = π/2K and k² = m, the component
along L of the unit vectors along the axes a, b, c is the sum over all j of e^{ijθ} times

    β(A/k) sech jw,   −iβ(B/k) csch jw   (j odd),      βC sech jw   (j even):

these are cn, sn and dn. The component across L, D₁ + iD₂, obeys the same linear equations,
Ẇ = W×Ω, and has its poles where cn, sn and dn have theirs, with residues in the same ratio. But
from one pole to the next it changes by another factor. So it is e^{iΦ̇t} times the sum of e^{ijθ}
times

    β(A/k) csch(jw + α),   −iβ(B/k) sech(jw + α)   (j odd),      βC csch(jw + α)   (j even),

where α = βF(arcsin C | 1 − m) follows from its zero, at l_c = 1, and |W|² = 2 fixes the size.
With η = w − α = βF(arcsin √g | 1 − m), the nome q = e^{−2w}, E = e^{−α} and G = e^{−η} every
amplitude is made of powers of q, E and G, so that it is finite on the axis and for equal moments.

Source: E. T. Whittaker, Analytical Dynamics, section 69, gives these direction cosines by theta
functions; the series of their quotients are those of Kronecker and Jacobi.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from .._base.guards import safe_sqrt
from .._base.types import Real
from .landen import Descent, lag
from .orbit import MomentumOrbit

Terms = Float[Array, "k"]


class Series(NamedTuple):
    """The series of a dipole of length 1."""

    along: Complex[Array, "n"]
    """The component along L is Re Σ 2cⱼe^{ijθ}, j = 1 … n, and a constant."""
    across: Complex[Array, "m"]
    """The component across L is e^{iΦ̇t} Σ wⱼe^{ijθ}, j = −n … n."""


def series(orbit: MomentumOrbit, steps: Descent, n: int) -> Series:
    """Return the Fourier coefficients up to the n-th harmonic."""
    return Series(_along(orbit, steps, n), _across(orbit, steps, n))


def _powers(q: Real, count: int) -> Terms:
    """Compute 1, q, q², …, with derivatives at q = 0."""
    return jnp.cumprod(jnp.concatenate([jnp.ones((1,), q.dtype), jnp.repeat(q, count - 1)]))


def _interleaved(odd: Array, even: Array, n: int) -> Array:
    """Return the terms of odd and even j, in the order j = 1, 2, …, n."""
    count = (n + 1) // 2
    both = zip((odd, even), (count, n // 2), strict=True)
    odd, even = (jnp.pad(terms[:length], (0, count - length)) for terms, length in both)
    return jnp.stack([odd, even], axis=-1).reshape(-1)[:n]


def _along(orbit: MomentumOrbit, steps: Descent, n: int) -> Complex[Array, "n"]:
    count = (n + 1) // 2
    root, sx = steps.root, safe_sqrt(orbit.x)
    q = orbit.x * orbit.gaps[2] / orbit.q * root**2
    powers = _powers(q, count + 1)
    first, next_ = powers[:-1], powers[1:]
    na, nb, nc = orbit.dipole
    odd = first**2 * q  # q^j
    a = 2 * na * jnp.sqrt(orbit.g) * sx * root * first / (1 + odd)
    b = 2 * nb * sx * root * first / (1 - odd)
    c = 2 * nc * jnp.sqrt(orbit.q / orbit.gaps[0]) * next_ / (1 + next_**2)
    real = _interleaved(a, c, n)
    imaginary = _interleaved(-b, jnp.zeros_like(b), n)
    return jax.lax.complex(steps.mean * real, steps.mean * imaginary)


def _factors(orbit: MomentumOrbit, steps: Descent) -> tuple[Real, Real, Real, Real]:
    """Compute E/√x, G √(q/Dab), 1 − E² and 1 − G².

    E and G follow from the one of α and η that is smaller at m = 0, where w is infinite. They come
    without the factors that vanish on the axis and for equal moments.
    """
    x, q, g, root = orbit.x, orbit.q, orbit.g, steps.root
    c = jnp.sqrt(q / orbit.gaps[0])
    by_eta = g < 0.5

    def ordered(first: Real, second: Real) -> tuple[Real, Real]:
        """Exchange two numbers if η is the smaller one."""
        return jnp.where(by_eta, second, first), jnp.where(by_eta, first, second)

    t, other = ordered(c, jnp.sqrt(g))
    s = jnp.where(by_eta, orbit.gaps[2] / orbit.gaps[0], x * g)
    excess = jnp.where(by_eta, x * orbit.gaps[0], orbit.gaps[2] / g) / (q * (1 + steps.ratios[0]))
    total = lag(steps, t, s, excess)
    near = other / (1 + t) * jnp.exp(total)
    far = root / near
    # 1 − e^{−2ψ}, where e^{−ψ} = √s/(1 + t) e^{total}; neither term is small beside the result.
    one_minus_near = (2 * t - s / (1 + t) * jnp.expm1(2 * total)) / (1 + t)
    one_minus_far = 1 - far**2 * jnp.where(by_eta, x, orbit.gaps[2] / q)
    return *ordered(near, far), *ordered(one_minus_near, one_minus_far)


def _across(orbit: MomentumOrbit, steps: Descent, n: int) -> Complex[Array, "m"]:
    e, g, one_minus_e2, one_minus_g2 = _factors(orbit, steps)
    root, sx, k = steps.root, safe_sqrt(orbit.x), safe_sqrt(orbit.gaps[2] / orbit.q)
    q = orbit.x * k**2 * root**2
    e2, g2 = orbit.x * e**2, k**2 * g**2
    na, nb, nc = orbit.dipole
    na, nc = na * jnp.sqrt(orbit.g), nc * jnp.sqrt(orbit.q / orbit.gaps[0]) * sx
    powers = _powers(q, n // 2 + 1)
    squares, first = powers**2, jnp.arange(powers.size) == 0
    # j = 1, 3, …; j = 0, 2, …; j = −1, −3, …; j = −2, −4, …
    odd, down = orbit.x * root * e * powers, g * powers
    up_a, up_b = na * odd / (1 - squares * q * e2), nb * odd / (1 + squares * q * e2)
    up_c = nc * e * powers / jnp.where(first, one_minus_e2, 1 - squares * e2)
    down_a = na * down / jnp.where(first, one_minus_g2, 1 - squares * g2)
    down_b = nb * down / (1 + squares * g2)
    down_c = nc * k**2 * root * down / (1 - squares * q * g2)
    zero = jnp.zeros_like(powers)
    real = [-_interleaved(down_a, down_c, n)[::-1], up_c[:1], _interleaved(up_a, up_c[1:], n)]
    imaginary = [-_interleaved(down_b, zero, n)[::-1], zero[:1], -_interleaved(up_b, zero, n)]
    real, imaginary = (2 * steps.mean * jnp.concatenate(terms) for terms in (real, imaginary))
    return jax.lax.complex(real, imaginary)
