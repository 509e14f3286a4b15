"""What is computed once: the results are those of the whole function, and the rest is shorter."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.numpy_programs import CALLS
from dipoletop._engines import step
from dipoletop._engines.hoisting import Hoisted
from dipoletop._engines.interface import Limits

LANES = 5


def _mixed(fixed, varying):
    """Operations of every kind: in inner functions, loops, without lanes behind, and constants."""
    a, b = fixed
    x, scalar = varying
    inner = jax.jit(lambda p, q: (jnp.sin(p), p * q))
    sine, product = inner(a[0], x)
    matrix = jnp.swapaxes(jnp.stack([a, a * b[None]]), 0, 1)
    crossed = jnp.sum(jnp.exp(a.T), axis=1)  # exp(a.T) has no lanes behind
    looped = jax.lax.fori_loop(0, 3, lambda _, y: y * jnp.cos(b) + sine, x)
    nodes = jnp.arange(4.0)[:, None] / 4
    return [
        looped + scalar * crossed,
        {"sum": jnp.sum(jnp.where(nodes < b[None], x[None], 0.0), axis=0), "fixed": jnp.tan(b)},
        matrix[0, 1] + product,
    ]


def _arguments(lanes):
    a, b, x = jax.random.uniform(jax.random.key(0), (3, lanes), minval=0.2, maxval=0.9)
    return (jnp.stack([a, b / 2]), b), (x, jnp.asarray(2.0))


@pytest.mark.parametrize("lanes", [1, LANES])
def test_results_are_those_of_the_whole_function(lanes):
    fixed, varying = _arguments(lanes)
    parts = Hoisted(_mixed, fixed, varying)
    kept = jax.jit(parts.once)(fixed)
    result = jax.jit(parts.rest)(fixed, varying, kept)
    jax.tree.map(np.testing.assert_array_equal, result, jax.jit(_mixed)(fixed, varying))
    assert all(array.shape[-1] == lanes for array in kept)


def _names(jaxpr):
    for eqn in jaxpr.eqns:
        yield eqn.primitive.name
        if eqn.primitive.name in CALLS:
            yield from _names(eqn.params[CALLS[eqn.primitive.name]].jaxpr)


def test_what_is_fixed_is_not_computed_again():
    fixed, varying = _arguments(LANES)
    parts = Hoisted(_mixed, fixed, varying)
    rest = jax.make_jaxpr(parts.rest)(fixed, varying, parts.once(fixed)).jaxpr
    names = set(_names(rest))
    assert not {"sin", "tan"} & names  # of fixed numbers
    assert "exp" in names  # has no lanes behind
    assert parts.saved >= 4  # sin, tan, a·b twice; cos is in the loop


def _state(equation):
    lanes = jax.tree.map(lambda x: jnp.stack([x] * LANES, -1), equation)
    starts = 0.2 * jax.random.normal(jax.random.key(1), (3, LANES))
    many = jnp.zeros(LANES)
    limits = Limits(jnp.asarray(1e-8), many, many + jnp.inf, jnp.asarray(100))
    return step.begin(lanes, starts, limits, 8, "value"), (limits.rtol, limits.max_steps)


BODY = dt.Body([[1.7, 0.0, 0.0], [0.0, 1.3, 0.2], [0.0, 0.2, 1.0]], [0.6, 0.0, 0.0])


@pytest.mark.parametrize("equation", [dt.Reduced(BODY), dt.SemiReduced(BODY)])
def test_steps_with_hoisted_results_are_the_same(equation):
    begun, numbers = _state(equation)
    method = diffrax.Dopri8(), "value"

    @jax.jit
    def with_hoisted(state):
        by = step.divided(state, *numbers, *method)
        return step.advance_by(by, step.prepared(state, by), *numbers)

    one, other = with_hoisted(begun), jax.jit(lambda s: step.advance(s, *numbers, *method))(begun)
    assert one.hoisted is not None
    assert np.any(np.asarray(one.y) != np.asarray(begun.y))
    for name in ("y", "f", "t", "h", "steps", "status"):
        expected = np.asarray(getattr(other, name))
        np.testing.assert_allclose(np.asarray(getattr(one, name)), expected, 1e-13, 1e-15)


def test_a_step_of_a_body_loses_what_depends_on_the_body_alone():
    """The angle of its axes, and the averages of the torque on its free rotation."""
    begun, numbers = _state(dt.Reduced(BODY))
    method = diffrax.Dopri8(), "value"

    by = step.divided(begun, *numbers, *method)

    def advance(state):
        return step.advance_by(by, state, *numbers)

    prepared = step.prepared(begun, by)
    names = list(_names(jax.make_jaxpr(advance)(begun).jaxpr))
    left = list(_names(jax.make_jaxpr(advance)(prepared).jaxpr))
    assert {"atan2", "sin", "cos", "tan"} <= set(names)
    assert not {"atan2", "sin", "cos", "tan"} & set(left)
    assert left.count("div") < 0.6 * names.count("div")


def test_short_verdicts_are_left_alone():
    """Their few results would take longer to load than to compute."""
    begun, numbers = _state(dt.TransverseReduced(-0.2))
    by = step.divided(begun, *numbers, diffrax.Dopri8(), "value")
    assert step.prepared(begun, by).hoisted is None
