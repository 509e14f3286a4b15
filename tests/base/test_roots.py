"""Zeros in brackets: they close on the point, lane by lane, in few evaluations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop._base.roots import bisect, root

SQUARES = jnp.array([2.0, 3.0, 4.0])


@jax.jit
def brackets(squares):
    return bisect(lambda x: x**2 >= squares, 0 * squares, 4 + 0 * squares, 20)


def test_brackets_close_on_the_roots():
    low, high = brackets(SQUARES)
    np.testing.assert_array_equal(high - low, 4 * 2.0**-20)
    assert np.all((low**2 < SQUARES) & (high**2 >= SQUARES))


def test_what_is_not_passed_lies_at_the_upper_end():
    low, high = bisect(lambda x: x > jnp.nan, jnp.array(0.0), jnp.array(1.0), 3)
    assert (float(low), float(high)) == (0.875, 1.0)


def evaluations(function, low, high, halvings):
    """The zero that `root` finds, and how often it needs the function."""
    calls = []

    def counted(x):
        jax.debug.callback(lambda _: calls.append(1), x)
        return function(x)

    found = jax.jit(lambda: root(counted, jnp.float64(low), jnp.float64(high), halvings))()
    jax.effects_barrier()
    return float(found), len(calls)


@pytest.mark.parametrize(
    ("function", "low", "high", "zero", "most"),
    [
        (lambda x: x**2 - 2, 0, 2, 2**0.5, 14),
        (lambda x: jnp.exp(x) - 1e-14, -36, -28, np.log(1e-14), 15),
        (lambda x: (x - 0.3) ** 9, -1, 2, 0.3, 58),
        (lambda x: jnp.where(x < 0.777, -1.0, 1.0), 0, 1, 0.777, 58),  # no slope
        (lambda x: jnp.where(x < 0.5, -jnp.inf, x), 0, 1, 0.5, 58),
        (lambda x: x + 1, 0, 1, 0.0, 58),  # no zero: the end with the wrong sign
        (lambda x: x - 2, 0, 1, 1.0, 58),
        (lambda x: -jnp.exp(-50 * x), 0, 1, 1.0, 58),
        (lambda x: x * jnp.nan, 0, 1, 1.0, 58),
    ],
)
def test_a_zero_is_found_in_few_evaluations_and_never_in_many(function, low, high, zero, most):
    found, number = evaluations(function, low, high, 55)
    np.testing.assert_allclose(found, zero, 1e-15, 1e-16)
    assert number <= most


def test_a_zero_has_the_derivatives_of_the_implicit_function():
    def zeros(squares):
        return root(lambda x: x**2 - squares, 0 * squares, 4 + 0 * squares, 55)

    np.testing.assert_allclose(zeros(SQUARES), SQUARES**0.5, 1e-15)
    slopes = np.diagonal(jax.jacfwd(zeros)(SQUARES)), np.diagonal(jax.jacrev(zeros)(SQUARES))
    np.testing.assert_allclose(slopes, [0.5 * SQUARES**-0.5] * 2, 1e-14)
