"""The conclusions: the time of a stop, and the numbers of real particles."""

import math
from collections.abc import Iterator

import jax.numpy as jnp
from scipy.constants import c, e, hbar, year

from .. import exact, particles
from .ledger_entry import Entry

SPEED = 2e9 * math.pi  # Ω₀, rad/s: one gigahertz
FASTER = 5.2  # factor of the speed in the footnote
CM = 1e-7  # centimetres in a nanometre
GAUSSIAN = (
    (1e-15, 2 / 5 * (50 * CM) ** 2, 50 * CM * e * 10 * c),
    (6.4e-16, (100**2 + 50**2) / 12 * CM**2, 2.8e-11),
    (6.4e-16, (100**2 + 100**2) / 12 * CM**2, 2.8e-11),
    (4.32e-16, (300**2 + 30**2) / 12 * CM**2, 4e-15),
    (4 / 3 * math.pi * (2.5 * CM) ** 3 * 5.81, 2 / 5 * (2.5 * CM) ** 2, 1e-16),
    (4 / 3 * math.pi * (2.5 * CM) ** 3 * 4.82, 2 / 5 * (2.5 * CM) ** 2, 1e-16),
)
"""The paper's particles: mass in g, moment over mass in cm², dipole in statC cm."""
PRINTED = ("silica sphere", "DAST about the long axis")
"""The particles for which the paper prints a time."""


def conclusions() -> Iterator[Entry]:
    """Yield all lines about the conclusions."""
    yield ceases()
    rows = particles.particle_table(particles.paper_particles(), SPEED)
    for row, (mass, square, dipole) in zip(rows, GAUSSIAN, strict=True):
        tau0 = 2 * dipole**2 / (3 * (100 * c) ** 3 * mass * square)
        residual = max(abs(row.tau0 / tau0 - 1), abs(row.braking_time * tau0 * SPEED**2 - 1))
        claim = f"{row.name}: τ₀ = {row.tau0:.3g} s, T = {row.braking_time:.3g} s (SI against cgs)"
        if row.name not in PRINTED:
            claim += ", not in the paper"
        yield Entry("conclusions", claim, residual, 1e-8)
    yield from printed(rows[0], rows[1])


def ceases() -> Entry:
    """Check when Ω ~ 1/√(τ₀t) holds for the rotator, in units of T = 1/(τ₀Ω₀²)."""
    times = jnp.array([1e-12, 1e12])
    ratio = exact.rotator(1.0, times) * jnp.sqrt(2 * times)
    residual, wrong = (abs(float(x) - 1) for x in (ratio[1], ratio[0]))
    claim = "Ω√(2τ₀t) → 1 for t ≫ T = 1/(τ₀Ω₀²), here t = 1e12 T"
    return Entry("conclusions", claim, residual, 1e-12, "for t ≪ T, here t = 1e-12 T", wrong)


def printed(silica: particles.Row, dast: particles.Row) -> Iterator[Entry]:
    """Yield the numbers printed in the paper, compared to its digits."""
    radius = 50e-9
    spin = silica.moment * SPEED / hbar
    rim = radius * SPEED / c
    for name, value, number, text, digits in (
        ("silica sphere: d = eR", silica.debye, 2400.0, "2400 D", 1e-3),
        ("silica sphere: τ₀", silica.tau0, 1e-35, "~ 1e-35 s", 0.5),
        ("silica sphere: T", silica.braking_time, 2e15, "~ 2e15 s", 0.25),
        ("silica sphere: T in years", silica.braking_time / year, 0.5e8, "0.5e8", 0.2),
        ("DAST about the long axis: T in years", dast.braking_time / year, 0.3, "0.3", 1 / 6),
    ):
        claim = f"{name} = {value:.4g} (printed: {text})"
        yield Entry("conclusions", claim, abs(value / number - 1), digits)
    claim = f"silica sphere: angular momentum {spin:.2g} ħ (printed: ≳ 1e10 ħ)"
    yield Entry("conclusions", claim, 1e10 / spin, 1.0)
    claim = f"silica sphere: rim speed v/c = {rim:.2e} at 1 GHz (printed: ≤ 1e-6)"
    yield Entry("conclusions", claim, max(rim / 1e-6 - 1, 0.0), 0.5)
    claim = f"silica sphere: v/c = {FASTER * rim:.1e} at the {FASTER} GHz of its footnote"
    residual, wrong = abs(FASTER * rim / 5.4e-6 - 1), FASTER * rim / 1e-6 - 1
    yield Entry("conclusions", claim, residual, 0.02, "v/c ≤ 1e-6", wrong)
