"""The averaged diffusion of (E, |L|) by the thermal field of radiation, in closed form."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._averaging.free_rotation import averages, elliptic_means, path, period
from .._averaging.orbit import motion_of
from .._base.checks import finite, instance, on_host, where_valid
from .._base.compiling import compiled_soon
from .._base.refusals import refuse
from .._base.types import Real
from ..bodies import Body
from .bath import Bath


class Diffusion(NamedTuple):
    """Coefficients at one E and |L|; dimensionless, as the body.

    The averages of the friction are −energy/θ for E and −mixed/θ for |L|. The density of the
    equilibrium is proportional to |L| T e^{−E/θ} in E and |L|.
    """

    energy: Real
    """D_EE = θκ⟨|n₂|²⟩."""
    mixed: Real
    """D_EL = θκ⟨L̂·(n₁×n₂)⟩."""
    momentum: Real
    """D_LL = θκ⟨|n₁|² − (n₁·L̂)²⟩."""
    period: Real
    """T, the period of L in the body; infinite for a sphere."""


def diffusion(body: Body, bath: Bath, omega: Any) -> Diffusion:
    """Compute the averaged diffusion of (E, |L|) by the thermal field that the dipole feels.

    With yᵢ = Lᵢ²/L² and pᵢ = 1/Jᵢ a dipole along axis i has, with j and k the other two,

        |n₁|² − (n₁·L̂)² = L²[pⱼ²yⱼ + pₖ²yₖ − (pⱼ − pₖ)²yⱼyₖ];

    the other averages are those of the slow flow. n₁ and n₂ are the derivatives of the dipole's
    direction in the laboratory.

    Args:
        body: a single body.
        bath: the bath, whose `heat` is θ; its drag is not counted.
        omega: ω in body axes, shape (3,), not zero, about no axis across a symmetry axis or with
            the middle moment, nor on the separatrix: there the result is NaN.

    Returns:
        The coefficients.

    Raises:
        ValueError: bad arguments.

    Example:
        A dipole across the axis of a steady rotation: D_LL = θκΩ².

        >>> import dipoletop as dt
        >>> found = dt.noise.diffusion(dt.axisymmetric(-0.5), dt.noise.Bath(2.0), [0, 0, 0.1])
        >>> print(f"{found.momentum:.6f}, {found.energy:.6f}")
        0.020000, 0.000200
    """
    instance("body", body, Body)
    instance("bath", bath, Bath)
    if body.inertia.ndim != 2:
        refuse("body", "be a single one (`jax.vmap` takes a batch)", "is a batch of them")
    rate = finite("omega", omega, (3,), batch=False)
    rate = where_valid("omega", rate, (on_host(rate) != 0).any(), "not be zero")
    return _diffusion(body, bath.heat, rate)


@compiled_soon
def _diffusion(body: Body, heat: Real, omega: Float[Array, "3"]) -> Diffusion:
    kappa, speed = jnp.sum(body.dipole**2), jnp.linalg.norm(omega)
    orbit, spin = motion_of(body.inertia, body.dipole / jnp.sqrt(kappa), omega / speed)
    squares, size = orbit.dipole**2, jnp.linalg.norm(orbit.momentum)
    r, _ = averages(orbit.moments, orbit.x, orbit.rest)
    to_a, to_b, a_to_b, q, m, m1 = path(orbit.moments, orbit.x, orbit.rest)
    sn2, sn4 = elliptic_means(m, m1)
    cn2, sn2_cn2 = 1 - sn2, sn2 - sn4
    ya, yb, yc = orbit.x * to_b / to_a, orbit.x, q / to_a
    y = jnp.stack([ya * cn2, yb * sn2, yc * (1 - m * sn2)])
    # ⟨yⱼyₖ⟩, with dn² = (1 − m) + m cn², and the differences pⱼ − pₖ
    bc = yb * yc * (m1 * sn2 + m * sn2_cn2)
    ac = ya * yc * (m1 * cn2 + m * (cn2 - sn2_cn2))
    pairs, gaps = jnp.stack([bc, ac, ya * yb * sn2_cn2]), jnp.stack([to_b, to_a, a_to_b])
    losses = y / orbit.moments**2
    momentum = squares @ (jnp.sum(losses) - losses - gaps**2 * pairs)
    strength = jnp.where(spin.holds, jnp.nan, heat * kappa)
    return Diffusion(
        strength * speed**4 * orbit.power(),
        strength * speed**3 * size**3 * (squares @ r),
        strength * speed**2 * size**2 * momentum,
        period(orbit.moments, orbit.x, orbit.rest) / (size * speed),
    )
