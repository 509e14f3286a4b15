"""Quantities: their description, and ω₀ in both ways to give it."""

import math

import numpy as np
import pytest

from dipoletop._maps.top_parameters import describe, initial_condition
from dipoletop.cli import quantities


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.2, "0.2"), (math.pi, "π"), (-math.pi / 4, "-π/4"), (2 * math.pi / 3, "2π/3")],
)
def test_multiples_of_pi_are_shown_as_such(value, text):
    assert describe({"phi": value}) == f"φ = {text}"


def test_both_ways_to_give_a_start_agree():
    one = quantities.with_defaults({"w_perp": 0.3, "w3": 0.4})
    other = quantities.with_defaults({"amplitude": 0.5, "theta": math.atan2(0.3, 0.4)})
    assert list(one) == ["delta", "w_perp", "w3", "phi"]
    assert list(other) == ["delta", "phi", "amplitude", "theta"]
    np.testing.assert_allclose(initial_condition(one), initial_condition(other), rtol=1e-14)


@pytest.mark.parametrize(("high", "last"), [(math.pi, 0.75 * math.pi), (3.0, 3.0)])
def test_a_range_of_phi_that_repeats_ends_before_its_end(high, last):
    grid, text = quantities.grid_over(("phi", "delta"), {"phi": (0.0, high)}, (4, 2), {})
    assert grid.dims == ("w_perp", "w3", "delta", "phi")
    assert grid.coords["phi"][-1] == pytest.approx(last)
    assert text.startswith("4 × 2 starts: φ from 0 to ")
    assert text.endswith("δ from -1 to 0.9, at ω⊥ = 0.2, ω₃ = 0.2")
