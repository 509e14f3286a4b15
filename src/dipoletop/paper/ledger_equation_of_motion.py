"""Sections 2 and 3 up to (3.4): the plane rotator, and the equation of motion of any body."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np

from .. import exact, radiation
from .._base.linalg import cross, dot, inverse, matvec
from ..bodies import Body, axisymmetric, from_charges
from ..equations._common import rate_of_omega
from ..equations.rigid import Full, Reduced, free_rotation
from ..equations.rotator import RotatorFull, RotatorReduced
from .ledger_entry import LANES, Entry, gap, states, unsolved

BODY = Body([[1.0, 0.1, 0.0], [0.1, 1.4, -0.2], [0.0, -0.2, 1.7]], [0.5, 0.3, 0.8])


def rotator() -> Iterator[Entry]:
    """Yield section 2."""
    sphere, w = axisymmetric(0.0), states(2)
    plane = jnp.zeros((3, LANES)).at[2].set(w[0])
    whole = jnp.concatenate([plane, jnp.zeros((2, LANES)), w[1:]])
    general = Full(sphere)(0.0, whole)[jnp.array([2, 5])]
    yield Entry("(2.2), (A.1)", "ω″ = ω′ + ω³", gap(RotatorFull()(0.0, w), general), 1e-14)
    general = Reduced(sphere)(0.0, plane)[2:]
    yield Entry("(2.3)", "ω′ = −ω³", gap(RotatorReduced()(0.0, w[:1]), general), 1e-14)
    solution = jax.jit(lambda t: exact.rotator(0.7, t)[:, None])
    times = np.array([0.0, 0.3, 5.0, 400.0])
    residual = unsolved(RotatorReduced(), solution, times)
    yield Entry("(2.4)", "ω = ω₀/√(1 + 2ω₀²τ)", residual, 1e-14)
    at_t = float(exact.rotator(0.7, 1 / 0.7**2)) / 0.7
    yield Entry("(2.4)", "ω(T)/ω₀ = 1/√3, T = 1/(τ₀Ω₀²)", gap(at_t, 3**-0.5), 1e-14)


def motion() -> Iterator[Entry]:
    """Yield (3.2)–(3.4) and the balance laws."""
    omega, rate, second = states(3), states(3, 2), states(3, 3)
    yield third_derivative(omega, rate, second)
    masses, positions = np.array([1.0, 2.0, 3.0, 2.5]), np.random.default_rng(4).normal(size=(4, 3))
    charges = np.array([0.7, -1.2, 0.2, 0.9])
    centred = positions - masses @ positions / masses.sum()
    residual = gap(from_charges(masses, positions, charges).dipole, charges @ centred)
    claim = "d = Σ qρ, ρ from the centre of mass (except for a misprint)"
    yield Entry("after (3.3)", claim, residual, 1e-14)
    yield from balance()
    free_rate = -matvec(inverse(BODY.inertia), radiation.gyroscopic_torque(BODY, omega))
    momentum = radiation.angular_momentum(BODY, omega)
    torque = cross(omega, radiation.gyroscopic_torque(BODY, omega)) + cross(momentum, free_rate)
    free = free_rotation(BODY, omega)
    residual = max(gap(free[0], free_rate), gap(free[1], matvec(inverse(BODY.inertia), torque)))
    claim = "Ω̇ₜ = −I⁻¹N, Ω̈ₜ = I⁻¹{Ω×N − (IΩ)×I⁻¹N} (except for a stray bracket)"
    yield Entry("(3.4)", claim, residual, 1e-13)


def third_derivative(omega: jnp.ndarray, rate: jnp.ndarray, second: jnp.ndarray) -> Entry:
    """Check (3.2): d⃛ as a sum of products, against three time derivatives in a rotating frame."""
    d = jnp.broadcast_to(BODY.dipole[:, None], omega.shape)

    def in_space(x: Callable) -> Callable:
        """Return the time derivative in the laboratory of a vector given in body axes."""

        def derivative(t: jnp.ndarray) -> jnp.ndarray:
            value, slope = jax.jvp(x, (t,), (jnp.ones_like(t),))
            return slope + cross(omega + rate * t + second * t**2 / 2, value)

        return derivative

    true = in_space(in_space(in_space(lambda t: d + 0 * t)))(jnp.zeros(()))
    first, accelerated = radiation.dipole_derivatives(BODY, omega, rate)
    jerk = second + cross(omega, rate)  # d²Ω/dt² in the laboratory
    sides = cross(jerk, d) + cross(omega, accelerated)
    torque = radiation.radiation_torque(BODY, omega, rate, second)
    residual = max(gap(sides + 2 * cross(rate, first), true), gap(torque, cross(d, true)))
    claim = "ρ⃛ = Ω̈×ρ + 2Ω̇×ρ̇ + Ω×ρ̈, torque d×d⃛"
    printed = "no × in its second term (taken component by component)"
    return Entry("(3.2)", claim, residual, 1e-13, printed, gap(sides + 2 * rate * first, true))


def balance() -> Iterator[Entry]:
    """Yield (3.3), compared with the balance laws of energy and angular momentum."""
    body = axisymmetric(-0.3, [0.6, 0.0, 0.8])
    equation = Full(body)
    y = states(6, 5)
    n = body.dipole
    y = y.at[3:].set(y[3:] - dot(n, y[3:])[None] * n[:, None])

    def conserved(y: jnp.ndarray) -> tuple[jnp.ndarray, jnp.ndarray]:
        omega, rate = equation.omega(y), rate_of_omega(equation, 0.0, y)
        energy = radiation.kinetic_energy(body, omega) - radiation.schott_energy(body, omega, rate)
        momentum = radiation.angular_momentum(body, omega)
        return energy, momentum - radiation.schott_angular_momentum(body, omega, rate)

    (_, momentum), (energy_rate, momentum_rate) = jax.jvp(conserved, (y,), (equation(0.0, y),))
    omega, rate = equation.omega(y), rate_of_omega(equation, 0.0, y)
    first, second = radiation.dipole_derivatives(body, omega, rate)
    claim = "IΩ̇ + N = d×d⃛: d/dt(E − d₁·d₂) = −|d₂|²"
    yield Entry("(3.3)", claim, gap(energy_rate, -dot(second, second)), 1e-12)
    residual = gap(momentum_rate + cross(omega, momentum), -cross(first, second))
    yield Entry("(3.3)", "IΩ̇ + N = d×d⃛: d/dt(L − d×d₂) = −d₁×d₂ (lab)", residual, 1e-12)
