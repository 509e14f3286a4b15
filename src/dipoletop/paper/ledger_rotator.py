"""Appendix A and figure 3: the full equation of the plane rotator."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np

from .. import exact
from .._base.types import Outcome
from .._runs.classify import classify
from ..bodies import axisymmetric
from ..equations.rigid import Full
from ..equations.rotator import RotatorFull, RotatorReduced
from ..equations.rotator_curves import closed_manifold, critical_manifold, separatrix
from .ledger_entry import LANES, Entry, gap, states

LOGARITHM = 3 / 4
"""Coefficient c in ω√(2τ) = 1 + c ln τ/τ + O(1/τ) for τ → ∞."""
ROOT = np.sqrt(2)


def phase_plane() -> Iterator[Entry]:
    """Yield (A.2), (A.7)–(A.15) and figure 3."""
    full, y = RotatorFull(), states(2, 6)
    zero = jnp.zeros_like(y[0])
    whole = jnp.stack([zero, zero, y[0], zero, zero, y[1]])
    rate = Full(axisymmetric(0.0))(0.0, whole)[jnp.array([2, 5])]
    residual = gap(y[1] * rate[1] / rate[0], y[1] + y[0] ** 3)
    yield Entry("(A.2)", "ϖ dϖ/dω = ϖ + ω³, ϖ = ω′, along every motion", residual, 1e-12)
    rate = jax.jvp(full.lyapunov, (y,), (full(0.0, y),))[1]
    claim = "V = ω(ϖ − ω/2) grows: V′ = ϖ² + ω⁴"
    yield Entry("(A.7)–(A.12)", claim, gap(rate, y[1] ** 2 + y[0] ** 4), 1e-13)
    fast = jnp.array(1e8)
    ends = np.array([separatrix(fast), critical_manifold(fast)]) / fast**2
    claim = "ϖ → ±ω²/√2 for ω → ∞ (+ on BOD, − on AOC)"
    residual = gap(ends, np.array([1, -1]) / ROOT)
    yield Entry("(A.7)–(A.12)", claim, residual, 1e-7)
    yield ends_of_time()
    corners = jnp.array([[0.5, 0.5, -0.5, -0.5, 0.5, -0.5], [-1.0, 0.1, 1.0, -0.1, 1.0, -1.0]])
    domain = full.domain(corners)
    expected = np.array([[1, 1, -1, -1, -1, 1], [-1, 1, 1, -1, 1, -1]])
    residual = gap(np.stack([domain.past, domain.future]), expected)
    yield Entry("figure 3", "AOC and BOD part four domains of runaways", residual, 0.0)


def ends_of_time() -> Entry:
    """Check (A.11): τ̄ω at a large ω > 0, near the end of a runaway and the beginning of a stop."""
    fast = 1e4
    before, after = _since(separatrix, fast), _since(critical_manifold, fast)
    products = np.array([before, after]) * fast
    claim = "ω ~ √2/τ̄: ω → ∞ for τ̄ → 0+, but −∞ for τ̄ → 0−, and the reverse"
    residual = gap(products, np.array([-ROOT, ROOT]))
    printed = "ω → ∞ at either end of time, and the reverse"
    return Entry("(A.11)", claim, residual, 1e-3, printed, gap(products, np.array([ROOT, ROOT])))


def _since(curve: Callable, w: float) -> float:
    """Return τ̄ = ∫dω/ϖ from ∞ to w, by x = 1/ω: the time since the blow-up, negative before it."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    x = (nodes + 1) / (2 * w)
    rate = np.asarray(curve(jnp.asarray(1 / x)))
    return float(np.sum(weights / (x**2 * -rate))) / (2 * w)


def manifold() -> Iterator[Entry]:
    """Yield (A.15)–(A.17): the curves AOC and BOD, and their approximations."""
    w = jnp.logspace(-5, 5, LANES)
    ones = jnp.ones(LANES)
    f, slope = jax.jvp(critical_manifold, (w,), (ones,))
    residual = float(jnp.max(jnp.abs(f * slope - f - w**3) / w**3))
    yield Entry("(A.15), AOC", "f f′ = f + ω³, f ~ −ω³ at 0", residual, 1e-14)
    small = jnp.array([1e-3, 3e-3])
    series = -(small**3) + 3 * small**5 - 24 * small**7
    residual = float(jnp.max(jnp.abs(critical_manifold(small) / series - 1)))
    yield Entry("(A.16)", "f = −ω³ + 3ω⁵ − 24ω⁷ + …", residual, 1e-12)
    large = jnp.array([1e3, 2e3])
    rest = critical_manifold(large) + large**2 / ROOT - large / 3
    residual = gap(2 * rest[1] - rest[0], -ROOT / 9)  # the remainder falls like 1/ω
    yield Entry("appendix A", "f = −ω²/√2 + ω/3 − √2/9 + O(1/ω) at infinity", residual, 1e-5)
    g, rise = jax.jvp(separatrix, (w,), (ones,))
    residual = float(jnp.max(jnp.abs(g * rise - g - w**3) / (g + w**3)))
    yield Entry("BOD", "g g′ = g + ω³, g ~ ω at 0", residual, 1e-14)
    yield from approximations(w)


def approximations(w: jnp.ndarray) -> Iterator[Entry]:
    """Yield the two closed forms with which the paper approximates f."""
    ends = jnp.array([1e-4, 1e8])
    residual = gap(closed_manifold(ends) / critical_manifold(ends), jnp.ones(2))
    claim = "f ≈ −ω³/√(1+2ω²): right for ω → 0 and for ω → ∞"
    yield Entry("(A.17)", claim, residual, 1e-7)
    inverse_rate = jax.vmap(jax.grad(exact.rotator_closed_time))(w)
    claim = "−ω³/√(1+2ω²) integrates to √(1+2ω²)/(2ω²) + arsinh(1/(√2 ω))"
    residual = gap(inverse_rate * closed_manifold(w), jnp.ones_like(w))
    yield Entry("appendix A", claim, residual, 1e-13)
    error = float(closed_manifold(1.0) / critical_manifold(1.0)) - 1
    claim = "error of that approximation at ω = 1: 22 % (not in the paper)"
    yield Entry("appendix A", claim, abs(error - 0.22), 0.005)
    small = jnp.linspace(0.1, 1.0, LANES)
    rate, second = jax.jvp(lambda x: -(x**3), (small,), (-(small**3),))  # ω′ and ω″ along ω′ = −ω³
    residual = gap(rate, RotatorReduced()(0.0, small[None])[0])
    missing = second - RotatorFull()(0.0, jnp.stack([small, rate]))[1]
    claim, printed = "f ≈ −ω³ is the reduced equation (2.3)", "the reduced equation (2.2)"
    yield Entry("end of appendix A", claim, residual, 1e-15, printed, gap(rate + missing, rate))


def asymptotics() -> Iterator[Entry]:
    """Yield (A.3)–(A.6)."""
    measured = logarithm(critical_manifold)
    claim = "ω = (2τ)^(−1/2) [1 + c ln τ/τ + O(1/τ)], c = 3/4"
    residual = abs(measured / LOGARITHM - 1)
    yield Entry("(A.3)–(A.4)", claim, residual, 1e-3, "[1 + O(1/τ)], c = 0", abs(measured))
    fast = 1e4
    run = classify(RotatorFull(), jnp.array([fast, float(separatrix(fast))]))
    failed = int(run.outcome) == Outcome.FAILED
    residual = abs(float(run.time) * fast / ROOT - 1) if failed else np.inf
    yield Entry("(A.5)", "|ω| ~ √2/|τ| near a blow-up", residual, 1e-3)
    small = jnp.array([1e-6, 1e-4])
    residual = gap(separatrix(small) / small, jnp.ones(2))
    yield Entry("(A.6)", "ω ~ A e^τ at −∞, on BOD", residual, 1e-8)


def logarithm(branch: Callable, start: float = 0.1) -> float:
    """Return c in ω√(2τ) = 1 + c ln τ/τ + O(1/τ), for ω′ = branch(ω) with ω₀ = `start`."""
    late = []
    for w in (1e-4, 1e-6):
        nodes, weights = np.polynomial.legendre.leggauss(100)
        low, high = np.log(w), np.log(start)
        s = low + (high - low) * (nodes + 1) / 2
        rate = np.asarray(branch(jnp.exp(jnp.asarray(s))))
        tau = float((high - low) / 2 * np.sum(weights * -np.exp(s) / rate))  # τ = −∫dω/ϖ
        late.append((tau * (w * np.sqrt(2 * tau) - 1), np.log(tau)))
    (early_value, early_log), (late_value, late_log) = late
    return float((late_value - early_value) / (late_log - early_log))
