"""Slow runs: predictions against integration, what is predicted and what is not, its cost."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settling import Settling

import dipoletop as dt
from dipoletop import Outcome, Regime, Stop
from dipoletop._averaging.untimed_ends import ends_of_many, unknown_ends
from dipoletop._runs import slow_runs
from dipoletop._runs.run_lengths import SlowMotions, slow_motions
from dipoletop._runs.slow_runs import Origins, _stops, errors_of_needles

RESIDUAL, STOP, UNDECIDED = Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED
MOMENTS = np.array([1.0, 1.3, 1.8])
ROWS = np.repeat([0, 2], 8)  # the dipole on the axis of the smallest and of the largest moment
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # of the body's axes
STRENGTH = 2.25  # |d|²
BODIES = dt.Body(np.broadcast_to(TURN @ np.diag(MOMENTS) @ TURN.T, (16, 3, 3)), 1.5 * TURN.T[ROWS])
NEEDLE = dt.TransverseSemi(0.4)


def starts(amplitude):
    """Sixteen starts with |d|²|ω| = amplitude; some of them cross the separatrix."""
    rng = np.random.default_rng(6)
    ways = np.eye(3)[ROWS] * rng.choice([-1, 1], (16, 1)) + rng.uniform(-0.8, 0.8, (16, 3))
    return amplitude / STRENGTH * ways @ TURN.T / np.linalg.norm(ways, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def resolved():
    return dt.classify_many(dt.Reduced(BODIES), starts(1e-3), value="unchecked", slow_flow=False)


@pytest.fixture(scope="module")
def predicted():
    return dt.classify_many(dt.Reduced(BODIES), starts(1e-3), value="unchecked", slow_flow=True)


@pytest.mark.slow
def test_predictions_of_asymmetric_bodies_agree_with_integration(resolved, predicted):
    assert np.all(resolved.regime == Regime.RESOLVED)
    assert np.all(predicted.regime == Regime.SLOW_FLOW)
    done = resolved.outcome == RESIDUAL
    assert np.all(done | (resolved.steps == 50_000))
    assert np.all(predicted.outcome == RESIDUAL)
    assert np.all(predicted.probability == 1)
    known = done & np.isfinite(predicted.omega_inf)  # else the sign is chance, after the separatrix
    assert np.count_nonzero(known & (ROWS == 0)) > 4
    assert np.count_nonzero(known & (ROWS == 2)) > 4
    error = np.abs(predicted.omega_inf - resolved.omega_inf)[known]
    assert np.all(error < predicted.omega_inf_error[known])
    assert np.max(error / np.abs(resolved.omega_inf[known])) < 1e-3
    assert not np.any(predicted.certified)
    assert np.all(predicted.steps == 0)
    assert np.all(np.isnan(predicted.time))


@pytest.mark.slow
def test_predictions_of_a_transverse_top_agree_with_integration():
    """The phase of capture is known where the precession is slow at the start already."""
    rng = np.random.default_rng(2)
    angle = rng.uniform(0, np.pi, 30)
    z = rng.uniform(0.2, 30, 30)
    omegas = np.stack([1e-3 * np.cos(angle), 1e-3 * np.sin(angle), 1e-6 * z], axis=1)
    found = [dt.classify_many(NEEDLE, omegas, slow_flow=slow_flow) for slow_flow in (True, False)]
    assert np.all(found[0].outcome == found[1].outcome)
    both = np.isfinite(found[0].omega_inf) & np.isfinite(found[1].omega_inf)
    both &= found[0].regime == Regime.UNFOLDED
    assert np.count_nonzero(both) > 5
    difference = np.abs(found[0].omega_inf - found[1].omega_inf)[both]
    assert np.max(difference) < 1e-3 * 1e-3


@pytest.mark.slow
def test_the_estimate_of_steps_is_near_the_number(resolved):
    lanes = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, -1), dt.Reduced(BODIES))
    motions, ends, _ = Origins.at_starts(lanes, starts(1e-3).T).predictions(1)
    factor = motions.steps(ends.ratio, 1e-8, False) / resolved.steps
    factor = factor[resolved.outcome == RESIDUAL]
    assert np.max(np.maximum(factor, 1 / factor)) < 4
    assert 0.5 < np.median(factor) < 2


@pytest.mark.parametrize("amplitude", [pytest.param(1e-8, marks=pytest.mark.slow), 1e-25])
def test_the_cost_does_not_depend_on_the_amplitude(amplitude, predicted):
    found = dt.classify_many(dt.Reduced(BODIES), starts(amplitude), value="unchecked")
    assert np.all(found.steps == 0)
    assert np.all(found.regime == Regime.SLOW_FLOW)
    np.testing.assert_allclose(found.omega_inf / amplitude, predicted.omega_inf / 1e-3, rtol=1e-9)
    np.testing.assert_array_equal(found.outcome, predicted.outcome)


def test_only_what_exceeds_the_budget_is_predicted(resolved):
    """What is integrated keeps its bytes; a smaller budget bounds the cost."""
    limit = int(np.median(resolved.steps))
    found = dt.classify_many(dt.Reduced(BODIES), starts(1e-3), value="unchecked", max_steps=limit)
    followed = found.regime == Regime.RESOLVED
    assert np.all(found.outcome == RESIDUAL)
    assert np.max(found.steps) <= limit
    assert np.any(followed)
    assert not np.any(followed & (resolved.steps > limit))
    assert not np.any(~followed & (resolved.steps < 0.3 * limit))
    for name in ("omega_inf", "time", "steps"):
        here, there = getattr(found, name), getattr(resolved, name)
        np.testing.assert_array_equal(here[followed], there[followed])


def test_what_the_first_state_decides_is_not_predicted():
    """On the residual line, on the symmetry axis, and of tops that keep ω along the dipole."""
    omegas = 1e-20 * np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
    found = dt.classify_many(NEEDLE, omegas, slow_flow=True)
    assert found.outcome.tolist() == [RESIDUAL, STOP, STOP]
    assert np.all(found.certified)
    assert np.all(found.regime == Regime.RESOLVED)
    assert found.probability.tolist() == [1, 0, 0]
    for equation in (dt.LongitudinalReduced(0.3), dt.TransverseReduced(0.0)):
        found = dt.classify_many(equation, [[1e-25, 2e-25, 3e-25]], slow_flow=True)
        assert found.regime.tolist() == [Regime.RESOLVED]
        assert found.certified.tolist() == [True]


@pytest.mark.slow
def test_a_certified_label_keeps_its_certificate_beside_a_predicted_value():
    """Near the residual line the first state tells the outcome, but not ω∞ to the tolerance."""
    omegas = np.array([[1e-4, 1e-5, 1e-10]])
    label = dt.classify_many(NEEDLE, omegas, value=False, slow_flow=True)
    whole = dt.classify_many(NEEDLE, omegas, slow_flow=True)
    exact = dt.classify_many(NEEDLE, omegas, slow_flow=False)
    assert (label.regime[0], label.steps[0]) == (Regime.RESOLVED, 0)
    assert label.certified[0]
    assert whole.certified[0]
    assert whole.time[0] == 0
    assert whole.regime[0] == Regime.UNFOLDED
    assert whole.omega_inf_error[0] > 0
    np.testing.assert_allclose(whole.omega_inf, exact.omega_inf, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delta", "probability", "error"),
    [(0.8, 0.826, 0.01), (0.5, 1.0, 1e-6)],
)
def test_chance_is_a_probability(delta, probability, error):
    """The capture of 20 000 needles at uniform phases."""
    found = dt.classify_many(dt.TransverseSemi(delta), [[1e-12, 3e-12, 5e-12]])
    assert found.outcome[0] == (UNDECIDED if probability < 1 else RESIDUAL)
    assert found.regime[0] == Regime.UNFOLDED
    assert abs(found.probability[0] - probability) < error
    assert np.isnan(found.omega_inf[0])  # its sign is chance, too


def test_order_one_has_no_law_of_capture():
    found = dt.classify_many(dt.TransverseReduced(0.4), [[1e-12, 3e-12, 5e-12]], slow_flow=True)
    assert (found.outcome[0], found.regime[0]) == (Outcome.RESIDUAL, Regime.RESOLVED)
    assert found.probability[0] == 1
    assert np.isnan(found.omega_inf[0])


@pytest.mark.slow
def test_one_start_is_predicted_as_many_are():
    start = jnp.array([3e-20, 1e-20, 2e-20])
    one = dt.classify(NEEDLE, start)
    many = dt.classify_many(NEEDLE, start[None])
    for name in ("outcome", "steps", "certified", "stop", "regime", "probability", "omega_inf"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name)[0])
    assert one.probability.shape == ()
    traced = jax.jit(lambda w: dt.classify(NEEDLE, w, max_steps=50))(start)
    assert (int(traced.outcome), int(traced.regime)) == (UNDECIDED, Regime.RESOLVED)


def test_what_no_law_describes_is_not_predicted(monkeypatch):
    """The closed form of its error is that of the averages or of a known phase."""
    rng = np.random.default_rng(3)
    delta = rng.uniform(0.01, 0.9, 40)
    omegas = rng.normal(size=(3, 40)) * 10 ** rng.uniform(-3, 0, 40)
    errors = np.min(errors_of_needles(delta, omegas), axis=0)
    hopeless = errors > 0.5
    assert 5 < np.count_nonzero(hopeless) < 35
    tops = dt.TransverseSemi(jnp.asarray(delta[hopeless]))
    motions = slow_motions(tops, omegas[:, hopeless])
    found = ends_of_many(motions.inertia, motions.dipole, motions.omega)
    np.testing.assert_allclose(errors[hopeless], found.error, rtol=1e-9)

    monkeypatch.setattr(Origins, "predictions", None)
    runs = dt.classify_many(tops, omegas[:, hopeless].T, value=False, max_steps=3)
    assert UNDECIDED in runs.outcome
    runs = dt.classify_many(tops, omegas[:, hopeless].T, slow_flow=True)  # integrates nothing
    assert np.all(runs.steps == 0)


LATE = dt.TransverseSemi(jnp.array([0.052068353137389216, 0.007262780319462459]))
LATE_STARTS = np.array(
    [[0.00019736, -0.00087547, -0.05035519], [-0.00141275, 0.00813412, 0.15645821]]
)
"""Long runs of tops that brake too fast for a law at their starts, but not after some steps."""


def test_a_long_run_is_predicted_from_where_a_law_holds():
    """The first is known to be long before its budget is spent, the second is not."""
    found = dt.classify_many(LATE, LATE_STARTS)
    assert found.outcome.tolist() == [RESIDUAL, RESIDUAL]
    assert found.regime.tolist() == [Regime.UNFOLDED, Regime.UNFOLDED]
    assert found.steps.tolist() == [5_000, 50_000]
    assert found.probability.tolist() == [1, 1]
    assert not np.any(found.certified)
    assert np.all(np.isnan(found.omega_inf))  # the integration may have changed the phase
    alone = dt.classify_many(LATE, LATE_STARTS, slow_flow=False)
    assert alone.outcome.tolist() == [UNDECIDED, UNDECIDED]
    labels = dt.classify_many(LATE, LATE_STARTS, slow_flow=False, value=False, max_steps=100_000)
    assert labels.outcome.tolist() == [RESIDUAL, RESIDUAL]
    assert labels.certified[0]  # the second one is so slow that its squares underflow


@pytest.mark.slow
def test_a_body_that_brakes_fast_is_predicted_later():
    """Its integration decides after some more steps than the budget has."""
    body = dt.Body(jnp.diag(jnp.array([1.0, 1.54552325, 2.22889574])), jnp.array([1.0, 0.0, 0.0]))
    equation, start = dt.SemiReduced(body), np.array([[0.06402891, 0.17605449, -0.46319728]])
    found = dt.classify_many(equation, start, value=False)
    assert found.outcome[0] == RESIDUAL
    assert found.regime[0] == Regime.SLOW_FLOW
    alone = dt.classify_many(equation, start, value=False, slow_flow=False)
    assert alone.outcome[0] == UNDECIDED
    whole = dt.classify_many(equation, start, value=False, slow_flow=False, max_steps=60_000)
    assert whole.outcome[0] == RESIDUAL


def test_sure_ends_of_tops_are_those_of_the_slow_flow():
    """What is known without a computation equals what averages give."""
    rng = np.random.default_rng(4)
    delta = rng.uniform(0.01, 0.9, 60)
    omegas = rng.normal(size=(3, 60)) * 10 ** rng.uniform(-6, -2, 60)
    origins = Origins.at_starts(dt.TransverseSemi(jnp.asarray(delta)), omegas)
    sure, others = origins._sure_ends()
    assert 20 < np.count_nonzero(~others) < 60
    motions = slow_motions(origins.equation, omegas)
    found = ends_of_many(motions.inertia, motions.dipole, motions.omega)
    for name in ("outcome", "probability", "regime", "omega_inf"):
        here, there = (getattr(ends, name)[~others] for ends in (sure, found))
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sure.error[~others], found.error[~others], atol=1e-4)


def test_ways_to_stop():
    """A top with its dipole across the symmetry axis goes on rotating about that axis."""
    across, oblique = [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]
    cases = [
        (0.5, across, 2, Stop.ROTATING),  # prolate: the symmetry axis is that of J₁
        (-0.5, across, 4, Stop.ROTATING),
        (-0.5, oblique, 4, Stop.AXIS),
        (0.5, across, 4, Stop.AXIS),
        (0.5, oblique, 5, Stop.TUMBLING),
        (0.5, oblique, 6, Stop.TUMBLING),
        (0.9, across, 7, Stop.WOBBLING),
    ]
    deltas, dipoles, numbers, ways = zip(*cases, strict=True)
    inertia = np.stack([np.diag([1.0, 1.0, 1 - delta]) for delta in deltas])
    motions = SlowMotions(inertia, np.array(dipoles), np.ones((len(cases), 3)), True, False)
    unknown = unknown_ends(np.zeros(len(cases)))
    sure = replace(unknown, probability=np.eye(8)[list(numbers)])
    assert _stops(sure, motions).tolist() == list(ways)
    mixed = replace(unknown, probability=np.full((len(cases), 8), 1 / 8))
    assert set(_stops(mixed, motions)) == {Stop.NONE}


OWN = Settling(dt.axisymmetric(0.4))


def test_an_equation_that_is_not_known_is_left_alone():
    for call, start in ((dt.classify, jnp.ones(3)), (dt.classify_many, jnp.ones((1, 3)))):
        with pytest.raises(ValueError, match="motion of Settling is not known"):
            call(OWN, start, slow_flow=True)
    found = dt.classify_many(OWN, jnp.ones((1, 3)), max_steps=1)
    assert (found.outcome[0], found.regime[0]) == (UNDECIDED, Regime.RESOLVED)


def test_a_run_that_is_not_long_after_all_keeps_its_bytes(monkeypatch):
    """It goes on from where it was paused, or begins again with the engine that cannot pause."""
    rng = np.random.default_rng(8)
    delta, omegas = rng.uniform(0.1, 0.4, 64), 0.3 * rng.normal(size=(64, 3))
    tops = dt.TransverseSemi(jnp.asarray(delta))
    monkeypatch.setattr(slow_runs, "FEW", 8)
    monkeypatch.setattr(slow_runs, "PATIENCE_WITH_TOPS", 1e-4)
    for value, engine in ((True, "native"), ("unchecked", "native"), ("unchecked", "jax")):
        settings = {"value": value, "engine": engine}
        found = dt.classify_many(tops, omegas, **settings)
        whole = dt.classify_many(tops, omegas, **settings, slow_flow=False)
        went_on = found.steps > 8
        assert np.count_nonzero(went_on) > 16
        assert np.all(np.isfinite(found.omega_inf) == np.isfinite(whole.omega_inf))
        for name in ("outcome", "omega_inf", "omega_inf_error", "time", "steps"):
            here, there = getattr(found, name), getattr(whole, name)
            np.testing.assert_array_equal(here[went_on], there[went_on])
