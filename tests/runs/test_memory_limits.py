"""Blocks that exhaust the memory of a device, and the size of tiles by that memory."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._runs import memory_limits

N = 700
STARTS = np.asarray(dt.Sample(n=N, amplitude=(0.05, 0.4), seed=1).points(np.arange(N)))
TOPS = dt.TransverseSemi(jnp.linspace(-0.6, -0.1, N))
EXHAUSTED = jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes.")


@pytest.fixture
def little_memory(monkeypatch):
    """From here on a device takes no more than so many runs; the sizes that were tried."""
    monkeypatch.setattr(memory_limits, "_fitting", {})
    tried = []

    def limited(engine, most, error):
        classify = engine.classify

        def tight(self, finish, queue, *rest):
            size = queue.omegas.shape[1]
            tried.append(size)
            if size > most:
                raise error
            return classify(self, finish, queue, *rest)

        monkeypatch.setattr(engine, "classify", tight)
        return tried

    return limited


def test_blocks_are_halved_until_they_fit(little_memory):
    settings = {"engine": "native", "slow_flow": False}
    whole = dt.classify_many(TOPS, STARTS, **settings)
    tried = little_memory(NativeEngine, 200, EXHAUSTED)
    parts = dt.classify_many(TOPS, STARTS, **settings)
    for name in ("outcome", "omega_inf", "omega_inf_error", "time", "steps"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert max(tried) > 200
    tried.clear()
    dt.classify_many(TOPS, STARTS, **settings)
    assert max(tried) <= 200  # what is known to be too much is not tried again


def test_a_sweep_goes_on_where_memory_is_short(little_memory):
    def problem(omega0):
        return dt.TransverseSemi(-0.2), omega0

    points = dt.Points(omega0=STARTS)
    whole = dt.sweep(problem, points)
    little_memory(NativeEngine, 200, MemoryError())
    assert dt.sweep(problem, points) == whole


@pytest.mark.parametrize(
    "error", [EXHAUSTED, jax.errors.JaxRuntimeError("INTERNAL: something else")]
)
def test_what_halving_does_not_mend_is_raised(error, little_memory):
    tried = little_memory(NativeEngine, 0, error)
    with pytest.raises(jax.errors.JaxRuntimeError, match=str(error)):
        dt.classify_many(TOPS, STARTS)
    assert len(tried) < 8


def test_tiles_are_as_large_as_memory_allows():
    def device(platform, **stats):
        return SimpleNamespace(platform=platform, memory_stats=lambda: stats or None)

    gpu = device("gpu", bytes_limit=80 * 2**30)
    small = device("gpu", bytes_limit=2**30, bytes_in_use=2**29)
    assert memory_limits.largest_tile([gpu]) == memory_limits.largest_tile([device("gpu")]) == 2**20
    assert memory_limits.largest_tile([gpu, small]) == 2**17  # 2^29 bytes, 2^12 of a start
    assert memory_limits.largest_tile([gpu, device("cpu")]) == memory_limits.TILE
    assert memory_limits.largest_tile([device("gpu", bytes_limit=1)]) == memory_limits.TILE
