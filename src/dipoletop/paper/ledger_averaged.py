"""(4.16)–(4.21): solutions for the averaged top, compared with integrations of (4.13)–(4.15)."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad, solve_ivp

from .. import exact
from ..equations.coordinates import cylindrical
from ..equations.transverse_approximations import TransverseAveraged
from .ledger_entry import Entry, gap, shapes, unsolved

ORBITS = {-0.8: (1.2, 0.5, -0.4, 1.0), -0.3: (0.5, 0.6, -0.2, 3.0), 0.4: (0.5, 0.6, -0.2, 3.0)}
ORBITS[0.7] = ORBITS[0.4]
"""By δ: initial ω⊥, ω₃ and φ̄, and the length of the integration."""
BEGIN = 4.0
"""τᵢ, the initial time."""
DECADES = {-1.0: (50, 300), -0.8: (20, 50), -0.5: (50, 300), -0.3: (20, 50), 0.3: (20, 50)}
"""By δ: two values of log₁₀ τ where the asymptotics are evaluated; larger if they contain ln τ."""

Exponent = Callable[[Any], Any]


def p_right(d: Any) -> Any:
    """Return the exponent p of (4.19), corrected."""
    return d * (1 - d) * (3 + 3 * d + d**2) / ((1 + 2 * d) * (1 + d**3))


def p_printed(d: Any) -> Any:
    """Return the exponent p of (4.19), as printed."""
    return d * (1 - d) * (3 + 3 * d + d**3) / ((1 + 2 * d) * (1 + d))


def q_printed(d: Any) -> Any:
    """Return the exponent q of (4.19), which is printed correctly."""
    return 2 / (1 + d**3)


class SampledOrbit(NamedTuple):
    """One integrated motion of the averaged top."""

    delta: float
    time: np.ndarray
    u: np.ndarray
    v: np.ndarray
    phi: np.ndarray

    @property
    def xi(self) -> np.ndarray:
        """ξ = ω⊥²/ω₃², which is monotonic along the motion."""
        return self.u / self.v


@jax.jit
def averaged_rate(delta: Any, y: Any) -> Any:
    """Return (4.13)–(4.15): the rates of ω⊥, ω₃ and φ̄."""
    return TransverseAveraged(delta)(0.0, y)


def integrated() -> list[SampledOrbit]:
    """Return the motions of `ORBITS`, integrated."""
    orbits = []
    for delta, (*start, span) in ORBITS.items():
        run = solve_ivp(
            lambda t, y, d=delta: np.asarray(averaged_rate(d, y)),
            (BEGIN, BEGIN + span),
            start,
            method="DOP853",
            t_eval=BEGIN + span * np.linspace(0, 1, 5),
            rtol=1e-13,
            atol=1e-15,
        )
        orbits.append(SampledOrbit(delta, run.t, run.y[0] ** 2, run.y[1] ** 2, run.y[2]))
    return orbits


def orbits() -> Iterator[Entry]:
    """Yield (4.16)–(4.19)."""
    runs = integrated()
    claim = "u = ξv = Cξ^{1−q}|(1+2δ)ξ + 1+δ³|^p, with the right p of (4.19)"
    yield Entry("(4.16)", claim, max(off_the_orbit(o, p_right) for o in runs), 1e-11)
    yield from times(runs)
    residual = max(gap(quadrature(o, angle=True), np.abs(o.phi - o.phi[0])[1:]) for o in runs)
    claim = "|φ̄ − φ̄ᵢ| = |δ|(1−δ)C^{−1/2}|∫ξ^{q/2−1}|(1+2δ)ξ + 1+δ³|^{−p/2−1}dξ|"
    yield Entry("(4.18)", claim, residual, 1e-11)
    yield from exponents(runs)


def off_the_orbit(orbit: SampledOrbit, p: Exponent) -> float:
    """Return the relative variation of v ξ^q |aξ + b|^{−p} along an orbit, which should be 0."""
    d = orbit.delta
    edge = np.abs((1 + 2 * d) * orbit.xi + 1 + d**3)
    constant = orbit.v * orbit.xi ** q_printed(d) * edge ** -p(d)
    return gap(constant / constant[0], np.ones_like(constant))


def quadrature(orbit: SampledOrbit, *, angle: bool = False) -> np.ndarray:
    """Return the times since τᵢ by (4.17), or the angles by (4.18), with absolute values."""
    d, p, q = orbit.delta, p_right(orbit.delta), q_printed(orbit.delta)
    a, b, first = 1 + 2 * d, 1 + d**3, orbit.xi[0]
    c = orbit.v[0] * first**q * abs(a * first + b) ** -p
    half = 2 if angle else 1
    factor = abs(d) * (1 - d) / np.sqrt(c) if angle else (1 - d) / c

    def integrand(x: float) -> float:
        return x ** (q / half - 1) * abs(a * x + b) ** (-p / half - 1)

    integrals = [quad(integrand, first, xi, epsabs=0, epsrel=1e-13)[0] for xi in orbit.xi[1:]]
    return factor * np.abs(integrals)


def times(runs: list[SampledOrbit]) -> Iterator[Entry]:
    """Yield (4.17)."""
    since = [quadrature(o) for o in runs]
    residual = max(gap(t, o.time[1:] - BEGIN) for o, t in zip(runs, since, strict=True))
    # The braces are negative along the whole first orbit, so that printed and corrected integrands
    # differ by a constant power of −1.
    power_of_minus_1 = complex(-1) ** (-p_right(runs[0].delta) - 1)
    printed = min(abs(power_of_minus_1 - 1), abs(power_of_minus_1 + 1))
    claim = "τ − τᵢ = ((1−δ)/C)|∫ξ^{q−1}|(1+2δ)ξ + 1+δ³|^{−p−1}dξ|"
    wrong = "{(1+2δ)ξ + 1+δ³}^{−p−1}, which is not real for {…} < 0"
    edge = (1 + 2 * runs[0].delta) * runs[0].xi + 1 + runs[0].delta ** 3
    yield Entry("(4.17)", claim, residual, 1e-11, wrong, printed if np.all(edge < 0) else 0.0)
    unit = max(gap(t, o.time[1:] - 1.0) for o, t in zip(runs, since, strict=True))
    claim, wrong = "its τᵢ is the time of the start", "its τ₀ is the unit of time, 1 here"
    yield Entry("(4.17)", claim, residual, 1e-11, wrong, unit)


def exponents(runs: list[SampledOrbit]) -> Iterator[Entry]:
    """Yield (4.19), inserted in (4.13)–(4.14): d ln v/d ln ξ at many ξ and δ, and along orbits."""
    deltas = np.asarray(shapes())
    deltas = deltas[(np.abs(deltas + 0.5) > 1e-3) & (deltas > -1)]  # p itself is singular there
    xi = np.array([1e-14, 0.3, 2.0, 40.0, 1e3])[:, None]
    ones = np.ones_like(xi * deltas)
    y = jnp.stack([np.sqrt(xi) * ones, ones, 0 * ones])
    rate = np.asarray(jax.vmap(lambda y: TransverseAveraged(deltas)(0.0, y), 1, 1)(y))
    fall = 2 * rate[1]  # d ln v/dτ at v = 1
    slope = fall / (2 * rate[0] / np.sqrt(xi) - fall)
    edge = (1 + 2 * deltas) * xi
    near = slope[:1], -q_printed(deltas)[None]
    yield Entry("(4.19)", "q = 2/(1+δ³)", gap(*near), 1e-11)

    def off_the_slope(p: Exponent) -> float:
        law = -q_printed(deltas) + p(deltas) * edge / (edge + 1 + deltas**3)
        return float(np.max(np.abs(slope / law - 1)))

    claim = "p = δ(1−δ)(3+3δ+δ²)/[(1+2δ)(1+δ³)]"
    wrong = "p = δ(1−δ)(3+3δ+δ³)/[(1+2δ)(1+δ)]"
    residual = max(off_the_slope(p_right), *(off_the_orbit(o, p_right) for o in runs))
    printed = min(off_the_orbit(o, p_printed) for o in runs)
    yield Entry("(4.19)", claim, residual, 1e-10, wrong, printed)


def limits() -> Iterator[Entry]:
    """Yield `exact.averaged`, which includes the limits δ = −1, −1/2 and 0."""
    solution = jax.jit(exact.averaged)
    start, times = cylindrical(0.8, -0.6, 0.3), np.array([0.0, 0.3, 5.0, 400.0])

    def residual_at(delta: float) -> float:
        equation = TransverseAveraged(delta)

        def field(t: float, omega: jnp.ndarray) -> jnp.ndarray:
            y = equation.lift(omega)
            return jax.jvp(equation.omega, (y,), (equation(t, y),))[1]

        return unsolved(field, lambda t: solution(delta, start, t), times)

    residual = max(residual_at(delta) for delta in (-1.0, -0.7, -0.5, -0.2, 0.0, 0.6))
    claim = "their limits at δ = −1, −1/2 and 0 solve (4.13)–(4.15), too"
    yield Entry("(4.16)–(4.19)", claim, residual, 1e-11)


class Late(NamedTuple):
    """An averaged motion at the two times of `DECADES`."""

    log_tau: np.ndarray
    u: np.ndarray
    """τω⊥²."""
    v: np.ndarray
    """τω₃²."""
    phi: np.ndarray
    """φ̄ − φ̄ᵢ."""
    phi_rate: np.ndarray
    """dφ̄/d ln τ."""


def followed(delta: float, start: tuple[float, float]) -> Late:
    """Integrate a motion from τ = 1 over s = ln τ in the variables ln τω⊥², ln τω₃² and φ̄."""

    def rate(s: float, y: np.ndarray) -> np.ndarray:
        w, w3 = np.exp(y[:2] / 2)
        across, along, phi_rate = np.asarray(averaged_rate(delta, np.array([w, w3, 0.0])))
        return np.array([1 + 2 * across / w, 1 + 2 * along / w3, phi_rate * np.exp(s / 2)])

    late = np.log(10.0) * np.array(DECADES[delta])
    y0 = [2 * np.log(start[0]), 2 * np.log(start[1]), 0.0]
    run = solve_ivp(rate, (0, late[-1]), y0, method="DOP853", t_eval=late, rtol=1e-11, atol=1e-11)
    phi_rate = np.array([rate(s, y)[2] for s, y in zip(late, run.y.T, strict=True)])
    return Late(late, np.exp(run.y[0]), np.exp(run.y[1]), run.y[2], phi_rate)


def late() -> Iterator[Entry]:
    """Yield (4.20), (4.21)."""
    start = (0.8, 0.6)
    runs = {delta: followed(delta, start) for delta in DECADES}
    yield from powers(runs, start)
    yield from angles(runs)


def powers(runs: dict[float, Late], start: tuple[float, float]) -> Iterator[Entry]:
    """Yield the laws of ω⊥² and ω₃²."""

    def off(delta: float) -> float:
        run, tau = runs[delta], np.exp(runs[delta].log_tau[1])
        late = exact.averaged_late(delta, np.array([start[0], 0.0, start[1]]), tau - 1)
        return gap(np.array([run.u[1], run.v[1]]) / (tau * np.array(late)), np.ones(2))

    yield Entry("(4.20)", "u, v ~ 1/τ for −1 < δ < −1/2", off(-0.8), 1e-6)
    for delta, claim, which in (
        (-1.0, "δ = −1: u ~ 2/(τ ln τ), v ~ 1/τ", "u"),
        (-0.5, "δ = −1/2: v ~ (12/7)/(τ ln τ), u ~ 1/τ", "v"),
    ):
        first, last = getattr(runs[delta], which)
        yield Entry("(4.20)", claim, off(delta), 0.01, f"{which} ~ 1/τ", gap(last, first))
    claim = "u ~ 1/τ, v ~ τ^{−(2+δ)/(1−δ)} for −1/2 < δ < 1"
    yield Entry("(4.21)", claim, max(off(-0.3), off(0.3)), 1e-6)


def angles(runs: dict[float, Late]) -> Iterator[Entry]:
    """Yield the growth of φ̄."""

    def grows(delta: float, power: float) -> float:
        """Return the relative difference of d ln|φ̄ − φ̄ᵢ|/d ln τ from a power."""
        return abs(float(runs[delta].phi_rate[1] / runs[delta].phi[1]) / power - 1)

    residual = max(grows(-1.0, 0.5), grows(-0.8, 0.5))
    yield Entry("(4.20)", "|φ̄| ~ τ^{1/2} for −1 ≤ δ < −1/2", residual, 1e-3)
    edge = runs[-0.5]
    root = np.abs(edge.phi) * np.exp(-edge.log_tau / 2)
    residual = gap(root[1] * np.sqrt(edge.log_tau[1] / (12 / 7)), 1.0)
    claim, printed = "δ = −1/2: |φ̄| ~ √(12/7) (τ/ln τ)^{1/2}", "|φ̄| ~ τ^{1/2}"
    yield Entry("(4.20)", claim, residual, 0.01, printed, gap(root[1], root[0]))
    power = {d: -3 * d / (2 * (1 - d)) for d in (-0.3, 0.3)}
    claim = "|φ̄| ~ τ^{−3δ/(2(1−δ))} for −1/2 < δ < 0"
    yield Entry("(4.21)", claim, grows(-0.3, power[-0.3]), 1e-6)
    settling = runs[0.3]
    remaining = settling.phi[0] - settling.phi[1]
    residual = abs(float(settling.phi_rate[0] / remaining) / power[0.3] - 1)
    claim = "φ̄ → φ̄∞, |φ̄ − φ̄∞| ~ τ^{−3δ/(2(1−δ))} for δ > 0"
    printed = "|φ̄| ~ τ^{−3δ/(2(1−δ))}"
    yield Entry("(4.21)", claim, residual, 1e-3, printed, grows(0.3, power[0.3]))
