"""Figures, outcomes and numbers: what the paper says of motions, bodies and particles."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from .. import exact, particles, planar
from .._types import Outcome, Stop
from ..bodies import Body
from ..equations.rigid import Reduced
from ..equations.transverse import TransverseFull, TransverseReduced, TransverseSemi, cylindrical
from ..grids import Sample
from ..outcomes import classify, classify_many
from ..simulate import simulate
from ..validation import RESIDUAL_ROTATION, figure_2
from ._entry import Entry

SHAPES = (-1.0, -0.7, -0.5, -0.4, -0.2, -0.05, 0.0, 0.3, 0.6)
EACH = 256  # starts


def figures() -> Iterator[Entry]:
    """Figures 1 and 2."""
    shares = outcome_shares()
    wrong = max(
        max(shares[d] for d in SHAPES[:3]),  # keep rotating, though they should stop
        1 - min(shares[d] for d in SHAPES[6:]),
        max(0.0 if 0 < shares[d] < 1 else 1.0 for d in SHAPES[3:6]),
    )
    claim = "order 1: stop for δ ≤ −1/2, both for −1/2 < δ < 0, residual for δ ≥ 0"
    yield Entry("figure 1", claim, wrong, 0.0)
    for part, checks in zip(
        "ab", np.array_split(np.array(figure_2(), dtype=object), [3]), strict=True
    ):
        error = max(abs(check[2] - check[1]) / check[3] for check in checks)
        yield Entry(f"figure 2{part}", "ω(τ) at order 1 to ten digits", float(error), 1e-9)
    start = cylindrical(0.2, 0.2, np.pi / 30)
    found = float(classify(TransverseReduced(-0.2), start, rtol=1e-11).omega_inf)
    claim = f"ω∞ = {found:.10f} at order 1"
    yield Entry("figure 2a", claim, abs(found / RESIDUAL_ROTATION - 1), 1e-9)
    true = float(classify(TransverseFull(-0.2), start).omega_inf)
    claim = f"ω∞ = {true:.4f} by the full equation"
    yield Entry("figure 2a", claim, abs(true / 0.1193 - 1), 5e-4, "0.0989", abs(found / true - 1))
    run = simulate(TransverseFull(-0.2), start, np.array([0.0, 60.0, 12_000.0]), balance=True)
    error = float(jnp.max(jnp.abs(run.balance_defect)))
    claim = "the full equation followed over 1000 T: energy balance"
    yield Entry("figure 2a", claim, error, 1e-8)


def outcome_shares() -> dict[float, float]:
    """Share of isotropic starts that keep rotating, at order 1, by shape."""
    starts = Sample(len(SHAPES) * EACH, amplitude=0.2, seed=6)
    omegas = starts.points(np.arange(len(SHAPES) * EACH))
    deltas = jnp.repeat(jnp.array(SHAPES), EACH)
    found = classify_many(TransverseReduced(deltas), omegas, value=False)
    kept = (np.asarray(found.outcome) == Outcome.RESIDUAL).reshape(-1, EACH)
    return dict(zip(SHAPES, kept.mean(axis=1).tolist(), strict=True))


def exceptions() -> Iterator[Entry]:
    """Section 4.2: what holds almost everywhere, and what needs a wobble."""
    sphere = classify(TransverseReduced(0.0), jnp.array([0.0, 0.2, 0.1]))
    wrong = float(int(sphere.outcome) != Outcome.STOP)
    claim = "δ ≥ 0 keeps rotating almost everywhere: not at δ = 0, ω₁ = 0"
    yield Entry("section 4.2, 1", claim, wrong, 0.0, "everywhere")
    residual = abs(planar.critical_delta() / 0.7532357993909 - 1)
    claim = "full: a wobbling stop besides, for δ > 0.7532357993909"
    yield Entry("section 4.2, 1", claim, residual, 1e-12, "always residual for δ > 0")
    needle = classify(TransverseSemi(0.9), jnp.array([0.02, 0.1, 0.0]), value=False)
    first = classify(TransverseReduced(0.9), jnp.array([0.02, 0.1, 0.0]), value=False)
    wrong = float(int(needle.outcome) != Outcome.STOP or int(first.outcome) != Outcome.RESIDUAL)
    claim = "a needle (δ = 0.9) that stops wobbling, where order 1 keeps it"
    yield Entry("section 4.2, 1", claim, wrong, 0.0, "residual")
    beside = cylindrical(0.05, 0.5 * 0.05**2, np.pi / 2 + 0.7)
    full = classify(TransverseFull(0.85), beside)
    claim = "the same (δ = 0.85) by the full equation, on its physical branch"
    yield Entry("section 4.2, 1", claim, float(int(full.stop) != Stop.WOBBLING), 0.0, "residual")


FAMILIES = (
    ("largest", (0.6, 1.0, 1.2), 2, (1.0, 1.0)),
    ("middle", (0.6, 1.0, 1.2), 1, (0.0, 0.0)),
    ("smallest", (1.0, 1.3, 2.2), 0, (0.05, 0.95)),
)
"""Which moment the dipole's axis has, the moments, that axis, the residual share allowed."""


def asymmetric() -> Iterator[Entry]:
    """The closing statement, on tops without symmetry."""
    for name, moments, axis, (low, high) in FAMILIES:
        body = Body(np.diag(moments), np.eye(3)[axis])
        omegas = Sample(EACH, amplitude=0.1, seed=7).points(np.arange(EACH))
        found = np.asarray(classify_many(Reduced(body), omegas, value=False).outcome)
        share = float(np.mean(found == Outcome.RESIDUAL))
        decided = float(np.mean(found > 0))
        wrong = 0.0 if low <= share <= high and decided > 0.9 else 1.0
        ends = "residual for all" if low == 1 else "stop" if high == 0 else "both ends"
        claim = f"J = {moments}, dipole about the {name}: {ends} ({share:.0%} keep rotating)"
        correction = "" if low == 1 else "residual for all"
        yield Entry("closing statement", claim, wrong, 0.0, correction)


PARTICLES = (
    (1.0e-18, 1.000e-33, 2401.6, 1.4271e-35, 1.775e15),
    (6.4e-19, 6.667e-34, 2.8e7, 2.9097e-27, 8.705e6),
    (6.4e-19, 1.0667e-33, 2.8e7, 1.8186e-27, 1.393e7),
    (4.32e-19, 3.2724e-33, 4000.0, 1.2098e-35, 2.094e15),
    (3.80e-22, 9.507e-40, 100.0, 2.603e-32, 9.73e11),
    (3.15e-22, 7.887e-40, 100.0, 3.137e-32, 8.07e11),
)
"""Mass, moment, dipole in debye, τ₀, T of the conclusions, recomputed, in SI units."""


def conclusions() -> Iterator[Entry]:
    """The particles of the conclusions, and how long a stop takes."""
    after = exact.rotator(1.0, jnp.array([1.0, 5e3]))  # in units of T, where ω₀ = 1
    wrong = 0.0 if after[0] > 0.5 and after[1] < 0.011 else 1.0
    claim = f"rotation ceases at t ≫ T: ω/ω₀ = {after[0]:.2f} at T, {after[1]:.2f} at 5000 T"
    yield Entry("conclusions", claim, wrong, 0.0, "another condition on t")
    for row, expected in zip(
        particles.particle_table(particles.paper_particles()), PARTICLES, strict=True
    ):
        found = (row.mass, row.moment, row.debye, row.tau0, row.braking_time)
        error = max(abs(x / y - 1) for x, y in zip(found, expected, strict=True))
        claim = f"{row.name}: τ₀ = {row.tau0:.3g} s, T = {row.braking_time:.3g} s"
        yield Entry("conclusions", claim, float(error), 2e-3)
