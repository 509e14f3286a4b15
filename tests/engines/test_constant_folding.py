"""Operations on known numbers, done in NumPy, give the bits of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Literal

from dipoletop._engines import constant_folding

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
}


def bits(tree):
    """Type, shape and bits; one NaN is like another."""
    leaves = [np.asarray(x) for x in jax.tree.leaves(tree)]
    same = [np.where(np.isnan(x), np.nan, x) if x.dtype.kind == "f" else x for x in leaves]
    return [(x.dtype, x.shape, x.astype(x.dtype).tobytes()) for x in same]


def folded(closed, *arguments):
    """The results of a traced program, one operation after the other."""
    jaxpr = closed.jaxpr
    known = dict(zip(jaxpr.constvars, map(np.asarray, closed.consts), strict=True))
    known |= zip(jaxpr.invars, map(np.asarray, arguments), strict=True)

    def value(atom):
        return np.asarray(atom.val, atom.aval.dtype) if isinstance(atom, Literal) else known[atom]

    for eqn in jaxpr.eqns:
        values = [value(atom) for atom in eqn.invars]
        inner = eqn.params.get(constant_folding.CALLS.get(eqn.primitive.name, ""))
        results = constant_folding.apply(eqn, values) if inner is None else folded(inner, *values)
        known |= zip(eqn.outvars, results, strict=True)
    return [value(atom) for atom in jaxpr.outvars]


@pytest.mark.parametrize("name", PROGRAMS)
def test_bits_are_those_of_single_operations(name):
    program, x = PROGRAMS[name], jnp.asarray(RANDOM)
    assert bits(folded(jax.make_jaxpr(program)(x), x)) == bits(program(x))
