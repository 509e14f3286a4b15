"""Transverse top: closed forms, the general equations, limits and symmetries agree."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt

RNG = np.random.default_rng(11)
B = 64
DELTAS = jnp.asarray(np.concatenate([[-1.0, -0.5, 0.0], RNG.uniform(-1, 0.95, B - 3)]))
OMEGAS = jnp.asarray(RNG.normal(size=(3, B)))
BODIES = jax.jit(jax.vmap(dt.axisymmetric, out_axes=-1))(DELTAS)


def close(a, b, tol):
    """Largest difference over the size of the second argument, lane by lane."""
    a, b = np.asarray(a), np.asarray(b)
    assert np.max(np.abs(a - b) / np.max(np.abs(b), axis=0)) < tol


@pytest.mark.parametrize("order", [1, 2, 3])
def test_closed_forms_equal_the_general_reduction(order):
    """Two independent ways to the same rates, for random states and shapes."""
    closed = dt.TransverseReduced(DELTAS, order=order)(0.0, OMEGAS)
    close(closed, dt.Reduced(BODIES, order=order)(0.0, OMEGAS), 1e-12)


def test_the_other_closed_forms_equal_the_general_ones():
    """Of the full equation five components against six of the general one."""
    close(dt.TransverseSemi(DELTAS)(0.0, OMEGAS), dt.SemiReduced(BODIES)(0.0, OMEGAS), 1e-13)
    a = RNG.normal(size=(2, B))
    five = dt.TransverseFull(DELTAS)(0.0, jnp.asarray(np.concatenate([OMEGAS, a])))
    state = np.concatenate([OMEGAS, np.zeros((1, B)), a])
    six = np.asarray(dt.Full(BODIES)(0.0, jnp.asarray(state)))
    close(five, six[[0, 1, 2, 4, 5]], 1e-13)


def test_orders_approach_the_slow_manifold():
    """(ω₂′, ω₃′) on the physical branch of the full equation, physics of section 4."""
    phi = np.resize([np.pi / 30, np.pi / 3], B)  # in as many lanes as above
    expected = np.tile([[0.00913023, -0.00532417], [-0.00967855, -0.01342288]], B // 2)
    start = jnp.asarray(0.2 * np.stack([np.cos(phi), np.sin(phi), np.ones(B)]))
    flat = jnp.full(B, -0.2)
    found = [dt.TransverseReduced(flat, order)(0.0, start) for order in (1, 2, 3, 4)]
    errors = [np.max(np.abs(np.asarray(rates)[1:] - expected), axis=0) for rates in found]
    assert all(np.all(later < earlier / 2) for earlier, later in itertools.pairwise(errors))
    assert np.all(errors[-1] < 3e-4)  # |ω| = 0.28


def test_fields_are_arrays_so_that_values_compile_nothing():
    calls = []

    @eqx.filter_jit
    def rate(equation, w):
        calls.append(1)
        return equation(0.0, w)

    for delta in (-0.2, 0.1, -1):
        rate(dt.TransverseReduced(delta), OMEGAS[:, 0])
    assert len(calls) == 1


def test_traced_bad_value_becomes_nan():
    rate = jax.jit(lambda d: dt.TransverseReduced(d)(0.0, jnp.ones(3)))(2.0)
    assert bool(jnp.all(jnp.isnan(rate[1:])))
