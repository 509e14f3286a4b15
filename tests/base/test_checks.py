"""Numbers that equations are made of: kept as they were, and taken without a program of JAX."""

import jax
import numpy as np
import pytest

import dipoletop as dt


def test_an_equation_keeps_its_numbers_when_its_array_changes():
    """JAX keeps the memory of some arrays that it is given, by how they lie."""
    for first in range(8):
        shapes = np.full(1000, -0.2)[first:]
        equation = dt.TransverseReduced(shapes)
        shapes[:] = 0.5
        np.testing.assert_array_equal(equation.delta, -0.2)


@pytest.mark.parametrize("length", [271, 272])
def test_an_array_of_a_new_length_compiles_nothing(length):
    compiled = []

    def listen(event, seconds, **about):
        if event.endswith("backend_compile_duration"):
            compiled.append(about)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        dt.TransverseReduced(np.linspace(-0.4, -0.2, length))
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert compiled == []
