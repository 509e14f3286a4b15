"""Newton's method in a window: it stops as soon as what it leaves is negligible, and no later."""

import equinox as eqx
import jax.numpy as jnp
import pytest

import dipoletop as dt
from dipoletop._branch.window import solve_window

STARTS = [[0.1, 0.12, -0.13], [0.02, -0.03, 0.04], [0.2, 0.02, 0.01]]


@eqx.filter_jit
def solve(start, span, rtol):
    return solve_window(dt.TransverseFull(-0.2), 0.0, start, span, rtol)


@pytest.mark.slow
def test_errors_that_are_left_are_far_below_the_tolerance():
    saved = 0
    for start in map(jnp.array, STARTS):
        best = solve(start, 60.0, 0.0)
        assert best.converged
        for rtol in (1e-12, 1e-8, 1e-5):
            window = solve(start, 60.0, rtol)
            assert window.converged
            error = float(jnp.max(jnp.abs(window.states - best.states)))
            assert error <= max(0.01 * rtol, 1e-14) * float(jnp.max(jnp.abs(start)))
            saved += int(best.iterations - window.iterations)
    assert saved >= len(STARTS)
