"""Machine code from traced functions: it does what JAX does, or says that it cannot."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dipoletop as dt
from dipoletop._engines import jaxpr_to_llvm
from dipoletop._engines.interface import Unsupported

RNG = np.random.default_rng(11)
WIDTH = 4


def machine(function, table):
    """A function of one row, (n,), by machine code on a table (n, B); what it gives comes first."""
    rows = jnp.zeros((table.shape[0], 1))
    address, _alive = jaxpr_to_llvm.compiled(
        lambda row, shared: function(row), rows, jnp.zeros(()), WIDTH
    )
    out = np.array(table, order="C")
    size = out.shape[1]
    assert size % WIDTH == 0
    shared = np.zeros(1)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)
    for first in range(0, size, WIDTH):
        kind(address)(out[:, first:].ctypes.data, size, shared.ctypes.data)
    return out


FUNCTIONS = {
    "arithmetic": lambda x: jnp.stack([x[0] + x[1], x[1] - x[2], x[0] * x[2], -x[1] / x[2]]),
    "parts": lambda x: jnp.concatenate([part[:1] * part for part in jnp.split(x, [1, 3])]),
    "powers": lambda x: jnp.stack([x[0] ** 7, x[1] ** -2, jnp.abs(x[2]) ** 1.5, x[3] ** 0]),
    "roots": lambda x: jnp.stack(
        [jnp.sqrt(jnp.abs(x[0])), jax.lax.rsqrt(x[1] ** 2), jnp.square(x[2]), jnp.cbrt(8.0) * x[3]]
    ),
    "functions": lambda x: jnp.stack(
        [jnp.exp(x[0]), jnp.log(jnp.abs(x[1])), jnp.sin(x[2]) * jnp.cos(x[0]), jnp.tan(x[3])]
    ),
    "angles": lambda x: jnp.stack(
        [jnp.arctan2(x[0], x[1]), jnp.tanh(x[1]), jnp.floor(x[2]), jnp.round(3 * x[3])]
    ),
    "choices": lambda x: jnp.stack(
        [
            jnp.where((x[0] > 0) & ~(x[1] <= x[2]) | (x[3] != x[0]), x[0], x[1]),
            jnp.clip(x[1], -0.5, 0.5),
            jnp.sign(x[2]) * jnp.minimum(x[0], x[3]),
            jnp.where(jnp.isfinite(1 / (x[3] - x[3])), 1.0, jnp.maximum(x[1], x[2])),
        ]
    ),
    "whole numbers": lambda x: jnp.stack(
        [
            jnp.argmax(x, axis=0).astype(float),
            jnp.argmin(x, axis=0).astype(float),
            jnp.sum((x > 0).astype("int32"), axis=0).astype(float) + jnp.mod(x[2], 0.3),
            (x[0] * 10).astype(int).astype(float) + jnp.abs((x[1] * 10).astype(int)).astype(float),
        ]
    ),
    "sums": lambda x: jnp.stack(
        [jnp.sum(x, axis=0), jnp.prod(x, axis=0), jnp.max(x, axis=0), jnp.min(x, axis=0)]
    ),
    "matrices": lambda x: (
        jnp.einsum("ij,jb->ib", jnp.arange(16.0).reshape(4, 4), x) + jnp.einsum("ab,cb->cb", x, x)
    ),
    "moves": lambda x: jnp.concatenate([x[::-1][:2], jnp.roll(x, 1, axis=0)[2:]]).at[1].set(x[3]),
    "single precision": lambda x: jnp.stack(
        [
            x[0].astype("float32").astype(float),
            jnp.log(jnp.abs(x[1]).astype("float32")).astype(float),
            *x[2:],
        ]
    ),
    "a loop": lambda x: jax.lax.fori_loop(
        0, 5, lambda i, y: y.at[i % 4].set(y[i % 3] + x[0] * i), x
    ),
    "a scan": lambda x: jax.lax.scan(lambda s, row: (s + row, s * row), x[0], x)[1],
    "a derivative": lambda x: jax.jvp(lambda y: y**3 / (1 + y[:1]) ** 2, (x,), (x[::-1],))[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_machine_code_does_what_jax_does(name):
    table = RNG.normal(size=(4, WIDTH))
    by_jax = jax.jit(FUNCTIONS[name])
    expected = np.stack([by_jax(table[:, i : i + 1]) for i in range(WIDTH)], axis=1)
    found = machine(FUNCTIONS[name], table)
    # Rounding, and sums in another order; libraries differ in the last bit of a function.
    scale = 1e-6 if name == "single precision" else 1e-14
    np.testing.assert_allclose(found, expected[..., 0], rtol=scale, atol=scale)


def test_what_is_not_a_number_stays_so():
    table = np.array([[np.nan, 1.0, -np.inf, 0.0], [1.0, np.nan, np.inf, -0.0]])
    found = machine(lambda x: jnp.stack([jnp.maximum(x[0], x[1]), jnp.minimum(x[0], x[1])]), table)
    expected = np.stack([np.maximum(*table), np.minimum(*table)])
    np.testing.assert_array_equal(found, expected)


def test_logarithms_in_single_precision():
    """Our own code for them, for every kind of number."""
    numbers = [0.0, -0.0, -1.0, np.inf, -np.inf, np.nan, 1e-45, 1e-40, 1.2e-38, 3e38, 1.0]
    numbers += [0.70710677, 0.7071069, *np.nextafter(np.float32(1), np.float32([0, 2]))]
    table = np.append(numbers, 10 ** RNG.uniform(-38, 38, 33)).reshape(1, -1)
    found = machine(lambda x: jnp.log(x.astype("float32")).astype(float), table)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.log(table.astype("float32").astype(float))
    np.testing.assert_allclose(found, expected, rtol=3e-7)


def any_bodies(rng, n):
    """Bodies in skew axes and Ω: the dipole on one of the principal axes, on none; Ω near, far."""
    turns = Rotation.random(n, rng).as_matrix()
    moments = 1 - rng.dirichlet(np.ones(3), n)
    inertia = np.einsum("nij,nj,nkj->nik", turns, moments, turns)
    along = np.resize(np.vstack([np.eye(3), [[0.6, 0.0, 0.8]]]), (n, 3))
    dipole = np.einsum("nij,nj->ni", turns, along)
    omega = dipole + rng.normal(size=(n, 3)) * 10 ** rng.uniform(-3, 1, (n, 1))
    omega *= 10 ** rng.uniform(-2, -0.5, (n, 1)) / np.linalg.norm(omega, axis=1, keepdims=True)
    return dt.Body((inertia + inertia.transpose(0, 2, 1)) / 2, dipole), omega


@pytest.mark.parametrize(
    "level", [dt.Reduced, pytest.param(dt.SemiReduced, marks=pytest.mark.slow)]
)
def test_rates_and_verdicts_of_any_body(level):
    """The long code of the general equations."""
    n = 64 * WIDTH
    bodies, omega = any_bodies(np.random.default_rng(12), n)
    given = level(bodies), jnp.asarray(omega)
    leaves, kind = jax.tree.flatten(jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), given))
    table = np.concatenate([leaf.reshape(-1, n) for leaf in leaves])
    ends = np.cumsum([leaf.size // n for leaf in leaves])

    def found(table):
        parts = [table[end - y.size // n : end] for y, end in zip(leaves, ends, strict=True)]
        parts = [x.reshape(*y.shape[:-1], -1) for x, y in zip(parts, leaves, strict=True)]
        equation, y = jax.tree.unflatten(kind, parts)
        numbers = jax.tree.leaves(equation.verdict(y))
        verdict = jnp.stack([number.astype(float) for number in numbers])
        return jnp.concatenate([equation(0.0, y), verdict])

    expected = np.asarray(jax.jit(found)(table))
    np.testing.assert_allclose(
        machine(found, table)[: len(expected)], expected, rtol=1e-9, atol=1e-13
    )
    assert set(expected[3]) == {dt.Outcome.UNDECIDED, dt.Outcome.RESIDUAL, dt.Outcome.STOP}


def test_a_code_that_grows_too_long_is_refused(monkeypatch):
    monkeypatch.setattr("dipoletop._engines.vector_code.LONGEST", 100)
    with pytest.raises(Unsupported, match="more than 100 instructions"):
        machine(lambda x: jax.lax.fori_loop(0, 99, lambda i, y: y * x, x), np.ones((4, WIDTH)))
