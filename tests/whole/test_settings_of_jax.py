"""Numbers do not depend on JAX's settings, nor on the context in which a call is made."""

import pickle

import jax
import numpy as np
import pytest

import dipoletop as dt

TOP = dt.TransverseSemi(-0.2)
STARTS = np.array([[0.2, 0.1, 0.1], [0.1, 0.2, 0.3]])


def problem(w3):
    return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, 0.3)


def test_worker_threads_compute_in_the_precision_of_the_caller():
    grid = dt.Grid(w3=np.linspace(0.0, 0.4, 5))
    expected = dt.sweep(problem, grid)
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            found = dt.sweep(problem, grid)
    finally:
        jax.config.update("jax_enable_x64", True)
    np.testing.assert_array_equal(found.omega_inf, expected.omega_inf)


@pytest.mark.parametrize("debug", [jax.debug_nans, jax.debug_infs])
def test_numbers_that_are_not_known_are_no_errors(debug):
    with debug(True):
        found = dt.classify_many(TOP, [*STARTS, [np.nan, 0.1, 0.1]])
    assert found.outcome[-1] == dt.Outcome.FAILED
    assert np.all(found.outcome[:-1] > 0)


@pytest.mark.parametrize(
    "setting",
    [
        lambda: jax.default_prng_impl("rbg"),
        lambda: jax.threefry_partitionable(False),
    ],
    ids=["generator", "partition"],
)
def test_a_start_depends_on_seed_and_number_only(setting):
    """Not on the tile either, in which other starts are drawn."""
    expected = np.asarray(dt.Sample(100, 0.2, seed=3).points(np.arange(100)))
    with setting():
        found = np.asarray(dt.Sample(100, 0.2, seed=3).points(np.arange(60, 100)))
    np.testing.assert_array_equal(found, expected[60:])


@pytest.mark.parametrize("draw", [None, dt.uniform_box([0.0, 0.0, 0.1], [0.1, 0.2, 0.3])])
def test_a_sample_can_be_sent(draw):
    sample = dt.Sample(5, 0.2, draw=draw)
    again = pickle.loads(pickle.dumps(sample))
    np.testing.assert_array_equal(again.points(np.arange(5)), sample.points(np.arange(5)))
    assert repr(again) == repr(sample)


@pytest.mark.parametrize("kind", [">f8", ">f4", ">i2"])
def test_numbers_of_any_type_and_order_of_bytes(kind):
    starts = (10 * STARTS).astype(kind)
    expected = dt.classify_many(TOP, np.asarray(starts, float))
    np.testing.assert_array_equal(dt.classify_many(TOP, starts).omega_inf, expected.omega_inf)
