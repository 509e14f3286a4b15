"""Sections 4 and 4.1: equations for a dipole across the symmetry axis, and their fixed points."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from .. import exact
from .._branch.slow_manifold import slow_manifold
from ..bodies import axisymmetric
from ..equations.rigid import Full, Reduced
from ..equations.transverse import TransverseFull, TransverseReduced, TransverseSemi
from ..equations.transverse_approximations import (
    TransverseAveraged,
    TransverseCylindrical,
    TransverseLinearised,
)
from ..stability import spectrum, threshold
from .ledger_entry import LANES, Entry, gap, shapes, share, states, unsolved

TIMES = np.array([0.0, 0.3, 5.0, 400.0])


def equations() -> Iterator[Entry]:
    """Yield (4.2)–(4.15)."""
    deltas, omega, rates = shapes(), states(3), states(2, 2)
    bodies = jax.vmap(axisymmetric, out_axes=-1)(deltas)
    special = TransverseFull(deltas)(0.0, jnp.concatenate([omega, rates]))
    whole = jnp.concatenate([omega, jnp.zeros((1, LANES)), rates])
    expected = Full(bodies)(0.0, whole)[jnp.array([0, 1, 2, 4, 5])]
    claim = "the full equation (3.3) of such a top, closed"
    yield Entry("section 4", claim, gap(special, expected), 1e-12)
    first, general = TransverseReduced(deltas), Reduced(bodies)(0.0, omega)
    residual = gap(first(0.0, omega), general)
    yield Entry("(4.2)–(4.4)", "(3.4) of a top with a transverse dipole", residual, 1e-13)
    yield from exact_motions()
    cylindrical = TransverseCylindrical(deltas)
    y = jnp.stack([jnp.abs(omega[0]), omega[2], omega[1]])
    rate = jax.jvp(cylindrical.omega, (y,), (cylindrical(0.0, y),))[1]
    residual = gap(rate, Reduced(bodies)(0.0, cylindrical.omega(y)))
    yield Entry("(4.9)–(4.11)", "the same in ω⊥, ω₃, φ", residual, 1e-13)
    yield from monotony()
    angles = jnp.linspace(0, 2 * jnp.pi, 16, endpoint=False)
    y = jnp.stack([jnp.full(16, 0.7), jnp.full(16, -0.4), angles])
    mean = jnp.mean(TransverseCylindrical(-0.6)(0.0, y), axis=1)
    residual = gap(TransverseAveraged(-0.6)(0.0, y[:, 0]), mean)
    yield Entry("(4.13)–(4.15)", "their mean over φ", residual, 1e-14)


def exact_motions() -> Iterator[Entry]:
    """Yield (4.5), (4.6) and their exact solutions."""
    delta, axial, plane = 0.6, np.array([0.0, 0.0, 0.7]), np.array([0.03, 0.4, 0.0])
    solution = jax.jit(lambda t, start: exact.transverse(delta, start, t))
    equation, general = TransverseReduced(delta), Reduced(axisymmetric(delta))
    residual = unsolved(equation, lambda t: solution(t, axial), TIMES)
    claim = "ω⊥ = 0: ω₃ = ω₃₀/√(1 + 2ω₃₀²τ/(1−δ))"
    yield Entry("(4.5)", claim, residual, 1e-13)
    residual = unsolved(equation, lambda t: solution(t, plane), TIMES)
    yield Entry("(4.6)", "ω₃ = 0: ω₁ constant, ω₂ by a closed form", residual, 1e-13)
    flat = states(3, 9).at[2].set(0.0)
    law = -(flat[0] ** 2 + flat[1] ** 2) * flat[1]
    rate = general(0.0, flat)
    claim, printed = "(4.3) reduces to it, ω₂′ = −(ω₁² + ω₂²)ω₂", "(4.4) reduces to it"
    yield Entry("(4.6)", claim, gap(rate[1], law), 1e-13, printed, gap(rate[2], law))
    late = np.array([1e6, 4e6])  # times
    ends = [np.asarray(solution(late, np.array([w1, 0.4, 0.0])))[:, 1] for w1 in (3e-3, 0.0)]
    falls = [np.log(w[0] / w[1]) for w in ends]
    claim = "ω₂ ~ e^{−ω₁²τ} for ω₁ ≠ 0, ω₂ ~ (2τ)^{−1/2} for ω₁ = 0"
    residual = gap(np.array(falls) / np.array([27.0, np.log(2)]), np.ones(2))
    printed = gap(falls[1] / np.log(2), 3e6 * 9e-6 / np.log(2))
    yield Entry("after (4.6)", claim, residual, 1e-5, "exponential for every ω₁", printed)


def monotony() -> Iterator[Entry]:
    """Yield the claims about monotonicity after (4.12)."""
    deltas, omega = shapes(), states(3, 11)
    bodies = jax.vmap(axisymmetric, out_axes=-1)(deltas)
    rate = Reduced(bodies)(0.0, omega)
    grows = omega[0] * rate[0] + omega[1] * rate[1] > 0
    yield Entry("after (4.12)", "ω⊥ falls monotonically for every δ", share([grows]), 0.0)
    phi = jnp.linspace(0, jnp.pi, 181)

    def growth(delta: float) -> float:
        """Return the largest ω₃′/(ω₃ω²) at small ω₃."""
        y = jnp.stack([jnp.ones_like(phi), jnp.full_like(phi, 1e-6), phi])
        return float(jnp.max(TransverseCylindrical(delta)(0.0, y)[1]) / 1e-6)

    rises = max(max(growth(d), 0.0) for d in (-0.5, -0.3, 0.0, 0.7))
    claim = "|ω₃| falls monotonically for δ ≥ −1/2"
    yield Entry("after (4.12)", claim, rises, 1e-9, "for every δ", growth(-0.9))


def linearised() -> Entry:
    """Check (4.22)–(4.24)."""
    small, w = jnp.array([0.02, -0.03, 0.05]), 0.3
    jacobian = jax.jacfwd(lambda y: TransverseCylindrical(-0.6)(0.0, y))(jnp.array([w, 0.0, 0.0]))
    linear = TransverseLinearised(-0.6, w)(0.0, small)
    claim, printed = "linearisation of (4.9)–(4.11) at (w, 0, 0)", "linearisation of (4.5)–(4.9)"
    only = jacobian.at[1:].set(0.0) @ small  # among (4.5)–(4.9) only (4.9) is a rate, ω⊥′
    residual = gap(linear, jacobian @ small)
    return Entry("before (4.22)", claim, residual, 1e-13, printed, gap(only, linear))


def fixed_points() -> Iterator[Entry]:
    """Yield the fixed points at order 1, and the rates near them, (4.22)–(4.24)."""
    yield linearised()
    claim = "(4.2)–(4.4) have no other fixed points than ω₂ = ω₃ = 0"
    yield Entry("section 4.1", claim, elsewhere(), 0.0)
    w, d = 0.01, -0.3
    state = jnp.array([w, 0.0, 0.0])
    rates = {
        delta: np.sort(np.real(spectrum(TransverseReduced(delta), state).slow))[::-1] / w**2
        for delta in (-1.0, -0.7, -0.5, d, 0.0, 0.4)
    }
    residual = max(
        gap(scaled, np.sort([0.0, -1.0, -(1 + 2 * delta) / (1 - delta)])[::-1])
        for delta, scaled in rates.items()
    )
    claim = "rates 0, −w², −(1+2δ)/(1−δ) w² near (w, 0, 0), at order 1"
    yield Entry("section 4.1", claim, residual, 1e-12)
    claim = "unstable for δ < −1/2; at δ = −1/2 the linear approximation says nothing"
    unstable = {delta: np.sum(scaled > 1e-9) > 0 for delta, scaled in rates.items()}
    wrong = share([unstable[delta] != (delta < -0.5) for delta in rates])
    printed = share([unstable[delta] != (delta <= -0.5) for delta in rates])
    yield Entry("section 4.1", claim, wrong, 0.0, "unstable for δ ≤ −1/2", printed)
    yield slowest(state)
    yield no_threshold(state)
    yield lost_term(d)


def elsewhere() -> float:
    """Return the share of fixed points found from random guesses that are off ω₂ = ω₃ = 0."""
    field = jax.jit(lambda delta, omega: TransverseReduced(delta)(0.0, omega))
    draw, distances = np.random.default_rng(12), []

    def polar(x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return |ω| between 0.1 and 3, and the direction of ω."""
        return 3 * 30 ** ((np.sin(x[0]) - 1) / 2), x[1:] / np.linalg.norm(x[1:])

    def scaled_field(x: np.ndarray, delta: float) -> np.ndarray:
        r, n = polar(x)
        return np.append(np.asarray(field(delta, r * n)) / r**3, np.sum(x[1:] ** 2) - 1)

    for delta in (-1.0, -0.7, -0.5, -0.2, 0.0, 0.3, 0.8):
        for _ in range(12):
            guess = draw.normal(size=4)
            root = least_squares(scaled_field, guess, args=(delta,), xtol=1e-15, ftol=1e-15)
            if np.max(np.abs(root.fun)) < 1e-9:
                distances.append(np.hypot(*polar(root.x)[1][1:]))
    # At δ = −1/2 the field falls as the cube of the distance, so that 1e-9 may be 1e-3 away.
    return float(np.mean(np.array(distances) > 0.03)) if distances else np.inf


def slowest(state: jnp.ndarray) -> Entry:
    """Check the rate at which the residual rotation (w, 0, 0) is approached."""
    deltas, square = (-0.3, 0.4), float(state[0]) ** 2
    rates = np.array([1 / float(spectrum(TransverseReduced(d), state).return_time) for d in deltas])
    axial = np.array([3 / (1 - d) - 2 for d in deltas])
    claim = "1/T = τ₀Ω∞² min(1, 3I₁/I₃ − 2), the slowest rate"
    residual = gap(rates, square * np.minimum(1, axial))
    printed = "1/T = (3I₁/I₃ − 2)τ₀Ω∞²"
    return Entry("section 4.2, 1", claim, residual, 1e-12, printed, gap(square * axial, rates))


def no_threshold(state: jnp.ndarray) -> Entry:
    """Check for which shapes residual rotation is stable, at order 1 and at consistent levels."""
    delta = threshold(TransverseReduced, float(state[0]), -0.9, 0.5)
    consistent = np.linspace(-0.99, 0.95, 9)
    stable = np.array(
        [
            [bool(spectrum(level(float(d)), state).stable) for d in consistent]
            for level in (TransverseSemi, TransverseFull)
        ]
    )
    residual = abs(delta + 0.5) + share([~stable])
    claim = "the threshold I₃ = 3/2 I₁ is order 1's: by the full equation all are stable"
    printed = share([stable[:, consistent < -0.5]])
    return Entry("section 4.2", claim, residual, 1e-12, "I₃ > 3/2 I₁ is unstable", printed)


def lost_term(delta: float) -> Entry:
    """Check that order 1 misses −2ω₁ω₂ω²/(1−δ) in ω₃′, of leading order where ω₃ ~ ω⊥²."""
    u = 1e-2
    omega = jnp.array([u, 0.3 * u, 0.5 * u**2])
    rate = slow_manifold(TransverseFull(delta), omega)[2]
    first = TransverseReduced(delta)(0.0, omega)[2]
    lost = -2 * omega[0] * omega[1] * jnp.sum(omega**2) / (1 - delta)
    claim = "where ω₃ ~ ω⊥², (3.3) has another term of leading order in ω₃′, −2ω₁ω₂ω²/(1−δ)"
    residual, printed = (abs(float(x / rate) - 1) for x in (first + lost, first))
    return Entry("(4.4)", claim, residual, 1e-2, "ω₃′ without that term", printed)
