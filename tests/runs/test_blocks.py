"""Runs in two passes: labels are those of one pass at the tolerance that was asked for."""

import jax.numpy as jnp
import numpy as np
import pytest
from settling import Settling

import dipoletop as dt
from benchmarks import engines
from benchmarks.accuracy import label_doubt
from benchmarks.problems.random_bodies import directions
from dipoletop import Outcome
from dipoletop._runs import blocks

NEEDLES = 20_000


def tops(n, deltas, sizes):
    """Shapes and isotropic starts, |ω| log-uniform."""
    rng = np.random.default_rng(3)
    ways = directions(n, rng)
    starts = np.exp(rng.uniform(*np.log(sizes), (n, 1))) * ways
    return jnp.asarray(rng.uniform(*deltas, n)), starts


def bodies(n):
    """Bodies in principal axes, the dipole along one of them or along none."""
    rng = np.random.default_rng(4)
    moments = np.sort(rng.uniform(0.4, 1, (n, 3)), axis=1)
    moments[:, 2] = np.minimum(moments[:, 2], moments[:, 0] + moments[:, 1])
    dipoles = np.eye(3)[rng.integers(0, 3, n)]
    dipoles[::4] = rng.normal(size=dipoles[::4].shape)
    return dt.Body(moments[:, :, None] * np.eye(3), dipoles)


def in_one_pass(*args, **settings):
    """The same as `classify_many`, every run at the tolerance that is asked for."""
    with engines.driven(once=True):
        return dt.classify_many(*args, value=False, **settings)


def near_boundary(level, deltas, sizes):
    """Tops nearer and nearer to the boundary, and their labels in one pass, by bisection."""
    deltas, starts = tops(2000, deltas, sizes)
    case = label_doubt.Case(dt.equation_at(level, deltas), starts)
    rounds = list(label_doubt.closing_in(case, np.random.default_rng(5), rtol=1e-8))
    deltas = np.concatenate([middle.equations.delta for middle, _ in rounds])
    starts = np.concatenate([middle.omegas for middle, _ in rounds])
    return jnp.asarray(deltas), starts, np.concatenate([labels for _, labels in rounds])


@pytest.mark.parametrize("level", ["order-1", "semi"])
@pytest.mark.parametrize(
    ("deltas", "sizes"), [((-0.99, -0.01), (0.01, 0.4)), ((0.01, 0.7), (0.05, 0.4))]
)
def test_labels_are_those_of_one_pass(level, deltas, sizes):
    deltas, starts = tops(NEEDLES, deltas, sizes)
    equation = dt.equation_at(level, deltas)
    settings = {"max_steps": 1000, "slow_flow": False}
    two = dt.classify_many(equation, starts, value=False, **settings)
    one = in_one_pass(equation, starts, **settings)
    for name in ("outcome", "certified", "stop"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    assert np.mean(two.steps) < np.mean(one.steps) or not np.any(one.steps)
    given = ~np.isnan(two.omega_inf)
    np.testing.assert_array_equal(given, ~np.isnan(one.omega_inf))


@pytest.mark.parametrize(
    ("level", "deltas", "sizes"),
    [
        # The certified region of order 1 reaches up to the boundary.
        ("order-1", (-0.5, -0.01), (3e-3, 1)),
        # Needles turn often before they are captured: of all tops their labels need most care.
        pytest.param("semi", (0.76, 0.98), (1e-3, 0.05), marks=pytest.mark.slow),
    ],
)
def test_labels_near_the_boundary_are_made_again(level, deltas, sizes, monkeypatch):
    deltas, starts, expected = near_boundary(level, deltas, sizes)
    settings = {"value": False, "max_steps": 4000, "slow_flow": False}
    equation = dt.equation_at(level, deltas)
    found = dt.classify_many(equation, starts, **settings)
    np.testing.assert_array_equal(found.outcome, expected)
    monkeypatch.setattr(blocks, "CERTAIN", np.nan)  # nothing is made again
    careless = dt.classify_many(equation, starts, **settings)
    assert np.count_nonzero(careless.outcome != expected) > 5
    if level == "semi":  # with `confirm` every start is run again at that tolerance, in one pass
        points = dt.Points(delta=deltas, omega=starts)
        by_points = lambda delta, omega: (dt.TransverseSemi(delta), omega)  # noqa: E731
        careless = dt.sweep(by_points, points, value=False, confirm=1e-9)
        assert np.count_nonzero(careless.changed) > 5


@pytest.mark.slow
def test_labels_of_bodies_are_those_of_one_pass():
    _, starts = tops(600, (0, 1), (0.05, 0.5))
    equation = dt.SemiReduced(bodies(600))
    settings = {"max_steps": 2000, "slow_flow": False}
    found = dt.classify_many(equation, starts, value=False, **settings)
    expected = in_one_pass(equation, starts, **settings)
    assert {Outcome.RESIDUAL, Outcome.STOP} <= set(expected.outcome)
    np.testing.assert_array_equal(found.outcome, expected.outcome)


@pytest.mark.slow
def test_the_jax_engine_makes_one_pass():
    """A second one would begin all runs again, since a program is compiled for their number."""
    deltas, starts = tops(300, (-0.9, 0.9), (0.02, 0.5))
    settings = {"max_steps": 500, "slow_flow": False}
    found = dt.classify_many(
        dt.TransverseSemi(deltas), starts, value=False, engine="jax", **settings
    )
    one = in_one_pass(dt.TransverseSemi(deltas), starts, engine="native", **settings)
    np.testing.assert_array_equal(found.outcome, one.outcome)
    assert np.mean(found.steps != one.steps) < 0.02


def test_equations_that_are_not_known_are_run_in_one_pass():
    equation, starts = Settling(dt.axisymmetric(0.4)), np.full((8, 3), 0.3)
    found = dt.classify_many(equation, starts, value=False, max_steps=50)
    expected = in_one_pass(equation, starts, max_steps=50)
    np.testing.assert_array_equal(found.steps, expected.steps)


def test_a_start_at_rest_and_a_start_without_a_number():
    starts = [[0.0, 0, 0], [np.nan, 0, 0], [1e-200, 1e-200, 1e-200]]
    found = dt.classify_many(dt.TransverseSemi(-0.2), starts, value=False, max_steps=100)
    assert found.outcome.tolist()[:2] == [Outcome.STOP, Outcome.FAILED]
