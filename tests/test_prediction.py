"""Predictions: against integration turn by turn, exact solutions, and their own balance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Fate
from dipoletop._averaging.histories import slow_history
from dipoletop._averaging.laws import (
    Needle,
    SlowFlow,
    _numbers,
    averaged_end,
    averaged_law_and_end,
)
from dipoletop._averaging.predicted_ends import Start, fields_of
from dipoletop.particles import DEBYE, RADIATION

MOMENTS = np.diag([0.6, 0.75, 1.0])
ON_3, ON_1 = dt.Body(MOMENTS, [0.0, 0.0, 1.0]), dt.Body(MOMENTS, [1.0, 0.0, 0.0])
GRAIN = dt.Particle.cuboid([1e-7, 2e-8, 2.2e-8], [2400 * DEBYE, 0.0, 0.0], density=2000)
ONE = jnp.asarray(np.float64(1))  # of the type that `predict` gives it: one program
STARTS = np.array([[0.3, 0.4, 0.8], [0.9, -0.3, 0.2], [0.2, 0.7, -0.6]])
averaged, transverse = jax.jit(dt.exact.averaged), jax.jit(dt.exact.transverse)


def _approx(value, rel=1e-12):
    return pytest.approx(np.asarray(value), rel=rel, abs=0)  # values may be tiny


def _variables(body, omega):
    return jnp.asarray(np.concatenate([np.ravel(body.inertia), body.dipole, omega]))


def _slow_flow(body, omega, needle=Needle.NO):
    """The prediction by the slow flow alone, whatever its error."""
    return averaged_end(_variables(body, omega), ONE, needle)


@pytest.mark.slow
@pytest.mark.parametrize("body", [ON_3, ON_1], ids=["largest moment", "smallest moment"])
def test_turn_by_turn_integration_tends_to_the_prediction(body):
    """The error of ω∞ falls in proportion to |ω|, and is within the estimate."""
    errors = []
    for amplitude in (1e-2, 1e-3):
        predicted = [_slow_flow(body, amplitude * start) for start in STARTS]
        values, estimates = np.transpose([(one.omega_inf, one.error) for one in predicted])
        runs = dt.classify_many(dt.Reduced(body), amplitude * STARTS, value="unchecked")
        decided = np.isfinite(values) & (runs.outcome == dt.Outcome.RESIDUAL)
        assert decided.any()
        error = np.abs(runs.omega_inf / values - 1)[decided]
        assert np.all(error < estimates[decided])
        errors.append(error)
    assert np.all(errors[1] < 0.2 * errors[0])


@pytest.mark.slow
def test_the_estimate_holds_where_an_oblique_dipole_oscillates():
    """Next to the axis of J₃ the mean rate is small beside products of oscillations nᵢnⱼ."""
    body = dt.Body(jnp.diag(jnp.array([0.356, 0.908, 1.0])), [0.2228, 0.3401, 0.9136])
    start = 4e-3 * jnp.array([0.1, 0.1, 0.99])
    averaged = _slow_flow(body, start)
    times = averaged.half_time * jnp.array([0.0, 0.25, 1.0])
    run = dt.simulate(dt.SemiReduced(body), start, times)
    energy, *_ = slow_history(_variables(body, start), (times[1:], ONE))
    off = np.abs(run.energy[1:] / energy - 1)
    assert np.all(off > 0.2 * float(averaged.error))
    assert np.all(off < float(averaged.error))


@pytest.mark.slow
def test_the_end_does_not_depend_on_the_amplitude():
    ends = [dt.predict(ON_3, scale * STARTS[0]) for scale in (1e-6, 1e-25)]
    assert float(ends[0].ratio) == _approx(ends[1].ratio, rel=1e-13)
    # Times go with 1/ω², energies with ω².
    assert float(ends[1].half_time) == _approx(ends[0].half_time * 1e38, rel=1e-12)
    assert float(ends[1].radiated_energy) == _approx(ends[0].radiated_energy * 1e-38, rel=1e-12)


@pytest.mark.slow
def test_history_begins_and_ends_where_the_prediction_says():
    predicted = dt.predict(ON_3, 1e-20 * STARTS[0])
    history = predicted.history(jnp.array([1e-3, float(predicted.half_time), 1e60]))
    momentum = np.linalg.norm(MOMENTS @ (1e-20 * STARTS[0]))
    lost = np.asarray(history.energy)
    lost = lost[0] - lost
    assert lost[2] == _approx(predicted.radiated_energy, rel=1e-12)
    assert lost[1] == _approx(predicted.radiated_energy / 2, rel=1e-11)
    assert float(history.momentum[2]) == _approx(predicted.ratio * momentum, rel=1e-12)
    assert float(history.speed[2]) == _approx(abs(predicted.omega_inf), rel=1e-12)
    energy = np.asarray(history.shape) * np.asarray(history.momentum) ** 2 / 2
    np.testing.assert_allclose(history.energy, energy, rtol=1e-13)


@pytest.mark.slow
def test_a_dipole_off_its_axis_ends_the_residual_rotation_late():
    """Tilted by ε, the plateau decays as L² = L²ₚ/(1 + t/T), T = J³/(2κε²L²ₚ)."""
    tilt = 1e-4
    aligned = dt.predict(ON_3, 1e-20 * STARTS[0])
    tilted = dt.predict(dt.Body(MOMENTS, [0.0, np.sin(tilt), np.cos(tilt)]), 1e-20 * STARTS[0])
    assert (aligned.outcome, tilted.outcome) == (dt.Outcome.RESIDUAL, dt.Outcome.STOP)
    assert np.isinf(aligned.lifetime)
    assert float(tilted.lifetime) == _approx(1 / (2 * (tilt * aligned.omega_inf) ** 2), rel=1e-3)
    plateau, half = tilted.history(jnp.array([1e-3, 1.0]) * tilted.lifetime).momentum
    assert float(half / plateau) ** 2 == _approx(0.5, rel=2e-3)


@pytest.mark.slow
def test_a_dipole_is_on_its_axis_where_its_length_is_1_to_rounding_only():
    """In SI units n₃ may be 1 − 1e-16; then 1 − n₃² is not 0, but n₁ and n₂ are."""
    moments = jnp.array([0.99, 0.995, 1.0])
    for size in jnp.geomspace(8.0e-27, 8.1e-27, 12):
        grain = dt.Particle(1e-18, 1e-33 * jnp.diag(moments), size * jnp.eye(3)[2])
        start = dt.particles.start(grain, "1 GHz", momentum=[1, 2, 3])
        assert dt.predict(grain, start).outcome == dt.Outcome.RESIDUAL


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    def ratio(moments, omega):
        predicted = dt.predict(dt.Body(jnp.diag(moments), jnp.array([0.0, 0.0, 1.0])), omega)
        return predicted.ratio, predicted

    moments, omega = jnp.diagonal(MOMENTS), 1e-20 * jnp.asarray(STARTS[0])
    slopes_of = jax.grad(ratio, argnums=(0, 1), has_aux=True)
    slopes, _ = slopes_of(moments, omega)
    for axis in (0, 2):
        for k, step in enumerate(np.array([1e-5, 1e-25])[:, None] * np.eye(3)[axis]):
            sides = [
                (moments + s * step, omega) if k == 0 else (moments, omega + s * step)
                for s in (1.0, -1.0)
            ]
            ends = [ratio(*side)[0] for side in sides]
            numeric = (ends[0] - ends[1]) / (2 * step[axis])
            assert float(slopes[k][axis]) == _approx(numeric, rel=1e-6)
    # Where it is traced, a rotation too fast for averages is undecided.
    _, predicted = slopes_of(moments, jnp.asarray(STARTS[0]))
    assert predicted.outcome == dt.Outcome.UNDECIDED
    assert np.isnan(predicted.omega_inf)


def _slopes_and_differences(numbers_of, at, steps):
    """The Jacobian, and differences of values that are computed without a trace."""
    slopes = jax.jacfwd(numbers_of)(jnp.asarray(at)).T
    for k, (slope, size) in enumerate(zip(slopes, steps, strict=True)):
        step = size * np.eye(len(at))[k]
        yield slope, (numbers_of(at + step) - numbers_of(at - step)) / (2 * size)


@pytest.mark.slow
@pytest.mark.parametrize("long", [0.5, 1.6])
@pytest.mark.parametrize("dipole", [(1.0, 0.0, 1.0), (0.0, 0.0, 1.0)])
def test_derivatives_of_a_top_are_those_of_its_neighbours(long, dipole):
    """By each of its moments, also by one of the two equal ones alone, and by ω₀."""

    def numbers_of(numbers):
        body = dt.Body(jnp.diag(numbers[:3]), np.array(dipole))
        found = dt.predict(body, 1e-9 * numbers[3:])
        return jnp.stack([found.half_time, found.ratio, found.radiated_energy])

    at = np.array([1.0, 1.0, long, 0.9, 0.5, 1.0])
    scales = np.asarray(numbers_of(at))
    scales = np.where(scales == 0, 1.0, scales)
    for slope, numeric in _slopes_and_differences(numbers_of, at, [1e-5] * 6):
        np.testing.assert_allclose(slope / scales, numeric / scales, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("third", "omega"), [(1.0, (0.9, 0.5, 1.0)), (0.5, (9e5, 5e5, 1e2))])
def test_derivatives_by_a_dipole_that_turns_among_equal_moments(third, omega):
    """In a sphere, and across the symmetry axis of a needle whose phase is known."""

    def numbers_of(angle):
        dipole = jnp.stack([jnp.cos(angle[0]), jnp.sin(angle[0]), 0.0 * angle[0]])
        body = dt.Body(jnp.diag(jnp.array([1.0, 1.0, third])), dipole)
        found = dt.predict(body, 1e-9 * np.array(omega))
        return jnp.stack([found.omega_inf, found.ratio, found.radiated_energy])

    at = np.array([0.3])
    scales = np.asarray(numbers_of(at))
    ((slope, numeric),) = _slopes_and_differences(numbers_of, at, [1e-6])
    assert np.all(numeric != 0)
    np.testing.assert_allclose(slope / scales, numeric / scales, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("omega", [(9e-10, 5e-10, 1e-9), (9e-4, 5e-4, 1e-7)])
def test_a_known_needle_in_a_program_of_something_else(omega):
    """A random phase, and a known one."""
    known = dt.predict(dt.axisymmetric(0.5), omega)
    ratio = jax.jit(lambda x: x * dt.predict(dt.axisymmetric(0.5), omega).ratio)(2.0)
    assert float(ratio) == _approx(2 * known.ratio, rel=1e-7)


@pytest.mark.slow
def test_derivatives_of_a_needle_captured_by_chance_are_those_of_differences():
    """By δ and by ω₀; also under `jit`, where the half time comes from the whole motion."""

    def numbers_of(numbers):
        found = dt.predict(dt.axisymmetric(numbers[0]), 1e-9 * numbers[1:])
        return jnp.stack([found.half_time, found.ratio, found.radiated_energy])

    at = np.array([0.5, 0.9, 0.5, 1.0])
    scales = np.asarray(numbers_of(at))
    scales = np.where(scales == 0, 1.0, scales)
    traced = jax.jit(jax.jacfwd(numbers_of))(at).T
    steps = [1e-4, *[1e-5] * 3]
    for k, (slope, numeric) in enumerate(_slopes_and_differences(numbers_of, at, steps)):
        np.testing.assert_allclose(slope / scales, numeric / scales, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(traced[k], slope, rtol=1e-8)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_pure_spin_obeys_its_own_law(axis):
    """L² = L₀²/(1 + 2κ(1 − n²)Ω₀²t/J), or residual rotation along the dipole."""
    omega = 1e-3 * jnp.eye(3)[axis]
    predicted = dt.predict(ON_1, omega)
    if axis == 0:
        assert float(predicted.ratio) == 1
        assert float(predicted.omega_inf) == _approx(1e-3)
        return
    moment = MOMENTS[axis, axis]
    assert predicted.probability[2 + axis] == 1
    assert float(predicted.half_time) == _approx(moment / (2 * 1e-6), rel=1e-12)


@pytest.mark.parametrize(("j2", "fate"), [(0.8, Fate.AXIS_3), (0.9, Fate.TUMBLING_LOW)])
def test_a_dipole_on_the_middle_axis_stops_in_spin_or_tumbling(j2, fate):
    """J₁ = .3, J₃ = 1: J₂J₁² = (J₃ − J₂)(J₃ − J₁)² at J₂ = .8448 (`atlases.spin_border`)."""
    body = dt.Body(np.diag([0.3, j2, 1.0]), [0.0, 1.0, 0.0])
    predicted = dt.predict(body, [1e-13, 2e-13, 3e-12])
    assert predicted.probability[fate] == 1
    assert predicted.fate == fate


def test_a_sphere_has_the_exact_solution():
    body, omega = dt.axisymmetric(0.0), jnp.array([0.02, 0.03, -0.01])
    predicted = dt.predict(body, omega)
    assert float(predicted.omega_inf) == _approx(0.02, rel=1e-14)
    times = jnp.array([10.0, 1e3, 1e5])
    exact = transverse(0.0, omega, times)
    speed = predicted.history(times).speed
    np.testing.assert_allclose(speed, np.linalg.norm(exact, axis=1), rtol=1e-12)
    at_half = np.sum(np.square(transverse(0.0, omega, predicted.half_time)))
    assert at_half == _approx((np.sum(np.square(omega)) + 0.02**2) / 2, rel=1e-12)


def test_particles_are_predicted_in_si_units():
    """The same motion as that of the dimensionless body, in units of τ₀ and J₃."""
    omega = 2 * np.pi * 1e9 * STARTS[1]
    predicted = dt.predict(GRAIN, omega)
    moment = GRAIN.inertia.max()
    tau0 = RADIATION * jnp.sum(GRAIN.dipole**2) / moment
    body = dt.Body(GRAIN.inertia / moment, [1.0, 0.0, 0.0])
    plain = dt.predict(body, tau0 * omega)
    assert float(predicted.ratio) == _approx(plain.ratio, rel=1e-12)
    assert float(predicted.half_time) == _approx(plain.half_time * tau0, rel=1e-10)
    assert "rad/s" in repr(predicted)


def test_predictions_as_text():
    """Three rotations of a sphere, of which one is a matter of chance."""
    probability = np.zeros((3, 8))
    probability[[0, 1, 1, 2], [0, 0, 1, 4]] = [1, 0.5, 0.5, 1]
    ratio = np.array([0.5, 0.1, 0.0])
    fields = (
        np.array([1, 1, 2]),
        probability,
        np.array([7.0, np.nan, 0.0]),
        ratio,
        ratio[:, None] * [0.5, 0.75, 1, 1.25, 1.5],
        np.array([7200.0, np.nan, 9.46728e8]),
        np.array([1.0, 1.5, 2.0]),
        np.array([np.inf, np.inf, 1e6]),
        np.array([1, 1, 4]),
        np.array([1e-9, 1e-3, 0.0]),
        np.array([[1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 2, 0, 0.0]] * 3),
    )
    predictions = dt.Prediction(*map(jnp.asarray, fields), strength=RADIATION)
    assert repr(predictions).splitlines() == [
        "Prediction(3 starts: quantiles 0.1, 0.5, 0.9; 0.667 RESIDUAL, 0.333 STOP; "
        "0.5 POSITIVE, 0.167 NEGATIVE, 0.333 AXIS_3; "
        "0.667 SLOW_FLOW, 0.333 EXACT; error up to 0.001",
        "           ratio=0.2 on average (0, 0.1, 0.625); omega_inf=0, 0, 7 (1 not known) rad/s",
        "           half_time=7200 s (2 hours), 7200 s (2 hours), 9.467e+08 s (30 years) "
        "(1 not known)",
        "           lifetime=1e+06 s (11.6 days), inf s, inf s",
        "           radiated_energy=1, 1.5, 2 J; 0.5, 0.75, 1 of E₀",
        "           in vacuum at temperature 0)",
    ]
    one = jax.tree.map(lambda leaf: leaf[1], predictions)
    assert repr(one).splitlines()[:3] == [
        "Prediction(RESIDUAL; 0.5 POSITIVE, 0.5 NEGATIVE; SLOW_FLOW",
        "           ratio=0.1 ± 0.0001 (0.05, 0.1, 0.15); omega_inf=nan rad/s",
        "           half_time=nan s",
    ]


def test_an_oblate_top_with_its_dipole_across_the_axis_stops():
    predicted = dt.predict(dt.axisymmetric(-0.3), [3e-20, 1e-20, 2e-20])
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.STOP, dt.Regime.AVERAGED)


@pytest.mark.slow
def test_a_needle_across_its_axis_is_captured_from_its_own_phase():
    """ω₃ = 0: no fast rotation that chance could act on; one that there is ends the history."""
    start = jnp.array([9e-4, 5e-4, 0.0])
    predicted = dt.predict(dt.axisymmetric(0.5), start)
    run = dt.classify(dt.TransverseSemi(0.5), start)
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.RESIDUAL, dt.Regime.UNFOLDED)
    assert float(predicted.omega_inf) == _approx(run.omega_inf, rel=float(predicted.error))
    later = dt.predict(dt.axisymmetric(0.5), [9e-20, 5e-20, 5e-20]).history([1.0, 1e39, 1e90])
    assert np.array_equal(np.isnan(later.energy), [False, False, True])


@pytest.mark.slow
def test_the_own_phase_of_a_needle_is_known_only_while_it_turns_little():
    """The plane neglects ω₃² beside ω⊥², and the phase changes by q = 2δ|ω₃|/ω⊥²."""
    needle, start = dt.axisymmetric(0.5), jnp.array([2e-3, 1e-3, 4e-5])
    predicted, run = dt.predict(needle, start), dt.classify(dt.TransverseSemi(0.5), start)
    off = abs(float(predicted.omega_inf / run.omega_inf) - 1)
    assert predicted.regime == dt.Regime.UNFOLDED
    assert 3 * float(jnp.sum(start**2)) < off < float(predicted.error) < 0.01


@pytest.mark.slow
def test_a_rotation_too_fast_for_averages_is_integrated():
    """Up to its end; another integration has the same ω∞, times and energies."""
    with pytest.raises(ValueError, match="`omega0` must be so small that the estimated"):
        dt.predict(ON_3, [1.0, 2.0, 3.0])
    start = jnp.array([8e-3, 2e-3, 3e-3])  # of this needle q = 44, but ω₃²/ω⊥² = 0.13
    predicted = dt.predict(dt.axisymmetric(0.5), start)
    run = dt.classify(dt.TransverseSemi(0.5), start)
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.RESIDUAL, dt.Regime.RESOLVED)
    assert float(predicted.omega_inf) == _approx(run.omega_inf, rel=1e-6)
    half, lost = float(predicted.half_time), float(predicted.radiated_energy)
    times = np.array([0.0, 0.5, 1.0, 200.0]) * half
    energy = dt.simulate(dt.TransverseSemi(0.5), start, times).energy
    np.testing.assert_allclose(predicted.history(times[1:]).energy, energy[1:], rtol=1e-7)
    assert float(energy[0] - energy[2]) == _approx(lost / 2, rel=1e-6)
    assert float(energy[3]) == _approx(predicted.omega_inf**2 / 2, rel=1e-6)


@pytest.mark.slow
def test_a_fast_stop_is_handed_over_to_the_averages():
    """The dipole on the middle moment: E t and E/L² tend to those of tumbling."""
    predicted = dt.predict(dt.Body(MOMENTS, [0.0, 1.0, 0.0]), 0.1 * STARTS[0])
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.STOP, dt.Regime.RESOLVED)
    assert predicted.probability[5] == 1
    times = np.array([1.0, 1e2, 1e8, 1e9]) * float(predicted.half_time)
    history = predicted.history(times)
    first = 0.5 * float(0.01 * STARTS[0] @ MOMENTS @ STARTS[0])
    assert float(history.energy[0]) == _approx(first / 2, rel=1e-6)
    assert np.all(np.diff(history.energy) < 0)
    assert float(history.energy[2] / history.energy[3]) == _approx(10, rel=1e-3)
    slow = dt.predict(dt.Body(MOMENTS, [0.0, 1.0, 0.0]), 1e-9 * STARTS[0])
    later = slow.history([1e10 * float(slow.half_time)])
    assert float(history.shape[3]) == _approx(later.shape[0], rel=1e-3)


@pytest.mark.parametrize(
    ("moments", "dipole", "lifetime"),
    [
        ([0.7, 0.9, 1.2], [0.3, 0.5, 0.8], 8.99596e37),
        ([0.7, 0.9, 1.2], [0.02, 0.01, 1.0], 4.20468e40),
        ([0.45, 0.56, 1.0], [1.0, 1.0, 0.0], np.nan),
    ],
)
def test_late_laws_are_those_of_the_history(moments, dipole, lifetime):
    """1/L² = (t + lifetime)/(lifetime L²ₚ) for large t, unless L falls before h has settled."""
    omega = np.array([0.6, 0.2, 0.4]) / moments
    body = dt.Body(np.diag(moments), dipole / np.linalg.norm(dipole))
    predicted = dt.predict(body, 1e-18 * omega / np.linalg.norm(omega))
    found = float(predicted.lifetime)
    np.testing.assert_allclose(found, lifetime, rtol=1e-5)
    if np.isfinite(lifetime):
        first, second = times = 1e3 * found * np.array([1.0, 10.0])
        one, other = 1 / np.asarray(predicted.history(times).momentum) ** 2
        assert (second * one - first * other) / (other - one) == _approx(found, rel=1e-8)


@pytest.mark.parametrize(("axis", "half"), [(2, 1.21945973388e35), (0, None)])
def test_the_half_time_of_residual_rotation_is_the_limit_of_its_neighbours(axis, half):
    body = dt.Body(np.diag([0.7, 0.9, 1.2]), np.eye(3)[axis])
    start = 1e-18 * np.eye(3)[axis]
    limit = float(dt.predict(body, start).half_time)
    assert half is None or limit == _approx(half, rel=1e-11)
    for tilt, error in ((1e-6, 1e-10), (1e-2, 1e-3)):
        near = dt.predict(body, start + 1e-18 * tilt * np.eye(3)[1])
        assert float(near.half_time) == _approx(limit, rel=error)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [0.5, -0.4])
def test_the_half_time_next_to_a_residual_line_is_that_of_its_linear_law(delta):
    times = [
        float(dt.predict(dt.axisymmetric(delta), [1e-9, tilt * 1e-9, 0.0]).half_time)
        for tilt in (1e-8, 1e-5, 1e-2)
    ]
    assert times[1] == _approx(times[0], rel=1e-6)
    assert times[2] == _approx(times[0], rel=1e-3)
    assert np.isfinite(float(dt.predict(dt.axisymmetric(delta), [1e-9, 0.0, 0.0]).half_time))


@pytest.mark.slow
def test_a_fast_disc_is_handed_over_where_averages_hold():
    """The energies are those of another integrator, up to τ = 1e5."""
    body = dt.Body(np.diag([1.0, 1.0, 1.5335039255357503]), [1.0, 0.0, 0.0])
    start = [-0.0050193098300037944, -0.0544049256197575, 0.01257499866423123]
    predicted = dt.predict(body, start)
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.STOP, dt.Regime.RESOLVED)
    energy = predicted.history([1e3, 3e3, 1e4, 1e5, 1e8]).energy
    expected = [3.688414051e-4, 1.523209980e-4, 5.002409757e-5, 5.16918e-6]
    off = np.abs(np.asarray(energy[:4]) / expected - 1)
    assert np.all(off < float(predicted.error))
    assert off[0] < 1e-7
    assert 0 < energy[4] < 1e-8


@pytest.mark.slow
def test_a_disc_of_known_phase_goes_on_by_the_slow_flow():
    start = [1e-4, -9.95e-4, 4e-6]
    predicted = dt.predict(dt.axisymmetric(-0.3), start)
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.STOP, dt.Regime.UNFOLDED)
    times = np.array([0.0, 1.0, 10.0, 100.0]) * float(predicted.half_time)
    run = dt.simulate(dt.TransverseSemi(-0.3), start, times, max_steps=200_000)
    off = np.abs(np.asarray(predicted.history(times[1:]).energy) / run.energy[1:] - 1)
    assert np.all(off < [1e-5, 0.02, 0.02])  # the run oscillates about its averages
    assert np.all(np.isfinite(np.asarray(predicted.history([1e3 * times[-1]]).energy)))


@pytest.mark.slow
def test_the_late_law_of_a_fast_rotation_counts_from_its_start():
    """The dipole 0.05 off the axis of J₃: 1/L² grows as t + lifetime."""
    body = dt.Body(MOMENTS, [0.0, 0.05, 1.0])
    predicted = dt.predict(body, 0.1 * STARTS[0])
    assert (predicted.outcome, predicted.regime) == (dt.Outcome.STOP, dt.Regime.RESOLVED)
    times = np.array([10.0, 100.0]) * float(predicted.lifetime)
    squares = np.asarray(predicted.history(times).momentum) ** 2
    assert squares[0] / squares[1] == pytest.approx(101 / 11, rel=1e-2)


def _nearly(delta, eta):
    return dt.Body(jnp.diag(jnp.array([1.0, 1 - eta, 1 - delta])), [1.0, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "start", "outcome"),
    [
        (dt.axisymmetric(0.5), [9e-4, 5e-4, 1e-7], dt.Outcome.RESIDUAL),
        (_nearly(0.4, -2e-6), [5e-4, 5e-4, 1e-6], dt.Outcome.STOP),
    ],
    ids=["needle", "dipole on the middle moment"],
)
def test_a_rotation_of_known_phase_has_the_history_of_an_integration(body, start, outcome):
    """Also of bodies whose moments differ by less than the slow flow needs."""
    predicted = dt.predict(body, start)
    assert (predicted.outcome, predicted.regime) == (outcome, dt.Regime.UNFOLDED)
    half = float(predicted.half_time)
    times = np.array([0.1, 1.0, 3.0]) * half
    run = dt.simulate(dt.SemiReduced(body), start, ts=np.append(0.0, times))
    history = predicted.history(times)
    np.testing.assert_allclose(history.energy, run.energy[1:], rtol=1e-5)
    speed = np.linalg.norm(run.omega[1:], axis=1)
    np.testing.assert_allclose(history.speed, speed, rtol=1e-5)
    lost = float(run.energy[0] - run.energy[2])
    assert lost == _approx(predicted.radiated_energy / 2, rel=1e-4)


@pytest.mark.slow
def test_the_error_of_tumbling_next_to_the_separatrix_is_seen_on_the_way():
    """On the middle moment by less than ω²: the slow flow tumbles, the body is captured."""
    body, start = _nearly(0.4, -1e-13), 1e-3 * STARTS[1]
    assert _slow_flow(body, start).outcome == dt.Outcome.UNDECIDED
    predicted = averaged_law_and_end(Start(_variables(body, start), ONE), SlowFlow(Needle.NO))[1]
    assert predicted.regime == dt.Regime.UNFOLDED
    assert predicted.probability[:2].sum() > 0.99
    capture = _slow_flow(_nearly(0.4, 0.0), start, needle=Needle.OF_ANY_PHASE)
    assert float(predicted.ratio) == _approx(capture.ratio, rel=1e-2)


@pytest.mark.slow
def test_a_disc_that_spins_across_its_axis_and_dipole_stops():
    """u = u₀/(1 + 2u₀τ), without any neighbour that ends so."""
    predicted = dt.predict(dt.axisymmetric(-0.2), [0.0, 1e-6, 0.0])
    assert predicted.probability[3] == 1
    assert float(predicted.half_time) == _approx(0.5e12, rel=1e-7)


@pytest.mark.parametrize("delta", [-0.7, pytest.param(0.5, marks=pytest.mark.slow)])
def test_history_of_an_axisymmetric_body_is_that_of_the_averaged_top(delta):
    """The closed solution (4.16)–(4.19), from before braking sets in until long after."""
    omega, times = jnp.array([3e-9, 4e-9, 7e-9]), jnp.array([1e15, 1e17, 1e19, 1e21])
    energy = dt.predict(dt.axisymmetric(delta), omega).history(times).energy
    exact = np.asarray(averaged(delta, omega, times)) ** 2 @ [0.5, 0.5, (1 - delta) / 2]
    np.testing.assert_allclose(energy, exact, rtol=1e-12)


@pytest.mark.parametrize("omega", [[np.nan, 1e-20, 1e-20], [np.inf, 1e-20, 1e-20]])
def test_what_is_no_number_fails_at_once(omega):
    """As a lane of a traced batch may hold."""
    assert _slow_flow(ON_3, np.array(omega)).outcome == dt.Outcome.FAILED


@pytest.mark.slow
def test_a_quadrature_that_fails_is_no_prediction(monkeypatch):
    monkeypatch.setattr("dipoletop._averaging.stages.MOST_PANELS", 5)

    @eqx.filter_jit
    def anew(variables, needle):
        return fields_of(_numbers(needle, variables, ONE, None))

    predicted = anew(_variables(ON_3, 1e-20 * STARTS[0]), Needle.NO)
    assert predicted.outcome == dt.Outcome.FAILED
    assert np.isnan(predicted.ratio)
    assert np.isnan(predicted.omega_inf)
    # The capture of a needle does not depend on the way to it; its time does.
    needle = dt.Body(np.diag([0.6, 1.0, 1.0]), [0.0, 1.0, 0.0])
    captured = anew(_variables(needle, [3e-20, 1e-20, 2e-20]), Needle.BY_CHANCE)
    assert captured.ratio > 0
    assert np.isnan(captured.half_time)
