"""Programs run in NumPy give the bits of JAX's single operations, and leave the rest to JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base import numpy_programs
from dipoletop._base.numpy_programs import NumpyProgram

SMALL = np.finfo(float).tiny
NUMBERS = np.array(
    [0.0, -0.0, 1.0, -2.5, 3.5, 1e-310, -1e-310, SMALL, 3 * SMALL, 1e308, np.inf, -np.inf, np.nan]
)
RANDOM = np.concatenate([np.random.default_rng(0).normal(size=200) * 10, NUMBERS])

PROGRAMS = {
    "arithmetic": lambda x: (x + x[::-1], x - x[::-1], x * x[::-1], x / x[::-1], -x, jnp.abs(x)),
    "quotients": lambda x: (x / 1.1, x / jnp.asarray(1e300), 1.1 / x, x[0] / x[1], x / x.sum()),
    "small": lambda x: (x * 1e-300, x * SMALL, x / 1e300, SMALL - x),
    "remainders": lambda x: (jnp.mod(x, 4.0), jax.lax.rem(x, jnp.full_like(x, -1.5))),
    "rounding": lambda x: (jnp.round(x), jax.lax.round(x), jnp.floor(x), jnp.ceil(x)),
    "comparisons": lambda x: (x < x[::-1], x >= 0, x == 0, x != 0, ~jnp.isfinite(x)),
    "flags": lambda x: ((x > 0) & (x < 1), (x > 0) | (x < -1), (x > 0) ^ (x > 1), x > 0),
    "choices": lambda x: (
        jnp.where(x > 0, x, -1.0),
        jnp.select([x > 1, x > 0, x < -1], [x, 2 * x, -x], 7.0),
    ),
    "moves": lambda x: (
        jnp.stack([x, 2 * x], axis=1),
        jnp.concatenate([x[2:], x[:2]]),
        jnp.broadcast_to(x[:, None], (x.size, 2)).T,
        x.reshape(1, -1),
    ),
    "functions": lambda x: (jnp.sin(x), jnp.sqrt(jnp.abs(x)), jnp.maximum(x, 0.0), jnp.exp(-x)),
    "types": lambda x: (x.astype("float32"), (x > 0).astype(int), x.astype("int32")),
    "a program inside": lambda x: jax.jit(lambda x: x * x[::-1] + x)(x),
    "a cylinder": lambda x: jax.vmap(dt.cylindrical)(jnp.abs(x), x, x),
}


def bits(tree):
    """Type, shape and bits; one NaN is like another."""
    leaves = [np.asarray(x) for x in jax.tree.leaves(tree)]
    same = [np.where(np.isnan(x), np.nan, x) if x.dtype.kind == "f" else x for x in leaves]
    return [(x.dtype, x.shape, x.astype(x.dtype).tobytes()) for x in same]


@pytest.mark.parametrize("name", PROGRAMS)
def test_bits_are_those_of_single_operations(name):
    program, x = PROGRAMS[name], jnp.asarray(RANDOM)
    found = NumpyProgram(jax.make_jaxpr(program)(x))(x)
    assert bits(found) == bits(program(x))


@pytest.mark.parametrize(
    ("inner", "whole"), [(lambda x: x * x + x, True), (lambda x: -x - 1, False), (jnp.cumsum, True)]
)
def test_a_program_inside_that_may_round_otherwise_is_left_whole(monkeypatch, inner, whole):
    single, names = numpy_programs.apply, []

    def watched(eqn, values):
        names.append(eqn.primitive.name)
        return single(eqn, values)

    monkeypatch.setattr(numpy_programs, "apply", watched)
    x = jnp.arange(3.0)
    NumpyProgram(jax.make_jaxpr(jax.jit(inner))(x))(x)
    assert ("jit" in names) == whole


def test_only_what_needs_jax_is_compiled():
    compiled = []

    def listen(event, duration_secs, **_):
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    x = jnp.linspace(-3.0, 3.0, 1237)  # a size that nothing else has
    program = jax.make_jaxpr(lambda x: dt.cylindrical(jnp.abs(x), x, x))(x)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        NumpyProgram(program)(x)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert 3 <= len(compiled) <= 4  # sine, cosine and a quotient, with a number of its own


def test_numbers_that_the_program_knows_are_seen():
    def asks(function):
        return numpy_programs.asks_known_numbers(jax.make_jaxpr(function)(jnp.ones(3)))

    assert asks(lambda x: jnp.where(jnp.sin(2.0) > 0, x, 0.0))
    assert asks(lambda x: jnp.where(jnp.isfinite(jnp.asarray(2.0)), x, 0.0))
    assert not asks(lambda x: jnp.where(x > 0, x, jnp.sin(2.0)))


def test_a_wrong_number_in_the_problem_itself_is_refused():
    """It is known only while nothing is traced."""
    with pytest.raises(ValueError, match="`delta`"):
        dt.sweep(
            lambda w3: (dt.TransverseReduced(2.0), dt.cylindrical(0.2, w3, 0.1)), dt.Grid(w3=[0.1])
        )
    basin = dt.sweep(
        lambda delta: (dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.1, 0.1)),
        dt.Grid(delta=[2.0, -0.2]),
    )
    assert basin.outcome[0] == dt.Outcome.FAILED != basin.outcome[1]


def test_a_problem_that_cannot_be_traced_is_run_by_jax():
    size = jnp.asarray(0.2)
    basin = dt.sweep(
        lambda w3: (dt.TransverseReduced(-0.2), dt.cylindrical(float(jnp.sin(size)), w3, 0.1)),
        dt.Grid(w3=[0.1]),
    )
    assert basin.outcome[0] in (dt.Outcome.RESIDUAL, dt.Outcome.STOP)
