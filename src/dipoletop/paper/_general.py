"""Sections 2 and 3 up to (3.4), appendix A: the equation of motion, and the plane rotator."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from .. import exact, radiation
from .._linalg import cross, dot, inverse, matvec
from .._types import Outcome
from ..bodies import Body, axisymmetric, from_charges
from ..equations.rigid import Full, Reduced, free_rotation
from ..equations.rotator import (
    RotatorFull,
    RotatorReduced,
    closed_manifold,
    critical_manifold,
    separatrix,
)
from ..outcomes import classify
from ._entry import LANES, Entry, gap, states, unsolved

BODY = Body([[1.0, 0.1, 0.0], [0.1, 1.4, -0.2], [0.0, -0.2, 1.7]], [0.5, 0.3, 0.8])


def rotator() -> Iterator[Entry]:
    """Section 2."""
    sphere, w = axisymmetric(0.0), states(2)
    plane = jnp.zeros((3, LANES)).at[2].set(w[0])
    whole = jnp.concatenate([plane, jnp.zeros((2, LANES)), w[1:]])
    found = Full(sphere)(0.0, whole)[jnp.array([2, 5])]
    yield Entry("(2.2), (A.1)", "ω″ = ω′ + ω³", gap(RotatorFull()(0.0, w), found), 1e-14)
    found = Reduced(sphere)(0.0, plane)[2:]
    yield Entry("(2.3)", "ω′ = −ω³", gap(RotatorReduced()(0.0, w[:1]), found), 1e-14)
    solution = jax.jit(lambda t: exact.rotator(0.7, t)[:, None])
    times = np.array([0.0, 0.3, 5.0, 400.0])
    residual = unsolved(RotatorReduced(), solution, times)
    yield Entry("(2.4)", "ω = ω₀/√(1 + 2ω₀²τ)", residual, 1e-14)
    at_t = float(exact.rotator(0.7, 1 / 0.7**2)) / 0.7
    yield Entry("(2.4)", "ω(T)/ω₀ = 1/√3, T = 1/(τ₀Ω₀²)", gap(at_t, 3**-0.5), 1e-14)


def motion() -> Iterator[Entry]:
    """(3.2)–(3.4) and the balance laws."""
    omega, rate, second = states(3), states(3, 2), states(3, 3)
    d = jnp.broadcast_to(BODY.dipole[:, None], omega.shape)
    first, accelerated = radiation.dipole_derivatives(BODY, omega, rate)
    # d⃛ by differentiating in the lab once more: body-frame rate of d₂, and Ω×d₂.
    around = cross(second, d) + cross(rate, first) + cross(omega, cross(rate, d))
    torque = cross(d, around + cross(omega, accelerated))
    found = gap(radiation.radiation_torque(BODY, omega, rate, second), torque)
    yield Entry("(3.2)", "ρ⃛ contains 2Ω̇×ρ, so that T = d×d⃛", found, 1e-13, "2Ω̇ρ")
    masses, spots = np.array([1.0, 2.0, 3.0, 2.5]), np.random.default_rng(4).normal(size=(4, 3))
    charges = np.array([0.7, -1.2, 0.2, 0.9])
    centred = spots - masses @ spots / masses.sum()
    found = from_charges(masses, spots, charges).dipole
    yield Entry("below (3.3)", "d = Σ qρ", gap(found, charges @ centred), 1e-14, "a misprint")
    yield from balance()
    start = -matvec(inverse(BODY.inertia), radiation.gyroscopic_torque(BODY, omega))
    momentum = radiation.angular_momentum(BODY, omega)
    torque = cross(omega, radiation.gyroscopic_torque(BODY, omega)) + cross(momentum, start)
    free = free_rotation(BODY, omega)
    found = max(
        gap(free[0], start),
        gap(free[1], matvec(inverse(BODY.inertia), torque)),
    )
    claim = "Ω̇ₜ = −I⁻¹N, Ω̈ₜ = I⁻¹{Ω×N − (IΩ)×I⁻¹N}"
    yield Entry("(3.4)", claim, found, 1e-13, "a stray bracket")


def balance() -> Iterator[Entry]:
    """(3.3) against the exact laws that follow from d×d⃛ alone."""
    body = axisymmetric(-0.3, [0.6, 0.0, 0.8])
    equation = Full(body)
    y = states(6, 5)
    n = body.dipole
    y = y.at[3:].set(y[3:] - dot(n, y[3:])[None] * n[:, None])

    def lent(y: jnp.ndarray) -> tuple[jnp.ndarray, jnp.ndarray]:
        omega, rate = equation.omega(y), equation.omega_dot(y)
        energy = radiation.kinetic_energy(body, omega) - radiation.schott_energy(body, omega, rate)
        momentum = radiation.angular_momentum(body, omega)
        return energy, momentum - radiation.schott_angular_momentum(body, omega, rate)

    (_, momentum), (energy_rate, momentum_rate) = jax.jvp(lent, (y,), (equation(0.0, y),))
    omega, rate = equation.omega(y), equation.omega_dot(y)
    first, second = radiation.dipole_derivatives(body, omega, rate)
    claim = "IΩ̇ + N = T: d/dt(E − d₁·d₂) = −|d₂|²"
    yield Entry("(3.3)", claim, gap(energy_rate, -dot(second, second)), 1e-12)
    found = gap(momentum_rate + cross(omega, momentum), -cross(first, second))
    yield Entry("(3.3)", "IΩ̇ + N = T: d/dt(L − d×d₂) = −d₁×d₂ (lab)", found, 1e-12)


def phase_plane() -> Iterator[Entry]:
    """Appendix A and figure 3."""
    full, y = RotatorFull(), states(2, 6)
    found = jax.jvp(full.lyapunov, (y,), (full(0.0, y),))[1]
    claim = "V = ω(ϖ − ω/2) grows: V′ = ϖ² + ω⁴"
    yield Entry("(A.7)–(A.14)", claim, gap(found, y[1] ** 2 + y[0] ** 4), 1e-13)
    w = jnp.logspace(-5, 5, LANES)
    one = jnp.ones(LANES)
    f, slope = jax.jvp(critical_manifold, (w,), (one,))
    found = float(jnp.max(jnp.abs(f * slope - f - w**3) / w**3))
    yield Entry("(A.16), AOC", "f f′ = f + ω³, f ~ −ω³ at 0", found, 1e-14)
    small = jnp.array([1e-3, 3e-3])
    series = -(small**3) + 3 * small**5 - 24 * small**7
    found = float(jnp.max(jnp.abs(critical_manifold(small) / series - 1)))
    yield Entry("(A.16)", "f = −ω³ + 3ω⁵ − 24ω⁷ + …", found, 1e-12)
    g, rise = jax.jvp(separatrix, (w,), (one,))
    found = float(jnp.max(jnp.abs(g * rise - g - w**3) / (g + w**3)))
    yield Entry("BOD", "g g′ = g + ω³, g ~ ω at 0", found, 1e-14)
    corners = jnp.array([[0.5, 0.5, -0.5, -0.5, 0.5, -0.5], [-1.0, 0.1, 1.0, -0.1, 1.0, -1.0]])
    domain = full.domain(corners)
    expected = np.array([[1, 1, -1, -1, -1, 1], [-1, 1, 1, -1, 1, -1]])
    found = gap(np.stack([domain.past, domain.future]), expected)
    yield Entry("figure 3", "AOC and BOD part four domains of runaways", found, 0.0)
    found = float(jnp.max(jnp.abs(critical_manifold(small) / -(small**3) - 1) / small**2))
    claim = "slow motions obey (2.3), but for 3ω² of the rate"
    yield Entry("end of appendix A", claim, abs(found / 3 - 1), 1e-4, "another number")
    inverse_rate = jax.vmap(jax.grad(exact.rotator_closed_time))(w)
    claim = "−ω³/√(1+2ω²) integrates to √(1+2ω²)/(2ω²) + arsinh(1/(√2 ω))"
    yield Entry("appendix A", claim, gap(inverse_rate * closed_manifold(w), one), 1e-13)
    error = float(closed_manifold(1.0) / critical_manifold(1.0)) - 1
    claim = "error of that approximation at ω = 1: 22 %"
    yield Entry("appendix A", claim, abs(error - 0.22), 0.005)
    yield from ends_of_the_rotator()


def ends_of_the_rotator() -> Iterator[Entry]:
    """(A.4)–(A.6)."""
    lack, bare = np.diff([_remainders(w) for w in (1e-3, 1e-4)], axis=0)[0]
    claim = "ω = (2τ)^(−1/2) [1 + 3 ln(2τ)/(4τ) + O(1/τ)]"
    yield Entry("(A.4)", claim, abs(lack), 1e-2, "correction O(1/τ)", abs(bare))
    fast = 1e4
    run = classify(RotatorFull(), jnp.array([fast, float(separatrix(fast))]))
    failed = int(run.outcome) == Outcome.FAILED
    found = abs(float(run.time) * fast / np.sqrt(2) - 1) if failed else np.inf
    yield Entry("(A.5)", "ω ~ √2/|τ| near a blow-up", found, 1e-3)
    small = jnp.array([1e-6, 1e-4])
    found = gap(separatrix(small) / small, jnp.ones(2))
    yield Entry("(A.6)", "ω ~ A e^τ at −∞, on BOD", found, 1e-8)


def _remainders(w: float) -> tuple[float, float]:
    """τ·(relative error) of (A.4) with its logarithm and without, when ω has fallen to w."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    low, high = np.log(w), np.log(0.1)
    s = low + (high - low) * (nodes + 1) / 2
    rate = np.asarray(critical_manifold(jnp.exp(jnp.asarray(s))))
    tau = float((high - low) / 2 * np.sum(weights * -np.exp(s) / rate))  # τ = −∫dω/f
    bare = w * np.sqrt(2 * tau)
    return (float(w / exact.rotator_late(tau)) - 1) * tau, (bare - 1) * tau
