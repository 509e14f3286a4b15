"""Section 3.1 and appendix B: the dipole along the symmetry axis."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from .. import exact
from ..bodies import axisymmetric
from ..equations.longitudinal import LongitudinalFull, LongitudinalReduced
from ..equations.rigid import Full, Reduced
from ..equations.rotator import critical_manifold
from ..manifold import slow_manifold
from ._entry import LANES, Entry, gap, shapes, states, unsolved


def equations() -> Iterator[Entry]:
    """(3.6)–(3.13)."""
    deltas, omega, rates = shapes(), states(3), states(2, 2)
    bodies = jax.vmap(lambda d: axisymmetric(d, "longitudinal"), out_axes=-1)(deltas)
    found = LongitudinalFull(deltas)(0.0, jnp.concatenate([omega, rates]))
    whole = jnp.concatenate([omega, rates, jnp.zeros((1, LANES))])
    residual = gap(found, Full(bodies)(0.0, whole)[:5])
    yield Entry("(3.6)–(3.8), (B.1)–(B.3)", "full equations, ω₃ constant", residual, 1e-12)
    found = LongitudinalReduced(deltas)(0.0, omega)
    residual = gap(found, Reduced(bodies)(0.0, omega))
    claim = "ω⊥′ = −(ω⊥² + ζ²ω₃²)ω⊥, φ′ = −δω₃"
    yield Entry("(3.9)–(3.10)", claim, residual, 1e-12)
    times = np.array([0.0, 0.3, 5.0, 40.0])
    start = np.array([0.3, 0.4, 0.5])
    solution = jax.jit(lambda t: exact.longitudinal(-0.4, start, t))
    residual = unsolved(LongitudinalReduced(-0.4), solution, times)
    claim = "ω⊥ = s/√((1 + s²/u₀)e^{2s²τ} − 1), φ = φ₀ − δω₃τ"
    yield Entry("(3.11)–(3.12)", claim, residual, 1e-13)
    limits = (
        exact.longitudinal(0.3, np.array([0.5, 0.0, 0.0]), times)[:, 0],
        exact.longitudinal(1.0, np.array([0.5, 0.0, 0.9]), times),
    )
    rod = jnp.hypot(limits[1][:, 0], limits[1][:, 1])
    residual = gap(jnp.stack([limits[0], rod]), jnp.stack([exact.rotator(0.5, times)] * 2))
    yield Entry("(3.13)", "ω₃ → 0, and a rod: the rotator (2.4)", residual, 1e-14)


def asymptotics() -> Iterator[Entry]:
    """(B.5)–(B.13)."""
    delta, w3 = -0.4, 0.3
    s = 1.4 * w3
    below, above, turn = (float(x) for x in exact.longitudinal_exponents(delta, w3))
    found = max(abs((2 * a - 1) ** 2 * a * (a - 1) / s**2 - 1) for a in (below, above))
    yield Entry("(B.10)", "(2α − 1)²α(α − 1) = s²", found, 1e-13)
    at = jnp.array([0.0, 0.0, w3, 0.0, 0.0])
    jacobian = jax.jacfwd(lambda y: LongitudinalFull(delta)(0.0, y))(at)
    rates = np.linalg.eigvals(np.asarray(jacobian))
    found = np.min(np.abs(rates - complex(below, turn - w3))) / abs(complex(below, turn - w3))
    claim = "ω⊥ ~ e^{α₋τ}, φ′ → B − ω₃, B = s/(1 − 2α₋): spectrum of (3.6)–(3.8)"
    yield Entry("(B.10)–(B.11)", claim, float(found), 1e-13)
    small = exact.longitudinal_exponents(0.0, 0.01)
    series = (-(0.01**2) + 5 * 0.01**4 - 42 * 0.01**6, 0.01 - 2 * 0.01**3 + 14 * 0.01**5)
    found = max(abs(float(small[0]) / series[0] - 1), abs(float(small[2]) / series[1] - 1))
    yield Entry("(B.12)", "α₋ = −s² + 5s⁴ − 42s⁶ + …, B = s − 2s³ + 14s⁵ − …", found, 1e-9)
    plane = slow_manifold(LongitudinalFull(delta), jnp.array([0.3, 0.0, 0.0]))
    found = gap(plane[0], critical_manifold(0.3))
    claim = "ω₃ = 0: the branch is the rotator's, so ω⊥ decays by (A.4), with its logarithm"
    yield Entry("(B.5)", claim, found, 1e-13, "correction O(1/τ)")
    yield from on_the_branch(delta, w3, complex(below, turn - w3))
    yield from blow_up(delta, w3)


def on_the_branch(delta: float, w3: float, rate: complex) -> Iterator[Entry]:
    """(B.9): what the exponential decay neglects, on the physical branch."""

    def excess(w: float) -> complex:
        found = slow_manifold(LongitudinalFull(delta), jnp.array([w, 0.0, w3]))
        return (float(found[0]) + 1j * float(found[1])) / w - rate

    ratio = abs(excess(2e-3) / excess(1e-3))
    claim = "ω⊥ ~ e^{α₋τ}{1 + O(θ^{2α₋})}, θ = e^τ: next order ω⊥²"
    yield Entry("(B.9)", claim, abs(ratio / 4 - 1), 1e-3, "another power of θ")


def blow_up(delta: float, w3: float) -> Iterator[Entry]:
    """(B.5), (B.13): a runaway, integrated by another program until it is very fast."""
    field = jax.jit(lambda y: LongitudinalFull(delta)(0.0, y))
    fast = 1e5

    def reached(t: float, y: np.ndarray) -> float:
        return float(np.hypot(y[0], y[1])) - fast

    reached.terminal = True
    run = solve_ivp(
        lambda t, y: np.asarray(field(y)),
        (0.0, 60.0),
        [0.5, 0.0, w3, 0.6, 0.1],
        method="DOP853",
        events=reached,
        rtol=1e-12,
        atol=1e-12,
    )
    w, rate = run.y[0] + 1j * run.y[1], run.y[3] + 1j * run.y[4]
    decay = (rate / w).real[-1]  # ω⊥′/ω⊥ = 1/|τ|, τ < 0 before the blow-up
    found = abs(abs(w[-1]) / (np.sqrt(2) * decay) - 1)
    yield Entry("appendix B", "ω⊥ ~ √2/|τ| near a blow-up, but for O(τ)", float(found), 1e-4)
    here = np.argmin(np.abs(np.abs(w) - 1e3))
    tau = -np.sqrt(2) / abs(w[here])
    turn = (rate / w).imag[here] + w3
    claim = "φ − φ₀ = −ω₃τ + ½ζω₃τ² + O(τ³ ln τ) near a blow-up"
    found = abs(turn / ((1 - delta) * w3 * tau) - 1)
    yield Entry("(B.13)", claim, float(found), 0.02, "another second term")
