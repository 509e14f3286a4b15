"""Section 3.1 and appendix B: the dipole along the symmetry axis."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from .. import exact
from .._branch.slow_manifold import slow_manifold
from ..bodies import axisymmetric
from ..equations.longitudinal import LongitudinalFull, LongitudinalReduced
from ..equations.rigid import Full, Reduced
from .ledger_entry import LANES, Entry, gap, shapes, share, states, unsolved
from .ledger_rotator import LOGARITHM, ROOT, logarithm

DELTA, W3 = -0.4, 0.3  # values at which the asymptotics are checked: ζ = 1.4
START = np.array([0.5, 0.0, W3, 0.6, 0.1])  # initial state of a runaway; ω⊥ and ω⊥′ are of order 1


def equations() -> Iterator[Entry]:
    """Yield (3.6)–(3.13)."""
    deltas, omega, rates = shapes(), states(3), states(2, 2)
    bodies = jax.vmap(lambda d: axisymmetric(d, "longitudinal"), out_axes=-1)(deltas)
    special = LongitudinalFull(deltas)(0.0, jnp.concatenate([omega, rates]))
    whole = jnp.concatenate([omega, rates, jnp.zeros((1, LANES))])
    residual = gap(special, Full(bodies)(0.0, whole)[:5])
    yield Entry("(3.6)–(3.8), (B.1)–(B.3)", "full equations, ω₃ constant", residual, 1e-12)
    special, general = LongitudinalReduced(deltas)(0.0, omega), Reduced(bodies)(0.0, omega)
    claim = "ω⊥′ = −(ω⊥² + ζ²ω₃²)ω⊥, φ′ = −δω₃"
    yield Entry("(3.9)–(3.10)", claim, gap(special, general), 1e-12)
    times = np.array([0.0, 0.3, 5.0, 40.0])
    start = np.array([0.3, 0.4, 0.5])
    solution = jax.jit(lambda t: exact.longitudinal(DELTA, start, t))
    residual = unsolved(LongitudinalReduced(DELTA), solution, times)
    claim = "ω⊥ = s/√((1 + s²/u₀)e^{2s²τ} − 1), φ = φ₀ − δω₃τ, s = ζω₃"
    yield Entry("(3.11)–(3.12)", claim, residual, 1e-13)
    turning = (omega[0] * general[1] - omega[1] * general[0]) * omega[2] * -deltas < 0
    claim = "precession runs against ω₃ for a prolate top, with it for an oblate one"
    yield Entry("after (3.12)", claim, share([turning]), 0.0)
    limits = (
        exact.longitudinal(0.3, np.array([0.5, 0.0, 0.0]), times)[:, 0],
        exact.longitudinal(1.0, np.array([0.5, 0.0, 0.9]), times),
    )
    rod = jnp.hypot(limits[1][:, 0], limits[1][:, 1])
    residual = gap(jnp.stack([limits[0], rod]), jnp.stack([exact.rotator(0.5, times)] * 2))
    yield Entry("(3.13)", "ω₃ → 0, and a rod: the rotator (2.4)", residual, 1e-14)


def changed_variables() -> Iterator[Entry]:
    """Yield (B.4), (B.6)–(B.8): full equations for ω₃ = 0, and in θ = e^τ and ν = φ′ + ω₃."""
    deltas, omega, rates = shapes(), states(3, 7), states(2, 8)
    flat = omega.at[2].set(0.0)
    for axial, place in ((flat, "(B.4)"), (omega, "(B.6)–(B.8)")):
        y = jnp.concatenate([axial, rates])
        field = np.asarray(LongitudinalFull(deltas)(0.0, y))
        y, s = np.asarray(y), np.asarray((1 - deltas) * axial[2])
        w, rate, second = (x[0] + 1j * x[1] for x in (y, y[3:], field[3:]))
        # Derivatives at τ = 0 of z = w e^{iω₃τ}, whose phase grows at the rate ν.
        z1 = rate + 1j * y[2] * w
        z2 = second + 2j * y[2] * rate - y[2] ** 2 * w
        u, spin = np.abs(w) ** 2, np.imag(np.conj(w) * z1)  # ω⊥², ω⊥²ν
        radial = np.real(np.conj(w) * (z2 - z1)) + spin**2 / u  # ω⊥·θ²d²ω⊥/dθ²
        left = np.stack([radial, np.imag(np.conj(w) * z2)])
        right = np.stack([u**2 + spin**2 / u, spin - u * s])
        claim = "θ²ω⊥_θθ = (ω⊥² + ν²)ω⊥, θ(ω⊥²ν)_θ = ω⊥²(ν − ζω₃), θ = e^τ, ν = φ′ + ω₃"
        if place == "(B.4)":
            claim = "ω₃ = 0: ω⊥²φ′ ~ e^τ; at constant φ the rotator's ω⊥″ = ω⊥′ + ω⊥³"
        yield Entry(place, claim, gap(left, right), 1e-13)


def asymptotics() -> Iterator[Entry]:
    """Yield (B.5), (B.9)–(B.12), (B.14)."""
    field = LongitudinalFull(DELTA)
    measured = logarithm(jax.vmap(lambda w: slow_manifold(field, jnp.array([1.0, 0, 0]) * w)[0]))
    claim = f"ω₃ = 0: ω⊥ = (2τ)^(−1/2) [1 + c ln τ/τ + O(1/τ)], c = {LOGARITHM}"
    residual = abs(measured / LOGARITHM - 1)
    yield Entry("(B.5)", claim, residual, 1e-3, "[1 + O(1/τ)], c = 0", abs(measured))
    s = (1 - DELTA) * W3
    below, above, turn = (float(x) for x in exact.longitudinal_exponents(DELTA, W3))
    rate = complex(below, turn - W3)
    yield from next_order(rate)
    residual = max(abs((2 * a - 1) ** 2 * a * (a - 1) / s**2 - 1) for a in (below, above))
    yield Entry("(B.10)", "(2α − 1)²α(α − 1) = s², s = ζω₃", residual, 1e-13)
    residual = abs(spectrum(W3)[0] - rate) / abs(rate)
    claim = "ω⊥ ~ e^{α₋τ}, φ′ → B − ω₃, B = s/(1 − 2α₋): spectrum of (3.6)–(3.8)"
    yield Entry("(B.10)–(B.11)", claim, float(residual), 1e-13)
    small = exact.longitudinal_exponents(0.0, 0.01)
    series = (-(0.01**2) + 5 * 0.01**4 - 42 * 0.01**6, 0.01 - 2 * 0.01**3 + 14 * 0.01**5)
    residual = max(abs(float(small[0]) / series[0] - 1), abs(float(small[2]) / series[1] - 1))
    yield Entry("(B.12)", "α₋ = −s² + 5s⁴ − 42s⁶ + …, B = s − 2s³ + 14s⁵ − …", residual, 1e-9)
    yield from blow_up()
    slow = 1e-3
    turn = float(spectrum(slow)[1].imag)
    claim = "runaways from rotation about the dipole: φ′ = −(1+ζ)ω₃[1 + O(s²)]"
    yield Entry("(B.14)", claim, abs(turn / ((DELTA - 2) * slow) - 1), 1e-5)


def spectrum(w3: float) -> np.ndarray:
    """Return the two λ of ω₁ + iω₂ ~ e^{λτ} near (0, 0, ω₃) in the full equations; larger last."""
    equilibrium = jnp.array([0.0, 0.0, w3, 0.0, 0.0])
    jacobian = jax.jacfwd(lambda y: LongitudinalFull(DELTA)(0.0, y))(equilibrium)
    rates, vectors = np.linalg.eig(np.asarray(jacobian))
    right = np.abs(vectors[0] + 1j * vectors[1]) > np.abs(vectors[0] - 1j * vectors[1]) + 1e-6
    return np.sort_complex(rates[right])


def next_order(rate: complex) -> Iterator[Entry]:
    """Yield (B.9): the next order after the exponential decay, on the physical branch."""

    def excess(w: float) -> complex:
        slope = slow_manifold(LongitudinalFull(DELTA), jnp.array([w, 0.0, W3]))
        return (float(slope[0]) + 1j * float(slope[1])) / w - rate

    ratio = abs(excess(2e-3) / excess(1e-3))  # of ω⊥′/ω⊥ + iφ′, at twice the ω⊥
    claim = "ω⊥ = Aθ^{α₋}[1 + O(θ^{2α₋})], ν = B[1 + O(θ^{2α₋})]: next order ~ ω⊥²"
    printed = "next order O(1/θ), which is ~ ω⊥^{1/|α₋|}"
    wrong = abs(ratio / 2 ** (-1 / rate.real) - 1)
    yield Entry("(B.9)", claim, abs(ratio / 4 - 1), 1e-3, printed, wrong)


def blow_up() -> Iterator[Entry]:
    """Yield (B.13): a runaway, integrated with SciPy up to a large ω⊥."""
    field = jax.jit(lambda y: LongitudinalFull(DELTA)(0.0, y))
    fast = 1e5

    def reached(t: float, y: np.ndarray) -> float:
        return float(np.hypot(y[0], y[1])) - fast

    reached.terminal = True
    run = solve_ivp(
        lambda t, y: np.asarray(field(y)),
        (0.0, 60.0),
        START,
        method="DOP853",
        events=reached,
        rtol=1e-12,
        atol=1e-12,
        dense_output=True,
    )
    w, rate = run.y[0] + 1j * run.y[1], run.y[3] + 1j * run.y[4]
    decay = (rate / w).real[-1]  # ω⊥′/ω⊥ = 1/|τ|, τ < 0 before the blow-up
    residual = abs(abs(w[-1]) / (ROOT * decay) - 1)
    yield Entry("(B.13)", "ω⊥ ~ √2/|τ| near a blow-up", float(residual), 1e-4)
    left = ROOT / fast  # time from the end of the run to the blow-up
    tau = -0.1
    before = run.sol(run.t[-1] + left + tau)
    turned = np.angle((before[0] + 1j * before[1]) / w[-1]) + W3 * left
    s = (1 - DELTA) * W3
    claim = "φ − φ₀ = −ω₃τ + ½ζω₃τ² + O(τ³ ln|τ|) near a blow-up"
    residual = turned / (-W3 * tau + s * tau**2 / 2) - 1
    printed = abs(turned / ((s - W3) * tau) - 1)
    yield Entry("(B.13)", claim, abs(float(residual)), 1e-3, "−(1 − ζ)ω₃τ + O(τ²)", float(printed))


def braking_time() -> Iterator[Entry]:
    """Yield the relaxation time to a residual rotation, in the conclusions."""
    folding = 1 / ((1 - DELTA) * W3) ** 2
    late = exact.longitudinal(DELTA, np.array([0.3, 0.4, W3]), folding * np.array([20.0, 21.0]))
    fall = float(jnp.hypot(late[0, 0], late[0, 1]) / jnp.hypot(late[1, 0], late[1, 1]))
    claim = "ω⊥ falls by e in T = 1/(τ₀Ω₃²I₃²/I₁²), by (3.12)"
    yield Entry("conclusions", claim, abs(fall / np.e - 1), 1e-12)
