"""Sweeps of slow runs: what is predicted, what is integrated, and sweeps that are resumed."""

import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome, Regime
from dipoletop._maps.columns import COLUMNS

GRID = dt.Grid(amplitude=np.geomspace(1e-25, 1e-1, 25), theta=np.linspace(0.1, 1.4, 40))


def needle(amplitude, theta):
    way = jnp.stack([jnp.sin(theta) * 0.8, jnp.sin(theta) * 0.6, jnp.cos(theta)])
    return dt.TransverseSemi(0.85), amplitude * way


@pytest.fixture(scope="module")
def slow():
    return dt.sweep(needle, GRID, max_steps=300)


@pytest.mark.slow
def test_columns_of_predicted_starts(slow):
    assert list(slow.columns) == list(COLUMNS)
    assert slow.attrs["slow_flow"] == "auto"
    assert slow.regime.dtype == np.int8
    assert set(np.unique(slow.regime)) == {Regime.RESOLVED, Regime.UNFOLDED}
    predicted = slow.regime != Regime.RESOLVED
    assert np.all(predicted[0])
    chance = predicted & (slow.outcome == Outcome.UNDECIDED)
    assert np.count_nonzero(chance) > 400
    assert np.all((slow.probability[chance] > 0.7) & (slow.probability[chance] < 0.85))  # 0.778
    assert np.all(np.isnan(slow.time[chance]))
    assert not np.any(slow.certified[predicted & (slow.outcome == Outcome.UNDECIDED)])
    assert np.all(slow.probability[slow.outcome == Outcome.RESIDUAL] == 1)
    assert np.all(slow.probability[slow.outcome == Outcome.STOP] == 0)
    assert np.max(slow.steps) <= 300
    assert slow.to_xarray()["regime"].attrs["flag_meanings"].endswith("EXACT")


@pytest.mark.slow
def test_without_predictions_every_run_is_integrated(slow):
    plain = dt.sweep(needle, GRID, max_steps=300, slow_flow=False)
    assert list(plain.columns) == list(COLUMNS)
    assert plain.attrs["slow_flow"] is False
    assert np.all(plain.regime == Regime.RESOLVED)
    expected = np.where(plain.outcome == Outcome.RESIDUAL, 1.0, 0.0)
    expected[plain.outcome == Outcome.UNDECIDED] = np.nan
    np.testing.assert_array_equal(plain.probability, expected)
    followed = slow.regime == Regime.RESOLVED
    assert np.count_nonzero(followed) > 50
    for name in COLUMNS:
        np.testing.assert_array_equal(plain.column(name)[followed], slow.column(name)[followed])
    assert np.min(plain.steps[~followed]) > 100
    assert np.mean(plain.outcome[~followed] == Outcome.UNDECIDED) > 0.9


@pytest.mark.slow
def test_an_interrupted_sweep_with_predictions_is_resumed_to_the_same_bytes(slow, tmp_path):
    store = tmp_path / "new.zarr"
    dt.sweep(needle, GRID, max_steps=300, store=store)
    assert (store / "outcome/c/2/0").is_file()
    for name in (*slow.columns, "dipoletop-tiles/done"):
        (store / name / "c/1/0").unlink()
    again = dt.sweep(needle, GRID, max_steps=300, store=store)
    for name in slow.columns:
        np.testing.assert_array_equal(again.column(name), slow.column(name))


@pytest.mark.slow
def test_a_refined_map_keeps_regimes_and_probabilities(slow):
    grid = dt.Grid(amplitude=np.geomspace(1e-12, 1e-11, 9), theta=np.linspace(0.1, 1.4, 9))
    refined = dt.adaptive.refine(needle, grid, max_steps=300)
    whole = dt.sweep(needle, grid, max_steps=300)
    np.testing.assert_array_equal(refined.regime, whole.regime)
    np.testing.assert_allclose(refined.probability, whole.probability, atol=1e-6)
