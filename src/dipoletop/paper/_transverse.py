"""Section 4: the dipole across the symmetry axis, as equations."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from .. import exact
from ..bodies import axisymmetric
from ..equations.rigid import Full, Reduced
from ..equations.transverse import (
    TransverseAveraged,
    TransverseCylindrical,
    TransverseFull,
    TransverseLinearised,
    TransverseReduced,
    TransverseSemi,
    cylindrical,
)
from ..manifold import slow_manifold
from ..stability import spectrum, threshold
from ._entry import LANES, Entry, gap, shapes, states, unsolved

TIMES = np.array([0.0, 0.3, 5.0, 400.0])


def equations() -> Iterator[Entry]:
    """(4.2)–(4.15) and (4.22)–(4.24)."""
    deltas, omega = shapes(), states(3)
    bodies = jax.vmap(axisymmetric, out_axes=-1)(deltas)
    first = TransverseReduced(deltas)
    residual = gap(first(0.0, omega), Reduced(bodies)(0.0, omega))
    yield Entry("(4.2)–(4.4)", "(3.4) of a top with a transverse dipole", residual, 1e-13)
    for name, delta, start in (
        ("(4.5)", -0.3, (0.03, 0.4, 0.0)),
        ("(4.6)", 0.6, (0.0, 0.0, 0.7)),
    ):
        solution = jax.jit(lambda t, d=delta, start=start: exact.transverse(d, np.array(start), t))
        residual = unsolved(TransverseReduced(delta), solution, TIMES)
        plane = "ω₃ = 0: ω₁ constant" if name == "(4.5)" else "ω⊥ = 0: a power law of τ"
        yield Entry(name, f"exact solution for {plane}", residual, 1e-13)
    round_ = TransverseCylindrical(deltas)
    y = jnp.stack([jnp.abs(omega[0]), omega[2], omega[1]])
    found = jax.jvp(round_.omega, (y,), (round_(0.0, y),))[1]
    residual = gap(found, first(0.0, round_.omega(y)))
    yield Entry("(4.9)–(4.11)", "the same in ω⊥, ω₃, φ", residual, 1e-13)
    yield from monotony()
    angles = jnp.linspace(0, 2 * jnp.pi, 16, endpoint=False)
    y = jnp.stack([jnp.full(16, 0.7), jnp.full(16, -0.4), angles])
    mean = jnp.mean(TransverseCylindrical(-0.6)(0.0, y), axis=1)
    residual = gap(TransverseAveraged(-0.6)(0.0, y[:, 0]), mean)
    yield Entry("(4.13)–(4.15)", "their mean over φ", residual, 1e-14)
    small, w = jnp.array([0.02, -0.03, 0.05]), 0.3
    jacobian = jax.jacfwd(lambda y: TransverseCylindrical(-0.6)(0.0, y))(jnp.array([w, 0.0, 0.0]))
    residual = gap(TransverseLinearised(-0.6, w)(0.0, small), jacobian @ small)
    claim = "linearisation of (4.9)–(4.11) at (w, 0, 0)"
    yield Entry("(4.22)–(4.24)", claim, residual, 1e-13, "names other equations")


def monotony() -> Iterator[Entry]:
    """What stands after (4.12)."""
    phi = jnp.linspace(0, jnp.pi, 181)

    def growth(delta: float) -> float:
        """Largest ω₃′/ω₃, over ω², where ω₃ is small."""
        y = jnp.stack([jnp.ones_like(phi), jnp.full_like(phi, 1e-6), phi])
        return float(jnp.max(TransverseCylindrical(delta)(0.0, y)[1]) / 1e-6)

    rises = max(max(growth(d), 0.0) for d in (-0.5, -0.3, 0.0, 0.7))
    claim = "|ω₃| falls monotonically for δ ≥ −1/2"
    yield Entry("after (4.12)", claim, rises, 1e-9, "for every δ", growth(-0.9))


def averaged() -> Iterator[Entry]:
    """(4.16)–(4.21)."""
    solution = jax.jit(exact.averaged)
    start = cylindrical(0.8, -0.6, 0.3)
    times = jnp.asarray(TIMES)
    residual = 0.0
    for delta in (-1.0, -0.7, -0.5, -0.2, 0.0, 0.6):
        equation = TransverseAveraged(delta)
        value, rate = jax.jvp(lambda t, d=delta: solution(d, start, t), (times,), (0 * times + 1,))
        y = equation.lift(value.T)
        expected = jax.jvp(equation.omega, (y,), (equation(0.0, y),))[1]
        residual = max(residual, gap(rate.T, expected))
    claim = "v = Cξ^{−q}|aξ+b|^p, τ = ((1−δ)/C)∫ξ^{q−1}|aξ+b|^{−p−1}dξ, and φ̄"
    wrong = "(4.17) another exponent, and τ₀ for the initial time"
    yield Entry("(4.16)–(4.18)", claim, residual, 1e-11, wrong)
    d = -0.2
    a, b, p = 1 + 2 * d, 1 + d**3, d * (1 - d) * (3 + 3 * d + d**2)
    xi = np.array([0.3, 2.0, 40.0])
    slope = (-2 / b) / xi + p / b / (a * xi + b)  # of ln v, by the closed form
    residual = gap(slope, -((2 + d) * xi + 2) / (xi * (a * xi + b)))
    claim = "p = δ(1−δ)(3+3δ+δ²)/[(1+2δ)(1+δ³)], a = 1+2δ, b = 1+δ³"
    yield Entry("(4.19)", claim, residual, 1e-13, "another p")
    for place, claim, correction, delta, limit in (
        ("(4.20)", "u, v ~ 1/τ for −1 < δ < −1/2", "", -0.8, 1e-6),
        ("(4.20)", "δ = −1: u ~ 2/(τ ln τ), v ~ 1/τ", "no logarithm", -1.0, 0.02),
        ("(4.20)", "δ = −1/2: v ~ (12/7)/(τ ln τ), u ~ 1/τ", "no logarithm", -0.5, 0.02),
        ("(4.21)", "u ~ 1/τ, v ~ τ^{−(2+δ)/(1−δ)} for −1/2 < δ < 1", "", 0.3, 1e-6),
    ):
        late = jnp.array([1e100])
        w = solution(delta, start, late)[0]
        u, v = exact.averaged_late(delta, start, late)
        residual = max(
            abs(float((w[0] ** 2 + w[1] ** 2) / u[0]) - 1), abs(float(w[2] ** 2 / v[0]) - 1)
        )
        yield Entry(place, f"{claim} (τ = 1e100)", residual, limit, correction)


def residual_line() -> Iterator[Entry]:
    """The eigenvalues at {w, 0, 0}, and what order 1 leaves out."""
    w, d = 0.01, -0.3
    state = jnp.array([w, 0.0, 0.0])
    found = np.sort(np.real(spectrum(TransverseReduced(d), state).slow)) / w**2
    expected = np.sort([0.0, -1.0, -(1 + 2 * d) / (1 - d)])
    claim = "eigenvalues 0, −w², −(1+2δ)/(1−δ) w² at order 1"
    yield Entry("section 4.2", claim, gap(found, expected), 1e-12)
    slowest = float(spectrum(TransverseReduced(d), state).return_time)
    claim = "the slowest rate is τ₀Ω² min(1, 3I₁/I₃ − 2)"
    residual = abs(slowest * w**2 * min(1, 3 / (1 - d) - 2) - 1)
    yield Entry("section 4.2", claim, residual, 1e-12, "the rate of ω₃ only")
    at = threshold(TransverseReduced, w, -0.9, 0.5)
    consistent = np.linspace(-0.99, 0.95, 9)
    growth = max(
        float(spectrum(level(float(d)), state).growth)
        for d in consistent
        for level in (TransverseSemi, TransverseFull)
    )
    residual = abs(at + 0.5) if growth < 0 else np.inf
    claim = "the threshold I₃ = 3/2 I₁ is order 1's; the full equation has none"
    yield Entry("section 4.2", claim, residual, 1e-12, "a threshold of the top")
    yield from lost_term(d)


def lost_term(delta: float) -> Iterator[Entry]:
    """Near the residual state, where ω₃ ~ ω⊥², order 1 misses −2ω₁ω₂ω²/(1−δ) of ω₃′."""
    u = 1e-2
    omega = jnp.array([u, 0.3 * u, 0.5 * u**2])
    rate = slow_manifold(TransverseFull(delta), omega)
    first = TransverseReduced(delta)(0.0, omega)
    lost = -2 * omega[0] * omega[1] * jnp.sum(omega**2) / (1 - delta)
    residual = abs(float((rate[2] - first[2]) / lost) - 1)
    claim = "ω₃′ has the term −2ω₁ω₂ω²/(1−δ), of leading order where ω₃ ~ ω⊥²"
    paper = abs(float((rate[2] - first[2]) / rate[2]))
    yield Entry("(4.4)", claim, residual, 1e-2, "without it", paper)


def full_equation() -> Iterator[Entry]:
    """The closed full equation of section 4."""
    deltas, omega, rates = shapes(), states(3), states(2, 2)
    bodies = jax.vmap(axisymmetric, out_axes=-1)(deltas)
    found = TransverseFull(deltas)(0.0, jnp.concatenate([omega, rates]))
    whole = jnp.concatenate([omega, jnp.zeros((1, LANES)), rates])
    expected = Full(bodies)(0.0, whole)[jnp.array([0, 1, 2, 4, 5])]
    yield Entry(
        "section 4", "the full equation (3.3) of such a top, closed", gap(found, expected), 1e-12
    )
