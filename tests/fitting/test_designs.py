"""Designs against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from dipoletop.equations._common import OfOmega
from dipoletop.fitting import Design, DesignEnd, design


class Decay(OfOmega):
    """ω₁′ = −a ω₁ω₂², ω₂′ = −ω₂: ω₁ → ω₁ exp(−aω₂²/2); where ω₃ ≤ 0 it is called a stop."""

    a: jax.Array

    def __call__(self, t, y, args=None):
        return jnp.stack([-self.a * y[0] * y[1] ** 2, -y[1], 0 * y[2]])

    def verdict(self, y):
        outcome = jnp.where(y[2] <= 0, 2, jnp.where(jnp.abs(y[1]) < 0.1, 1, 0))
        value = jnp.where(y[2] <= 0, 0.0, y[0] * jnp.exp(-self.a * y[1] ** 2 / 2))
        return outcome, value, outcome > 0


def decay(x, s):
    """ω∞ = x exp(−xs²/2) where x + s < 3.6."""
    return Decay(x), jnp.stack([x, s, 3.6 - x - s])


BOX = {"x": (0.5, 4.0), "s": (1.0, 2.0)}


def test_a_design_ends_at_the_maximum():
    found = design(decay, BOX, n=128, searches=2)
    assert found.success
    assert found.parameters["s"] == 1.0  # a bound
    assert abs(found.parameters["x"] - 2) < 1e-6
    assert abs(found.value - 2 / np.e) < 1e-9
    assert found.omega_inf == found.value
    assert found.defect < 1e-6
    assert 128 < found.runs < 128 + 2 * 30
    x, s = np.meshgrid(np.linspace(*BOX["x"], 701), np.linspace(*BOX["s"], 201))
    grid = np.where(x + s < 3.6, x * np.exp(-x * s**2 / 2), 0.0)
    assert abs(found.value - grid.max()) < 1e-9


def test_a_design_of_ones_own():
    """ω∞ − x²/10, whose slope at s = 1 is (1 − x/2) exp(−x/2) − x/5."""
    found = design(decay, BOX, n=128, searches=1, objective=lambda w, at: w - at["x"] ** 2 / 10)
    best = brentq(lambda x: (1 - x / 2) * np.exp(-x / 2) - x / 5, 0.5, 2)
    assert found.success
    assert abs(found.parameters["x"] - best) < 1e-6
    assert abs(found.value - (best * np.exp(-best / 2) - best**2 / 10)) < 1e-9
    assert abs(found.omega_inf - best * np.exp(-best / 2)) < 1e-8


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"bounds": {}}, r"`bounds` must be a dict of pairs"),
        ({"bounds": BOX | {"s": (2.0, 1.0)}}, r"`bounds\['s'\]` must be a pair low < high"),
        ({"n": 0}, r"`n` must be a positive whole number"),
        ({"searches": 0}, r"`searches` must be a positive whole number"),
        ({"seed": -1}, r"`seed` must be a whole number, not negative"),
        ({"n": 8, "max_steps": 1}, r"`bounds` must hold parameters whose fate is known"),
    ],
)
def test_design_refuses(change, match):
    given = {"bounds": {"x": (0.5, 1.0), "s": (1.0, 2.0)}} | change
    with pytest.raises(ValueError, match=match):
        design(decay, given.pop("bounds"), **given)


def test_a_summary_has_the_numbers():
    assert repr(Design({"x": 2.0}, 0.7, 0.5, 1e-9, 130, True, "", DesignEnd.MAXIMUM)) == (
        "Design(parameters={x: 2}, value=0.7, omega_inf=0.5, defect=1e-09, runs=130, end=MAXIMUM)"
    )
