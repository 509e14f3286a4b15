"""The programs of the JAX engine lower for GPUs without calls of libraries; no GPU is needed."""

import diffrax
import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop._base.tolerances import Tolerances
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import JaxEngine, _integrate
from dipoletop._runs.classification import classification_of

N = 256
OBLIQUE = jax.tree.map(
    lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, N)),
    dt.Body(jnp.diag(jnp.array([1.0, 1.2, 1.5])), [0.1, 0.2, 0.9]),
)
EQUATIONS = {
    level.value: dt.equation_at(level, jnp.full(N, -0.2))
    for level in dt.Level
    if level is not dt.Level.FULL  # it is followed in windows, by another engine
}
EQUATIONS |= {"any body, order 1": dt.Reduced(OBLIQUE), "any body, semi": dt.SemiReduced(OBLIQUE)}
QUICK = ("order-1", "semi")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in EQUATIONS]
)
def test_runs_and_verdicts_are_exported_for_cuda(name):
    limits = Limits(jnp.asarray(1e-8), jnp.zeros(N), jnp.full(N, jnp.inf), jnp.asarray(1000))
    arrays, static = eqx.partition((EQUATIONS[name], limits), eqx.is_array)
    engine = JaxEngine(diffrax.Dopri8())

    def program(arrays, omegas):
        equation, limits = eqx.combine(arrays, static)
        y0 = equation.lift(omegas)
        ends = _integrate(equation, y0, limits, engine.solver, "value", engine.width)
        return classification_of(equation, ends, Tolerances(limits.rtol, limits.atol))

    exported = jax.export.export(jax.jit(program), platforms=["cuda"])(arrays, jnp.ones((3, N)))
    assert exported.platforms == ("cuda",)
    assert "custom_call" not in exported.mlir_module()
