"""Many runs: exact cases, an independent integrator, batches, faults, refusals."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from settling import FIGURE_2A, Settling, starts

import dipoletop as dt
from dipoletop import Outcome, Stop

RESIDUAL, STOP = Outcome.RESIDUAL, Outcome.STOP


@pytest.mark.parametrize("delta", [-1.0, -0.7, -0.5, -0.3, 0.0, 0.4, 0.95])
@pytest.mark.parametrize("size", [1e-30, 1e-3, 1.0, 10.0])
def test_exact_cases_of_order_one(delta, size):
    """Invariant sets: rest, ω⊥ = 0, ω₁ = ω₃ = 0 stop; ω₃ = 0 keeps ω₁; so does δ = 0."""
    cases = {
        (0.0, 0.0, 0.0): (STOP, 0.0),
        (0.0, 0.0, 1.0): (STOP, 0.0),
        (0.0, -1.0, 0.0): (STOP, 0.0),
        (1.0, 0.0, 0.0): (RESIDUAL, 1.0),
        (-0.6, 0.8, 0.0): (RESIDUAL, -0.6),
        (1e-9, 1.0, 0.0): (RESIDUAL, 1e-9),
    }
    if delta == 0:
        cases |= {(0.6, 0.3, 0.8): (RESIDUAL, 0.6), (0.0, 0.3, 0.8): (STOP, 0.0)}
    omegas = size * np.array(list(cases))
    found = dt.classify_many(dt.TransverseReduced(delta), omegas)
    assert found.outcome.tolist() == [outcome for outcome, _ in cases.values()]
    assert np.array_equal(found.omega_inf, size * np.array([w for _, w in cases.values()]))
    assert np.all(found.certified)
    assert np.all(found.steps == 0)


def test_a_value_that_is_not_known_to_the_tolerance_is_not_given():
    omegas = starts(200, 21, 0.2, 0.5)
    only = dt.classify_many(dt.TransverseSemi(0.3), omegas, value=False)
    whole = dt.classify_many(dt.TransverseSemi(0.3), omegas)
    assert np.array_equal(only.outcome, whole.outcome)
    assert not np.any(np.isnan(whole.omega_inf))
    given = ~np.isnan(only.omega_inf)
    assert np.sum(~given) > 0
    assert np.allclose(only.omega_inf[given], whole.omega_inf[given], rtol=1e-6)


@pytest.mark.parametrize("delta", [-1.0, -0.5, 0.0, 0.4, 0.8])
def test_exact_cases_of_the_semi_reduced_level(delta):
    """ω₃ = 0 is not invariant here; the axes and the residual line are."""
    omegas = [[0, 0, 0], [0, 0, 0.3], [0, 0.3, 0], [0.3, 0, 0]]
    found = dt.classify_many(dt.TransverseSemi(delta), omegas)
    assert found.outcome.tolist() == [STOP, STOP, STOP, RESIDUAL]
    assert found.omega_inf.tolist() == [0, 0, 0, 0.3]
    assert np.all(found.certified)
    assert np.all(found.stop[:3] == Stop.AXIS)


def test_oblate_bodies_beyond_one_half_stop_at_order_one():
    found = dt.classify_many(dt.TransverseReduced(-0.6), starts(200, 1, 1e-3, 3))
    assert np.all(found.outcome == STOP)
    assert np.all(found.stop == Stop.ROTATING)
    # No such threshold at the consistent level.
    semi = dt.classify_many(dt.TransverseSemi(-0.6), starts(200, 1, 0.1, 1))
    assert set(semi.outcome) == {RESIDUAL, STOP}


def test_needles_wobble_to_a_stop():
    """Three fates at the semi-reduced level; wobbling only above δ = 0.7532357993909."""
    omegas = starts(400, 2, 0.02, 0.1)
    found = dt.classify_many(dt.TransverseSemi(0.9), omegas)
    assert set(found.outcome) == {RESIDUAL, STOP}
    assert set(found.stop[found.outcome == STOP]) == {Stop.WOBBLING}
    assert np.all(dt.classify_many(dt.TransverseSemi(0.7), omegas).outcome == RESIDUAL)
    assert np.all(dt.classify_many(dt.TransverseReduced(0.9), omegas).outcome == RESIDUAL)


def direct(level, delta, omega, rtol=1e-12):
    """Label by scipy's DOP853, with no region: a long run and a look at where it went.

    A residual top has put its velocity along the dipole; a stopping one goes on turning.
    """
    equation = level(delta)
    run = jax.jit(lambda y: equation(0.0, y))
    rate = lambda t, y: np.asarray(run(y))  # noqa: E731
    size, y = np.linalg.norm(omega), omega
    span = 30 / size**2
    for _ in range(12):
        y = solve_ivp(rate, (0, span), y, "DOP853", rtol=rtol, atol=1e-15 * size).y[:, -1]
        w = np.linalg.norm(y)
        t, z = y[1] / y[0], y[2] / y[0] ** 2
        if t**2 + (delta * z) ** 2 < 1e-6:
            return RESIDUAL
        u = y[0] ** 2 + y[1] ** 2
        if abs(delta * y[2]) > 30 * u and abs(y[2]) < 0.2:  # rotation has won by far
            return STOP
        span = 30 / w**2
    return Outcome.UNDECIDED


@pytest.mark.parametrize("level", [dt.TransverseReduced, dt.TransverseSemi])
def test_labels_equal_an_independent_integrator(level):
    """A dozen random starts to their bitter end, with no certificate at all."""
    rng = np.random.default_rng(7)
    deltas = rng.uniform(-0.45, -0.15, 12)
    omegas = starts(12, 8, 0.1, 0.5)
    found = dt.classify_many(level(jnp.asarray(deltas)), omegas).outcome
    expected = [direct(level, d, w) for d, w in zip(deltas, omegas, strict=True)]
    assert found.tolist() == expected


@pytest.mark.parametrize("level", [dt.TransverseReduced, dt.TransverseSemi])
def test_certificates_are_not_contradicted_by_a_tighter_tolerance(level):
    rng = np.random.default_rng(13)
    deltas = rng.uniform(0.05, 0.95, 3000) * rng.choice([-1, 1], 3000)
    deltas, omegas = jnp.asarray(deltas), starts(3000, 14, 1e-2, 1)
    loose = dt.classify_many(level(deltas), omegas, value=False)
    tight = dt.classify_many(level(deltas), omegas, rtol=1e-11)
    assert np.array_equal(loose.outcome, tight.outcome)
    assert np.mean(loose.outcome == Outcome.UNDECIDED) < 2e-3
    assert loose.steps.mean() < tight.steps.mean()


@pytest.mark.slow
def test_second_order_agrees_with_the_semi_reduced_level_at_small_amplitude():
    rng = np.random.default_rng(15)
    deltas, omegas = jnp.asarray(rng.uniform(-0.9, 0.5, 400)), starts(400, 16, 0.01, 0.03)
    second = dt.classify_many(dt.TransverseReduced(deltas, order=2), omegas)
    semi = dt.classify_many(dt.TransverseSemi(deltas), omegas)
    assert not np.any(second.certified)
    assert np.mean(second.outcome != semi.outcome) < 0.01
    same = (second.outcome == RESIDUAL) & (semi.outcome == RESIDUAL)
    gap = np.abs(second.omega_inf - semi.omega_inf)[same] / np.linalg.norm(omegas, axis=1)[same]
    assert np.median(gap) < 1e-2


def test_batched_bodies_have_their_axis_in_front():
    """As many bodies as a tensor has rows: the one shape that could be taken for another."""
    inertia = np.stack([np.diag(moments) for moments in np.eye(3) + 1.0])
    bodies, omegas = dt.Body(inertia, np.array([1.0, 0.0, 0.0])), starts(3, 18, 0.2, 0.3)
    batch = dt.classify_many(Settling(bodies), omegas, value="unchecked")
    assert len(np.unique(batch.time)) == 3
    for k in range(3):  # inertia (3, 3), N = 3
        body = jax.tree.map(lambda leaf, k=k: leaf[k], bodies)
        single = dt.classify_many(Settling(body), omegas, value="unchecked")
        for name in ("outcome", "omega_inf", "time"):
            assert getattr(single, name)[k] == getattr(batch, name)[k]


class Mistaken(Settling):
    """An equation with a fault of its author's."""

    def __call__(self, t, y, args=None):
        return self.body.no_such_thing * y


class Geared(Settling):
    """Ω̇ = −gΩ with whole numbers g."""

    gears: jax.Array

    def __call__(self, t, y, args=None):
        return -self.gears.astype(y.dtype) * y


def test_whole_numbers_of_an_equation_have_lanes_in_a_trace_too():
    geared = Geared(dt.Body(np.eye(3), [1.0, 0, 0]), jnp.array([1, 2, 3]))
    start = jnp.array([0.5, 0.3, 0.2])
    traced, known = eqx.filter_jit(dt.classify)(geared, start), dt.classify(geared, start)
    assert traced.steps == known.steps > 0
    np.testing.assert_allclose(traced.omega_inf, known.omega_inf, rtol=1e-8)


def test_a_fault_of_an_equation_is_not_taken_for_a_batch():
    equation = Mistaken(dt.axisymmetric(-0.2))
    several = Mistaken(dt.axisymmetric(jnp.array([-0.2, -0.1])))
    for call in (
        lambda: dt.classify_many(equation, jnp.ones((2, 3))),
        lambda: dt.classify_many(several, jnp.ones((2, 3))),
        lambda: dt.classify(equation, jnp.ones(3)),
    ):
        with pytest.raises(AttributeError, match="no_such_thing"):
            call()


class OneState(Settling):
    """Ω̇ = −GΩ, written for one state only."""

    matrix: jax.Array

    def __call__(self, t, y, args=None):
        return -self.matrix @ y


def test_an_error_says_which_shapes_an_equation_must_take():
    start = jnp.array([0.1, 0.2, 0.3])
    one = OneState(dt.axisymmetric(0.5), jnp.eye(3))
    lanes_last = jax.vmap(dt.axisymmetric, out_axes=-1)(jnp.ones(2) / 2)
    for call, must in (
        (lambda: dt.classify(one, start), r"^OneState .* of shape \(3, lanes\); .*in components"),
        (lambda: jax.jit(lambda w: dt.classify(one, w))(start), r"^OneState .*in components"),
        (
            lambda: dt.classify_many(dt.SemiReduced(lanes_last), jnp.stack([start, start])),
            r"^SemiReduced must .* have the axis of the batch in front",
        ),
    ):
        with pytest.raises((TypeError, ValueError)) as caught:
            call()
        assert any(re.search(must, note) for note in caught.value.__notes__)


@pytest.mark.parametrize("most", [2**31 - 1, np.int64(2**31 - 1), np.uint32(2**31 - 1)])
def test_the_largest_budget_is_one(most):
    found = dt.classify_many(dt.TransverseReduced(-0.2), FIGURE_2A[None], max_steps=most)
    assert found.outcome.tolist() == [RESIDUAL]
    assert found.steps[0] > 1


@pytest.mark.parametrize("engine", [pytest.param("jax", marks=pytest.mark.slow), "native"])
def test_subnormal_components_are_not_taken_for_zero(engine):
    """On a processor JAX compares them as 0, which would put these starts on invariant sets."""
    omegas = np.array([[0.3, 0.3, 1e-312], [1e-310, 0.0, 0.0], [0.3, 0.3, 0.0], [0.0, 0.0, 0.1]])
    found = dt.classify_many(dt.TransverseReduced(-0.3), omegas, engine=engine)
    failed = dt.Outcome.FAILED
    assert list(found.outcome) == [failed, failed, dt.Outcome.RESIDUAL, dt.Outcome.STOP]
    message = r"`omega0` must have components that are 0 or at least 2\.2e-308 .*, but has 1e-312"
    with pytest.raises(ValueError, match=message):
        dt.classify(dt.TransverseReduced(-0.3), omegas[0])
