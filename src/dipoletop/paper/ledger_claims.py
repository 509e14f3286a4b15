"""Figures 1 and 2, the outcomes that the paper claims, and the numbers of its conclusions."""

import math
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from scipy.constants import c, e, hbar, year

from .. import exact, particles, planar
from .._base.types import Outcome, Stop
from .._maps.grids import Sample
from .._runs.classification import Classification
from .._runs.classify import classify
from .._runs.classify_many import classify_many
from .._runs.simulate import simulate
from ..bodies import Body
from ..equations.coordinates import cylindrical
from ..equations.rigid import Reduced
from ..equations.transverse import TransverseFull, TransverseReduced, TransverseSemi
from ..stability import equilibria, spectrum
from ..validation import RESIDUAL_ROTATION, figure_2
from .ledger_entry import Entry, gap, share

SHAPES = (-1.0, -0.7, -0.5, -0.4, -0.2, -0.05, 0.0, 0.3, 0.6)
STARTS = 256  # isotropic starts of every body
SPECIAL = (
    (0.3, (0.0, 0.0, 0.2)),  # ω⊥ = 0
    (0.3, (0.0, 0.2, 0.0)),  # ω₁ = ω₃ = 0
    (0.0, (0.0, 0.2, 0.1)),  # ω₁ = 0, a sphere
    (0.3, (0.0, 0.2, 0.1)),
    (-0.7, (0.1, 0.1, 0.0)),  # ω₃ = 0
    (-0.5, (0.1, -0.1, 0.0)),
)
"""Shapes and starts that are exceptions to the paper's claims, or are named in it."""
STOPS = np.array([True, True, True, False, False, False])
"""Whether the starts of `SPECIAL` stop."""
FULL_A = (0.13148744208692057915, 0.068501995595988332757, 0.029559231623915714665)
"""ω of figure 2a at τ = 60 by the full equation, from a shooting method."""
FULL_B = (-0.027570924803771399734, 0.067039540720074546728, 0.059353536931937492011)
"""ω of figure 2b at τ = 60 by the full equation, from a shooting method."""
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


def figures() -> Iterator[Entry]:
    """Yield figure 2 at order 1, and the same starts by the full equation."""
    checks = figure_2()
    for part in ("figure 2a", "figure 2b"):
        error = max(check.error for check in checks if check.name.startswith(part))
        yield Entry(part, "ω(τ) at order 1 to ten digits", float(error), 1e-9)
    starts = [cylindrical(0.2, 0.2, phi) for phi in (np.pi / 30, np.pi / 3)]
    first = float(classify(TransverseReduced(-0.2), starts[0], rtol=1e-11).omega_inf)
    claim = f"ω∞ = {first:.10f} at order 1 (drawn in the paper, not printed)"
    yield Entry("figure 2a", claim, abs(first / RESIDUAL_ROTATION - 1), 1e-9)
    true = float(classify(TransverseFull(-0.2), starts[0]).omega_inf)
    claim = f"ω∞ = {true:.4f} by the full equation"
    printed = f"order 1, drawn only; it ends at {first:.4f}"
    yield Entry("figure 2a", claim, abs(true / 0.1193 - 1), 5e-4, printed, abs(first / true - 1))
    times = np.array([0.0, 60.0, 12_000.0])
    runs = [simulate(TransverseFull(-0.2), start, times, balance=True) for start in starts]
    error = max(gap(run.omega[1], known) for run, known in zip(runs, (FULL_A, FULL_B), strict=True))
    claim = "the full equation at τ = 60, against a shooting method"
    yield Entry("figure 2", claim, error, 1e-8)
    error = max(float(jnp.max(jnp.abs(run.balance_defect))) for run in runs)
    yield Entry("figure 2", "the full equation up to τ = 12 000: energy balance", error, 1e-8)


def first_order() -> Classification:
    """Compute runs at order 1: `STARTS` isotropic starts of every shape, then `SPECIAL`."""
    omegas = Sample(len(SHAPES) * STARTS, amplitude=0.2, seed=6)
    starts = np.asarray(omegas.points(np.arange(len(SHAPES) * STARTS)))
    deltas = np.append(np.repeat(SHAPES, STARTS), [delta for delta, _ in SPECIAL])
    return classify_many(
        TransverseReduced(jnp.asarray(deltas)),
        jnp.asarray(np.concatenate([starts, [omega for _, omega in SPECIAL]])),
    )


def outcomes() -> Iterator[Entry]:
    """Yield figure 1 and section 4.2 at order 1."""
    runs = first_order()
    outcome, value = np.asarray(runs.outcome), np.asarray(runs.omega_inf)
    kept = (outcome[: -len(SPECIAL)] == Outcome.RESIDUAL).reshape(-1, STARTS)
    stop = (outcome[: -len(SPECIAL)] == Outcome.STOP).reshape(-1, STARTS)
    shapes, special = np.array(SHAPES), outcome[-len(SPECIAL) :]
    oblate, prolate = shapes <= -0.5, shapes >= 0
    both = kept[~oblate & ~prolate].any(axis=1) & stop[~oblate & ~prolate].any(axis=1)
    wrong = share([~stop[oblate], ~kept[prolate]]) + share([~both])
    claim = "order 1: stop for δ ≤ −1/2, both for −1/2 < δ < 0, residual for δ ≥ 0"
    yield Entry("figure 1", claim, wrong, 0.0)
    stopped = special == Outcome.STOP
    settled = stopped | (special == Outcome.RESIDUAL)
    wrong = share([stopped[:3] != STOPS[:3], ~settled[:3], ~kept[prolate]])
    claim = "δ ≥ 0: residual, but not for ω⊥ = 0, ω₁ = ω₃ = 0, or δ = 0 with ω₁ = 0"
    printed = "residual from arbitrary Ω₀"
    yield Entry("section 4.2, 1", claim, wrong, 0.0, printed, share([stopped[:3]]))
    wrong = share([stopped[2:4] != STOPS[2:4], ~settled[2:4]])
    claim = "Ω∞ ≠ 0 even if Ω₁₀ = 0, for δ > 0"
    yield Entry("section 4.2, 1", claim, wrong, 0.0, "for δ ≥ 0", share([stopped[2:4]]))
    yield capture()
    wrong = max(gap(value[-2:], np.array([0.1, 0.1])), share([~stop[oblate]]))
    claim = "δ ≤ −1/2: stop, except for ω₃ = 0, where ω₁ is constant"
    printed = share([~stopped[-2:]])
    yield Entry("section 4.2, 2", claim, wrong, 1e-12, "reaches Ω = 0", printed)


def capture() -> Entry:
    """Check that residual rotation may be reached only after many revolutions."""
    delta = 0.05
    times = np.array([0.0, 100.0, 1e3, 1e4, 1e5])
    run = simulate(TransverseReduced(delta), cylindrical(0.03, 0.298, 1.0), times)
    omega = np.asarray(run.omega)
    speed = np.linalg.norm(omega, axis=1)  # it falls, so these are lower bounds:
    turns = float(np.sum(np.diff(times) * speed[1:])) / (2 * np.pi)
    # Capture is at ω₃ = ω⊥²/(2δ), where precession and braking are equally fast.
    free = 2 * delta * np.abs(omega[:, 2]) > np.sum(omega[:, :2] ** 2, axis=1)
    claim = f"Ω → Ω∞ after any number of revolutions: not near it after {turns:.0f} (δ = {delta})"
    printed = "after few revolutions, say ten"
    return Entry("section 4.2, 1", claim, share([~free]), 0.0, printed, turns / 10 - 1)


def exceptions() -> Iterator[Entry]:
    """Yield wobbling stops of needles, which occur in the full equation but not at order 1."""
    residual = abs(planar.critical_delta() / 0.7532357993909 - 1)
    claim = "at small amplitude also a wobbling stop, for δ > δ_c = 0.7532357993909"
    needle, start = 0.9, jnp.array([0.02, 0.1, 0.0])
    semi = classify(TransverseSemi(needle), start, value=False)
    stops = int(semi.stop) == Stop.WOBBLING
    printed = "always residual for δ > 0"
    yield Entry("section 4.2, 1", claim, residual, 1e-12, printed, float(stops))
    first = classify(TransverseReduced(needle), start, value=False)
    wrong = share([not stops, int(first.outcome) != Outcome.RESIDUAL])
    claim = "a needle (δ = 0.9) that stops wobbling, where order 1 keeps it"
    yield Entry("section 4.2, 1", claim, wrong, 0.0, "residual", float(stops))
    start = cylindrical(0.05, 0.5 * 0.05**2, np.pi / 2 + 0.7)
    full = classify(TransverseFull(0.85), start)
    stops = int(full.stop) == Stop.WOBBLING
    claim = "the same (δ = 0.85) by the full equation, on its physical branch"
    yield Entry("section 4.2, 1", claim, float(not stops), 0.0, "residual", float(stops))


TILTED = Body(np.diag((0.6, 1.0, 1.2)), (0.5, 0.6, 0.62))
"""A body whose dipole is on no principal axis."""


def asymmetric() -> Iterator[Entry]:
    """Yield the closing statement about tops without symmetry."""
    cases = (((0.6, 1.0, 1.2), 2), ((0.6, 1.0, 1.2), 1), ((1.0, 1.3, 2.2), 0))
    bodies = [Body(np.diag(moments), np.eye(3)[axis]) for moments, axis in cases]
    kept, stop, stable = [], [], []
    omegas = Sample(STARTS, amplitude=0.1, seed=7).points(np.arange(STARTS))
    for body in (*bodies, TILTED):
        outcome = np.asarray(classify_many(Reduced(body), omegas, value=False).outcome)
        kept.append(outcome == Outcome.RESIDUAL)
        stop.append(outcome == Outcome.STOP)
        direction = np.asarray(equilibria(Reduced(body)).direction)
        exists = bool(np.all(np.isfinite(direction)))
        stable.append(exists and bool(spectrum(Reduced(body), 0.1 * direction).stable))
    claim = "J = (0.6, 1, 1.2), dipole about the largest: stable, and residual"
    wrong = share([~kept[0], not stable[0]])
    yield Entry("closing statement", claim, wrong, 0.0)
    for name, i in (("the middle", 1), ("no principal axis", 3)):
        claim = f"J = (0.6, 1, 1.2), dipole about {name}: not stable, and stop"
        yield Entry("closing statement", claim, share([~stop[i]]) + stable[i], 0.01)
    kept_share = float(np.mean(kept[2]))
    dipole = "J = (1, 1.3, 2.2), dipole about the smallest"
    claim = f"{dipole}: stable, residual in a basin, {kept_share:.0%}"
    wrong = share([not stable[2], not kept[2].any(), not stop[2].any()])
    yield Entry("closing statement", claim, wrong, 0.0, "stable, so residual", 1 - kept_share)


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
