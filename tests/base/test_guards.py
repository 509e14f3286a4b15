"""Guarded divisors and roots: values, and derivatives that stay finite at 0."""

import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._base.guards import safe_divisor, safe_sqrt

X = jnp.array([-1.0, 0.0, 4.0, jnp.nan])


def test_only_0_is_replaced_in_a_divisor():
    np.testing.assert_array_equal(safe_divisor(X), [-1.0, 1.0, 4.0, np.nan])

    def ratio(x):
        return jnp.where(x == 0, 0.0, x**2 / safe_divisor(x))

    np.testing.assert_array_equal(jax.vmap(jax.grad(ratio))(X[:3]), [1.0, 0.0, 1.0])


def test_roots_and_their_derivatives():
    np.testing.assert_array_equal(safe_sqrt(X), [0.0, 0.0, 2.0, 0.0])
    np.testing.assert_array_equal(safe_sqrt(X, otherwise=X), [-1.0, 0.0, 2.0, np.nan])
    for derivative in (jax.grad, jax.jacfwd):
        np.testing.assert_array_equal(jax.vmap(derivative(safe_sqrt))(X[:3]), [0.0, 0.0, 0.25])
