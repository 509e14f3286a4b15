"""Torques from outside: closed forms, conserved quantities, sweeps by every engine, refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop import Outcome, torques
from dipoletop._branch.march import depends_on_time

GAMMA = 0.1
SPIN = [0.0, 1.0, 0.0]
LEVEL, TILTED = [1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0]


def braked(gamma, w, t):
    """ω′ = −(γ − γ²)ω − ω³, a Bernoulli equation: γ²ω is the ω″ of ω′ = −γω in the radiation."""
    rate = gamma - gamma**2
    return (np.exp(2 * rate * t) * (1 / w**2 + 1 / rate) - 1 / rate) ** -0.5


@pytest.mark.parametrize(
    "equation",
    [
        dt.TransverseReduced(0.3),
        pytest.param(dt.Reduced(dt.axisymmetric(0.3)), marks=pytest.mark.slow),
    ],
)
def test_drag_and_radiation_brake_a_rotator(equation):
    ts = jnp.linspace(0.0, 8.0, 9)
    first = torques.with_torque(equation, torques.drag(0.04))  # several torques add up
    both = torques.with_torque(first, torques.drag((GAMMA - 0.04) * np.eye(3)))
    run = dt.simulate(both, SPIN, ts)
    np.testing.assert_allclose(run.omega[:, 1], braked(GAMMA, 1.0, np.asarray(ts)), rtol=1e-9)
    assert run.level == f"{equation.level}, with a torque"


@pytest.mark.slow
def test_a_given_torque_in_time():
    """Along the dipole nothing radiates: I₁ω₁′ = M(τ), and the energy changes by the work alone."""

    def push(t, omega):
        return jnp.stack([jnp.cos(t), jnp.zeros_like(t), jnp.zeros_like(t)])

    ts = jnp.linspace(0.0, 5.0, 11)
    equation = torques.with_torque(dt.TransverseSemi(0.3), push)
    run = dt.simulate(equation, [0.5, 0.0, 0.0], ts, balance=True)
    np.testing.assert_allclose(run.omega[:, 0], 0.5 + np.sin(ts), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.work, run.energy - run.energy[0], atol=1e-9)
    np.testing.assert_allclose(run.emitted, 0.0, atol=1e-9)
    np.testing.assert_allclose(run.balance_defect, 0.0, atol=1e-8)


def rotated(q, v):
    """v in the laboratory, by the attitude q."""
    w, u = q[0], q[1:]
    return v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


@pytest.mark.slow
def test_a_field_on_a_dipole_conserves_energy_and_the_momentum_along_it():
    """Without radiation ½ω·Iω − d·E and the momentum along E are constants of the motion."""
    dipole, field = np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.3, 0.4])
    dark = dt.Reduced(dt.Body(np.diag([1.0, 1.3, 0.8]), 1e-8 * dipole))  # radiates ~ 1e-16
    pulled = torques.FieldOnDipole(jnp.asarray(dipole), jnp.asarray(field))
    equation = torques.with_torque(dark, pulled, attitude=TILTED)
    run = dt.simulate(equation, [0.3, -0.2, 0.5], jnp.linspace(0.0, 40.0, 81), rtol=1e-11)
    q = np.asarray(run.attitude)
    np.testing.assert_allclose(q[0], TILTED, rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-14)
    lab = [rotated(x, 1e-8 * dipole) for x in q]
    np.testing.assert_allclose(run.dipole, lab, rtol=0, atol=1e-22)
    energy = np.asarray(run.energy) - np.array([rotated(x, dipole) for x in q]) @ field
    np.testing.assert_allclose(energy, energy[0], atol=1e-9)
    momenta = np.asarray(run.omega) @ np.asarray(dark.body.inertia)
    lab = np.array([rotated(x, m) for x, m in zip(q, momenta, strict=True)])
    along = lab @ field
    np.testing.assert_allclose(along, along[0], atol=1e-9)
    assert np.ptp(np.linalg.norm(lab, axis=1)) > 0.1  # the field does act


# The radiation of a motion that a torque drives


def in_field(level, delta, field):
    """An equation in a field, from the attitude LEVEL on."""
    top = dt.equation_at(level, delta)
    pulled = torques.field_on_dipole(top, field)
    return torques.with_torque(top, pulled, attitude=LEVEL)


def swing(level, delta, field, start, ts, **settings):
    return dt.simulate(in_field(level, delta, field), start, ts, rtol=1e-11, **settings)


def assert_damped(run, roots):
    one, other = roots
    ts = np.asarray(run.ts)
    exact = (one * np.exp(one * ts) - other * np.exp(other * ts)) / (one - other)
    np.testing.assert_allclose(run.omega[:, 2] / 1e-6, exact.real, atol=2e-10)
    assert abs(exact[-1]) < 0.8  # it is damped


def acceleration(level, inertia, strength):
    """θ″ = aθ + bθ′ at a level, from I₃θ″ = −Eθ + θ‴: a small swing about a field."""
    a, b = -strength / inertia, 0.0  # without radiation, then order by order
    for _ in range(1 if level == "semi" else int(level[-1])):
        a, b = (-strength + b * a) / inertia, (a + b * b) / inertia
    return a, b


@pytest.mark.slow
def test_radiation_damps_a_swing_by_the_closed_form():
    strength, ts = 0.07, np.linspace(0.0, 40.0, 21)
    run = swing("order-1", 0.3, [strength, 0.0, 0.0], [0.0, 0.0, 1e-6], ts)
    a, b = acceleration("order-1", 1 - 0.3, strength)
    assert_damped(run, np.roots([1.0, -b, -a]))


ORDER_3 = pytest.param("order-3", marks=pytest.mark.slow)


@pytest.mark.parametrize("level", ["order-1", "order-2", ORDER_3, "semi"])
def test_radiation_of_a_swing_at_every_level(level):
    strength, small = 0.07, 1e-7
    equation = in_field(level, -0.5, [strength, 0.0, 0.0])
    a, b = acceleration(level, 1.5, strength)
    rate = jax.jit(lambda y: equation(0.0, y)[2])
    for angle, speed in ((1.0, 0.0), (0.0, 1.0), (0.4, -0.7)):
        y = jnp.array([0.0, 0.0, small * speed, 1.0, 0.0, 0.0, small * angle / 2])
        np.testing.assert_allclose(rate(y) / small, a * angle + b * speed, rtol=1e-9, atol=1e-12)


@pytest.mark.slow  # compiles for long
def test_a_field_and_the_branch():
    """A small swing is damped by the closed form; at any amplitude the energy is radiated.

    E − d·E − d₁·d₂ + ∫|d₂|²dτ is constant, and d₁·d₂ = 0 where nothing turns.
    """
    delta, strength = 0.3, 0.07
    ts = np.linspace(0.0, 40.0, 21)
    small = swing("full", delta, [strength, 0.0, 0.0], [0.0, 0.0, 1e-6], ts, balance=True)
    roots = np.roots([-1.0, 1 - delta, 0.0, strength])
    assert_damped(small, roots[roots.imag != 0])
    field, body = np.array([0.01, 0.02, 0.03]), dt.axisymmetric(delta)
    run = swing("full", delta, field, [0.1, -0.1, 0.15], np.linspace(0.0, 60.0, 21), balance=True)
    schott = jax.vmap(lambda w, rate: dt.radiation.schott_energy(body, w, rate))
    potential = -np.array([rotated(x, np.asarray(body.dipole)) for x in run.attitude]) @ field
    energy = np.asarray(run.energy) + potential
    total = energy - np.asarray(schott(run.omega, run.omega_dot)) + np.asarray(run.emitted)
    np.testing.assert_allclose(total, total[0], atol=1e-9)
    assert energy[0] - energy[-1] > 0.01


@pytest.mark.slow
def test_a_torque_in_time_sets_a_body_in_motion():
    """I₃ω₃′ = M(τ) + ω₃″ − ω₃³ about axis 3, near rest; at order 1 with ω₃″ = M′/I₃.

    At the full level see `test_driven_branch`.
    """
    frequency, size, inertia = 0.5, 1e-8, 1 - 0.4

    def push(t, omega):
        return jnp.stack([0 * t, 0 * t, size * jnp.sin(frequency * t)])

    ts = np.linspace(0.0, 30.0, 61)
    equation = torques.with_torque(dt.TransverseReduced(0.4), push)
    run = dt.simulate(equation, [0.0, 0.0, 0.0], ts, atol=1e-18)
    rate = 1j * frequency
    answer = (1 + rate / inertia) / (inertia * rate)  # ω = Im(A e^{ift}) + constant
    exact = (answer * np.exp(rate * ts)).imag - answer.imag
    np.testing.assert_allclose(run.omega[:, 2] / size, exact, atol=1e-8)


def test_the_time_is_a_variable_of_a_full_equation_only_where_a_torque_depends_on_it():
    def wave(size, t, omega):
        return size * jnp.sin(t) * omega

    def brake(size, t, omega):
        return -size * omega

    assert not depends_on_time(dt.TransverseFull(0.3))
    for size in jnp.array([0.1, 0.2]):  # the second one asks what is remembered
        for function, answer in ((wave, True), (brake, False)):
            equation = torques.with_torque(dt.TransverseFull(0.3), Partial(function, size))
            assert depends_on_time(equation) is answer


def test_a_field_is_added_to_a_field():
    top, fields = dt.TransverseReduced(-0.2), np.array([[0.0, 0.01, 0.0], [0.0, 0.0, 0.02]])
    one, other, both = (torques.field_on_dipole(top, f) for f in (*fields, fields.sum(axis=0)))
    first = torques.with_torque(top, one, attitude=TILTED)
    added, known = torques.with_torque(first, other), torques.with_torque(top, both, attitude=LEVEL)
    y = jnp.array([0.1, -0.2, 0.3, *TILTED])
    rates = jax.jit(lambda *equations: [equation(0.0, y) for equation in equations])
    np.testing.assert_allclose(*rates(added, known), rtol=1e-13)


@pytest.mark.slow
def test_semi_reduced_with_drag_against_another_integrator():
    """Ω̈ in the torque is that of I Ω̇ = −N − γΩ, by finite differences of the free motion."""
    gamma, top = 0.1, dt.TransverseSemi(-0.2)
    equation = torques.with_torque(top, torques.drag(gamma))
    start = np.asarray(dt.cylindrical(0.3, 0.2, 0.5))
    moments, d = np.array([1.0, 1.0, 1.2]), np.array([1.0, 0.0, 0.0])

    def free(w):
        return (-np.cross(w, moments * w) - gamma * w) / moments

    def field(t, w):
        h = 1e-4
        second = (free(w + h * free(w)) - free(w - h * free(w))) / (2 * h)  # d/dτ of free(w)
        matrix = np.diag(moments) - np.cross(d, np.outer(w, d) + 2 * (d @ w) * np.eye(3), axis=0)
        known = np.cross(d, np.cross(d, w @ w * w - second))
        return np.linalg.solve(matrix, moments * free(w) + known)

    exact = solve_ivp(field, (0, 10), start, rtol=1e-10, atol=1e-13, method="DOP853")
    run = dt.simulate(equation, start, [0.0, 10.0], rtol=1e-11)
    np.testing.assert_allclose(run.omega[-1], exact.y[:, -1], rtol=1e-7)


# Energy and attitude of a run


def test_the_body_is_held_once():
    """So that another one in its place moves."""
    equation = torques.with_torque(dt.TransverseSemi(0.3), torques.drag(GAMMA))
    other = eqx.tree_at(lambda e: e.loaded.body, equation, dt.axisymmetric(-0.4))
    expected = torques.with_torque(dt.TransverseSemi(-0.4), torques.drag(GAMMA))
    assert jax.tree.all(jax.tree.map(jnp.array_equal, other, expected))


# Verdicts of the user


def rests(y):
    """A motion has stopped once |ω| is below 0.01."""
    still = y[0] ** 2 + y[1] ** 2 + y[2] ** 2 < 1e-4
    return jnp.where(still, int(Outcome.STOP), 0), jnp.zeros_like(y[0]), still & False


def test_a_run_ends_by_the_verdict_of_the_user():
    equation = torques.with_torque(dt.TransverseReduced(0.3), torques.drag(GAMMA), verdict=rests)
    found = dt.classify(equation, SPIN)
    assert found.outcome == Outcome.STOP
    assert not found.certified
    assert braked(GAMMA, 1.0, float(found.time)) <= 0.01


def test_the_regions_of_the_equation_do_not_decide_with_a_torque():
    equation = torques.with_torque(dt.TransverseReduced(0.3), torques.drag(GAMMA))
    with pytest.raises(ValueError, match="have a method `verdict"):
        dt.sweep(lambda w3: (equation, dt.cylindrical(0.2, w3, 0.1)), dt.Grid(w3=[0.1]))


@pytest.mark.slow
def test_parameters_of_functions_are_arguments_with_derivatives():
    def drag(gamma, t, omega):
        return -gamma * omega

    def end(gamma):
        equation = torques.with_torque(dt.TransverseReduced(0.3), Partial(drag, gamma))
        return dt.simulate(equation, SPIN, [0.0, 4.0]).omega[-1, 1]

    h = 1e-4
    found, slope = jax.jit(jax.value_and_grad(end))(GAMMA)
    np.testing.assert_allclose(found, braked(GAMMA, 1.0, 4.0), rtol=1e-9)
    change = braked(GAMMA + h, 1.0, 4.0) - braked(GAMMA - h, 1.0, 4.0)
    np.testing.assert_allclose(slope, change / (2 * h), rtol=1e-6)


# A rotating field


def following(pulled, time):
    """A run of a braked sphere in a field that rotates at the rate 0.03."""
    equation = torques.with_torque(dt.TransverseReduced(0.0), pulled, attitude=LEVEL)
    equation = torques.with_torque(equation, torques.drag(1e-2))
    return dt.simulate(equation, [0.0, 0.0, 0.03], [0.0, time])


@pytest.mark.slow
def test_a_dipole_follows_a_rotating_field_with_a_lag():
    """Against drag and radiation E sin φ = Γν + ν³; order 1 inserts Ω̈ = −Γν³, too."""
    strength, rate, gamma = 1e-3, 0.03, 1e-2
    run = following(torques.rotating_field(strength, rate), 4000.0)
    np.testing.assert_allclose(run.omega[-1], [0, 0, rate], atol=1e-8)
    turned = 2 * np.arctan2(run.attitude[-1, 3], run.attitude[-1, 0])
    lag = np.sin(rate * 4000.0 - turned)
    np.testing.assert_allclose(lag, (gamma * rate + (1 + gamma) * rate**3) / strength, rtol=1e-5)


@pytest.mark.slow
def test_a_field_that_is_too_weak_loses_the_dipole():
    """Without inertia the mean rate would be √(ν² − (E/Γ)²) less than ν; here the field is lost."""
    run = following(torques.rotating_field(1e-4, 0.03, axis=[0, 0, 2.0]), 2000.0)
    assert run.omega[-1, 2] < 0.006


def test_the_axis_of_a_rotating_field():
    for axis in ([0, 0, 1.0], [0, 0, -1.0], [0.6, 0, 0.8], [0.0, -3.0, 0.1]):
        field = torques.rotating_field(1.0, 1.0, axis=axis)
        first, second = np.asarray(field.axes)
        normal = np.cross(first, second)
        np.testing.assert_allclose(normal, axis / np.linalg.norm(axis), atol=1e-15)
        np.testing.assert_allclose(first @ first, 1.0, rtol=1e-14)


# Torques of the literature, in place of the radiation torque or beside it


@pytest.mark.slow
def test_the_torque_without_schott_terms_keeps_the_angle_of_a_dipole_along_the_axis():
    """−ḋ×d̈: θ stays, L = L₀/√(1 + 2κ sin²θ L₀²τ/I₁³), so Ω₃ decays (Duviryak 2022)."""
    kappa, moments = 1e-4, jnp.array([1.0, 1.0, 0.6])
    body = dt.Body(jnp.diag(moments), [0.0, 0.0, np.sqrt(kappa)])

    def free(omega):
        return -jnp.cross(omega, moments * omega) / moments

    def schott(omega):
        return dt.radiation.schott_angular_momentum(body, omega, free(omega))

    def instead(t, omega):  # T + this is −ḋ×d̈, since T = d/dt(d×d̈) − ḋ×d̈ in the laboratory
        value, change = jax.jvp(schott, (omega,), (free(omega),))
        return -(change + jnp.cross(omega, value))

    equation = torques.with_torque(dt.Reduced(body, order=1), instead)
    start = jnp.array([0.6, 0.0, 0.9])
    run = dt.simulate(equation, start, [0.0, 3e4], rtol=1e-9, max_steps=500_000)
    first, last = (np.asarray(moments * omega) for omega in run.omega)
    size, left = np.linalg.norm(first), np.linalg.norm(last)
    sine2 = first[0] ** 2 / size**2
    expected = size / np.sqrt(1 + 2 * kappa * sine2 * size**2 * 3e4)
    np.testing.assert_allclose(left, expected, rtol=2e-3)
    np.testing.assert_allclose(last[2] / left, first[2] / size, rtol=2e-3)
    assert last[2] < 0.8 * first[2]  # the radiation torque keeps it


@pytest.mark.slow
def test_a_pulsar_in_a_plasma_aligns_as_the_inverse_root_of_time():
    """IΩ̇ = −3κ(1 + sin²α)Ω³/2, α̇ = −3κ sin α cos α Ω²/2: Ω cos²α/sin α stays (Philippov 2014)."""
    kappa = 1e-3
    d = np.sqrt(kappa) * jnp.array([0.0, 0.0, 1.0])
    body = dt.Body(np.eye(3), d)

    def plasma(t, omega):  # half of the torque in vacuum, and a torque against Ω
        square = omega @ omega
        vacuum = square * (d * (d @ omega) - (d @ d) * omega)
        return vacuum / 2 - 1.5 * (d @ d) * square * omega

    equation = torques.with_torque(dt.Reduced(body, order=1), plasma)
    times = np.array([0.0, 1e4, 1e7, 4e7])
    run = dt.simulate(equation, [0.8, 0.0, 0.6], times, rtol=1e-9)
    speed = np.linalg.norm(run.omega, axis=1)
    cosine, sine = run.omega[:, 2] / speed, np.hypot(run.omega[:, 0], run.omega[:, 1]) / speed
    kept = speed * cosine**2 / sine
    np.testing.assert_allclose(kept, kept[0], rtol=5e-3)
    np.testing.assert_allclose(sine[2] / sine[3], 2.0, rtol=1e-3)
    np.testing.assert_allclose(speed[2] / speed[3], 2.0, rtol=1e-3)


# The drag of a gas


def test_gas_drag_is_the_momentum_that_molecules_take_away():
    """Each leaves with the velocity of the surface on average; points of the surface at random."""
    radius, pressure, temperature = 5e-8, 1e-3, 290.0
    bead = dt.Particle.sphere(radius, [0.0, 0.0, 1e-27], density=2000.0)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200_000, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    boltzmann, mass = 1.380649e-23, 28.97 * 1.66053906660e-27
    flux = pressure * np.sqrt(mass / (2 * np.pi * boltzmann * temperature))  # kg/(m² s)
    spin = np.array([0.0, 0.0, 1.0])
    torque = np.cross(points, np.cross(spin, points)).mean(axis=0) * 4 * np.pi * radius**2 * flux
    found = torques.gas_drag(bead, pressure, temperature)
    np.testing.assert_allclose(found, torque[2], rtol=5e-3)
    pressures = [pressure, 2 * pressure]
    np.testing.assert_allclose(torques.gas_drag(bead, pressures, temperature), [found, 2 * found])


def test_sweeps_know_the_time():
    """I₁ω₁′ ∝ τ along the dipole, each its own; the verdict gives ω₁ where the run ended."""

    def verdict(y):
        return jnp.where(y[0] > 0.5, int(Outcome.RESIDUAL), 0), y[0], (y[0] > 0.5) & False

    def push(slope, t, omega):
        assert omega.shape == (3,)
        return jnp.stack([slope * t, 0 * t, 0 * t])

    def problem(slope):
        torque = Partial(push, slope)
        equation = torques.with_torque(dt.TransverseSemi(0.3), torque, verdict=verdict)
        return equation, jnp.array([0.1, 0.0, 0.0])

    slopes = np.array([0.01, 0.02])
    basin = dt.sweep(problem, dt.Grid(slope=slopes), value="unchecked")
    ends = 0.1 + slopes * basin.time**2 / 2
    np.testing.assert_allclose(basin.omega_inf, ends, rtol=1e-7)


def test_maps_with_a_torque_are_not_unfolded():
    """A constant torque lacks the symmetries of the free top."""

    def push(t, omega):
        assert omega.shape == (3,)  # a plain function sees one top
        return jnp.stack([0 * t, 0 * t, 2e-3 + 0 * t])

    def problem(phi, w3):
        equation = torques.with_torque(dt.TransverseSemi(-0.2), push, verdict=rests)
        return equation, dt.cylindrical(0.05, w3, phi)

    phi = np.arange(4) * np.pi / 4  # a symmetry cell
    basin = dt.sweep(problem, dt.Grid(w3=[0.0, 0.05], phi=phi), value="unchecked")
    assert dt.plots.unfold(basin) is basin
    _, columns = dt.plots.basin(basin).get_images()[0].get_array().shape[:2]
    assert columns == len(phi)


@pytest.mark.slow
def test_stores_tell_torques_apart_that_agree_at_first(tmp_path):
    """sin τ and tanh τ at τ = 0."""

    def problem_of(function):
        def push(t, omega):
            return jnp.stack([0 * t, 0 * t, 1e-3 * function(t)])

        def problem(w3):
            equation = torques.with_torque(dt.TransverseReduced(-0.2), push, verdict=rests)
            return equation, dt.cylindrical(0.005, w3, 0.1)

        return problem

    grid = dt.Grid(w3=[0.0, 0.001])
    dt.sweep(problem_of(jnp.sin), grid, store=tmp_path / "a.zarr")
    with pytest.raises(dt.StoreMismatch):
        dt.sweep(problem_of(jnp.tanh), grid, store=tmp_path / "a.zarr")


@pytest.mark.slow
def test_half_of_the_energy_is_lost_when_a_growing_drag_has_taken_it():
    """I₁ω₁′ = −(1 + τ)ω₁/10 along the dipole."""

    def drag(t, omega):
        return jnp.stack([-0.1 * (1 + t) * omega[0], 0 * t, 0 * t])

    equation = torques.with_torque(dt.TransverseReduced(0.3), drag, verdict=rests)
    found = dt.decay_time(equation, [0.2, 0.0, 0.0], 0.5)
    np.testing.assert_allclose(found, np.sqrt(1 + 10 * np.log(2)) - 1, rtol=1e-6)


def test_a_motion_with_a_torque_is_not_begun_again_from_a_late_state():
    equation = torques.with_torque(dt.TransverseSemi(0.3), torques.drag(0.1), verdict=rests)
    with pytest.raises(ValueError, match="`equation` must have no torque from outside"):
        dt.boundary.edge_state(equation, [0.2, 0.0, 0.0], [-0.2, 0.0, 0.0])


@pytest.mark.slow
def test_a_function_that_holds_a_traced_number_is_refused():
    def end(gamma):
        equation = torques.with_torque(dt.TransverseReduced(0.3), lambda t, w: -gamma * w)
        return dt.simulate(equation, SPIN, [0.0, 4.0]).omega[-1, 1]

    with pytest.raises(ValueError, match="`torque` must take parameters that vary as arguments"):
        jax.grad(end)(GAMMA)
    assert end(GAMMA) > 0  # a plain number may be held


PULSE = (50.0, 50.01)


class Pulse(eqx.Module):
    """A torque between two times."""

    torque: jax.Array
    times: jax.Array = eqx.field(converter=jnp.asarray, default=PULSE)

    def __call__(self, t, omega):
        return jnp.where((t > self.times[0]) & (t < self.times[1]), self.torque, 0.0)


@pytest.mark.parametrize(
    "top",
    [
        dt.TransverseReduced(-0.2),
        pytest.param(dt.TransverseSemi(-0.2), marks=pytest.mark.slow),
        pytest.param(dt.TransverseFull(-0.2), marks=pytest.mark.slow),
    ],
)
def test_a_short_pulse_is_not_stepped_over(top):
    """Along the dipole nothing radiates, so ω₁ rises by ∫M dτ and keeps it."""
    half = Pulse(jnp.array([0.5, 0.0, 0.0]))
    pulsed = torques.with_torque(top, half, jumps=PULSE)
    pulsed = torques.with_torque(pulsed, half, jumps=PULSE)  # both jump at the same times
    run = dt.simulate(pulsed, [0.05, 0.0, 0.0], [0.0, 49.0, 50.005, 100.0], balance=True)
    np.testing.assert_allclose(run.omega[:, 0], [0.05, 0.05, 0.055, 0.06], rtol=1e-9)
    np.testing.assert_allclose(run.work[-1], (0.06**2 - 0.05**2) / 2, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("first", [3.0, 37.0])  # within the first window, and behind it
@pytest.mark.parametrize("level", [dt.TransverseFull(-0.2), dt.Full(dt.axisymmetric(-0.2))])
def test_a_body_moves_before_a_jump_as_the_bounded_solution_does(level, first):
    """A slow rotator about axis 3: Iω′ = M + ω″, so ω′ = ∫M(s) e^{−I(s − τ)} ds from τ on."""
    inertia, torque = 1.2, 1e-8
    push = Pulse(jnp.array([0.0, 0.0, torque]), [first, first + 4.0])
    ts = np.append(0.0, first + np.array([-1.0, -0.1, 0.0, 2.0, 3.9, 4.0, 6.0]))

    def after(start):  # ω of a torque that acts from `start` on
        late = np.maximum(ts - start, 0.0)
        return torque / inertia * (np.exp(-inertia * np.maximum(start - ts, 0)) / inertia + late)

    run = dt.simulate(torques.with_torque(level, push, jumps=push.times), np.zeros(3), ts)
    exact = after(first) - after(first + 4.0)
    np.testing.assert_allclose(run.omega[:, 2], exact - exact[0], rtol=1e-9, atol=1e-18)


def fast(y):
    """RESIDUAL once ω₁ > 0.052."""
    return jnp.where(y[0] > 0.052, int(Outcome.RESIDUAL), 0), y[0], (y[0] > 0.052) & False


def pulsed(size):
    """A top on which a pulse along its dipole acts."""
    pulse, top = Pulse(jnp.stack([size, 0 * size, 0 * size])), dt.TransverseSemi(-0.2)
    return torques.with_torque(top, pulse, verdict=fast, jumps=PULSE)


@pytest.mark.slow
def test_single_runs_and_their_derivatives_see_a_pulse():
    """ω₁ = 0.05 + M·0.01."""
    start, size = [0.05, 0.0, 0.0], jnp.asarray(0.5)
    found = jax.jit(lambda size: dt.classify(pulsed(size), start).omega_inf)(size)
    assert found == pytest.approx(0.055, rel=1e-9)
    slope = jax.grad(lambda size: dt.residual_rotation(pulsed(size), start))(size)
    assert slope == pytest.approx(0.01, rel=1e-7)


@pytest.mark.parametrize("engine", ["native", pytest.param("jax", marks=pytest.mark.slow)])
def test_a_sweep_does_not_step_over_a_pulse(engine):
    def problem(size):
        return pulsed(size), jnp.array([0.05, 0.0, 0.0])

    sizes, settings = np.array([0.1, 0.5, 2.0]), {"value": "unchecked", "max_steps": 100}
    basin = dt.sweep(problem, dt.Grid(size=sizes), engine=engine, **settings)
    np.testing.assert_array_equal(basin.outcome == Outcome.RESIDUAL, [False, True, True])
    np.testing.assert_allclose(basin.omega_inf[1:], 0.05 + 0.01 * sizes[1:], rtol=1e-9)
    np.testing.assert_array_equal(basin.time[1:], 50.01)
