"""Derivatives of functions with loops whose length is not known, forwards and backwards."""

import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._base.forward_mode import forward_differentiable


def powers(x, limit):
    """Return a power of x, by a loop that reverse mode cannot differentiate, and x₀√(x₁ − 1)."""

    def step(now):
        return now[0] + 1, now[1] * x

    _, power = jax.lax.while_loop(lambda now: now[0] < limit, step, (0, x))
    return power, x[0] * jnp.sqrt(x[1] - 1)


def test_a_derivative_that_is_nan_reaches_no_other_number():
    """At x₁ < 1 the second number and its derivatives are NaN; those of the first are not."""
    function = forward_differentiable(powers)
    x = jnp.array([2.0, 0.5])
    for limit, power in ((1, 2), (2, 3)):
        found = jax.grad(lambda x, n=limit: jnp.sum(function(x, n)[0]))(x)
        np.testing.assert_allclose(found, power * x ** (power - 1), rtol=1e-14)
        second = jax.jacfwd(jax.grad(lambda x, n=limit: jnp.sum(function(x, n)[0])))(x)
        np.testing.assert_allclose(
            second, np.diag(power * (power - 1) * x ** (power - 2)), rtol=1e-14
        )
    assert np.isnan(jax.grad(lambda x: function(x, 1)[1])(x)).any()
