"""Which results depend on which arguments."""

import jax
import jax.numpy as jnp

from dipoletop._base.dependence import dependence


def test_results_depend_on_what_they_are_made_of():
    def function(a, b, c):
        inner = jax.jit(lambda x: x * 2)(a)  # an inner program
        constant = jnp.zeros(2) + 1.0
        return {"none": constant, "pair": (inner + b, jnp.stack([c, c]))}

    leaves = dependence(function, jnp.ones(()), jnp.ones(()), jnp.ones(()))
    # none, pair[0], pair[1]
    assert leaves == [(False, True, False), (False, True, False), (False, False, True)]


def test_an_argument_may_be_a_result():
    assert dependence(lambda a, b: (b, 3.0), 1.0, 2.0) == [(False, False), (True, False)]
