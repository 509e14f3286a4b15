"""Bisection: the bracket closes on the point, lane by lane."""

import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._base.bisection import bisect

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
