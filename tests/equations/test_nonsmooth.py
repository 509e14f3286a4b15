"""Directional derivatives of a value that is conserved on a set only."""

import jax
import jax.numpy as jnp
import pytest

from dipoletop.equations._verdicts.nonsmooth import infinite, piecewise_conserved


def conserved(x):
    """x₀² on the line x₁ = 0."""
    return piecewise_conserved(x[0] ** 2, x[1])


@pytest.mark.parametrize(("direction", "unbounded"), [((1.0, 0.0), False), ((1.0, 1e-9), True)])
def test_derivatives_are_infinite_across_the_set_only(direction, unbounded):
    x, direction = jnp.array([3.0, 0.0]), jnp.array(direction)
    value, change = jax.jvp(conserved, (x,), (direction,))
    assert value == 9.0
    assert bool(infinite(change)) == unbounded
    assert unbounded or change == 6.0

    def slope(x):
        return jax.jvp(conserved, (x,), (jnp.array([1.0, 0.0]),))[1]

    second = jax.jvp(slope, (x,), (direction,))[1]
    assert bool(infinite(second)) == unbounded
    assert unbounded or second == 2.0
