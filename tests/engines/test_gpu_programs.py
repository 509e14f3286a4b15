"""The programs of the JAX engine lower for GPUs without calls of libraries; no GPU is needed."""

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop._engines.interface import Limits, Queue
from dipoletop._engines.jax_engine import ON_ACCELERATOR, JaxEngine, _classify
from dipoletop._runs.label_doubt import finish_of

N = 256
OBLIQUE = jax.tree.map(
    lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, N)),
    dt.Body(jnp.diag(jnp.array([1.0, 1.2, 1.5])), [0.1, 0.2, 0.9]),
)
EQUATIONS = {
    "order-1": dt.TransverseReduced(jnp.full(N, -0.2)),
    "order-4": dt.TransverseReduced(jnp.full(N, -0.2), order=4),
    "any body, semi": dt.SemiReduced(OBLIQUE),
}


@pytest.mark.parametrize(
    "name",
    ["order-1", *(pytest.param(n, marks=pytest.mark.slow) for n in ("order-4", "any body, semi"))],
)
def test_runs_and_verdicts_are_exported_for_cuda(name):
    limits = Limits(jnp.asarray(1e-8), jnp.zeros(N), jnp.full(N, jnp.inf), jnp.asarray(1000))
    queue = Queue(EQUATIONS[name], jnp.ones((3, N)), limits, "value")
    assert is_exported_without_calls(queue)


def test_a_block_that_fills_a_gpu_is_exported_for_cuda():
    """The width that is chosen there, with more runs than lanes."""
    n = 2 * ON_ACCELERATOR
    limits = Limits(jnp.asarray(1e-8), jnp.zeros(n), jnp.full(n, jnp.inf), jnp.asarray(1000))
    equation = dt.TransverseReduced(jnp.full(n, -0.2))
    method = JaxEngine().method("cuda")
    assert min(method[1], n) == ON_ACCELERATOR
    assert is_exported_without_calls(Queue(equation, jnp.ones((3, n)), limits, "outcome"))


def is_exported_without_calls(queue):
    """All that `classify` runs: it lifts, integrates and finishes."""
    arrays, static = eqx.partition(queue, eqx.is_array)
    method = JaxEngine().method("cuda")

    def program(arrays):
        return _classify(finish_of(queue.until != "outcome"), eqx.combine(arrays, static), method)

    exported = jax.export.export(jax.jit(program), platforms=["cuda"])(arrays)
    return exported.platforms == ("cuda",) and "custom_call" not in exported.mlir_module()
