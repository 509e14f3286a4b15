"""Which law describes a start: by q = 2δ|ω₃|/ω⊥² beside 24 + 36 δ/(1 − δ); and if it is traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop._averaging.capture import known_capture
from dipoletop._averaging.laws import ByChance, KnownPhase, Needle, SlowFlow, first_law

ONE = jnp.asarray(1.0)
NEEDLE = jnp.diag(jnp.array([0.6, 1.0, 1.0])), jnp.array([0.0, 1.0, 0.0])
GRAIN = jnp.diag(jnp.array([0.6, 0.8, 1.0])), jnp.array([0.0, 1.0, 0.0])
LIMIT = (24 + 36 * 0.4 / 0.6) / 0.8  # ω₃/ω⊥²
ACROSS = 1e-6


def law_of(body, along, across=ACROSS):
    return first_law(*body, jnp.array([along, 0.6 * across, 0.8 * across]), ONE)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_needle_that_turns_many_times_is_captured_by_chance(sense):
    fast, slow = (law_of(NEEDLE, sense * part * LIMIT * ACROSS**2) for part in (1.001, 0.999))
    assert isinstance(fast, ByChance)
    np.testing.assert_allclose(fast.chance.log_mean, known_capture(0.4).log_mean, rtol=1e-11)
    assert isinstance(slow, KnownPhase)


def test_what_is_not_captured_obeys_the_slow_flow():
    for law in (law_of(GRAIN, ACROSS), law_of(NEEDLE, ACROSS, across=0.0)):
        assert law == SlowFlow(Needle.NO)


def test_what_is_traced_is_not_known():
    """A constant body has a constant capture; in derivatives without `jit` the start is known."""
    inertia, dipole = NEEDLE
    found = []

    def keep(law):
        found.append((type(law), law.needle, law.chance is None))
        return 1.0

    omega = jnp.array([ACROSS, ACROSS, 0.0])

    def law_at(inertia, omega):
        return keep(first_law(inertia, dipole, omega, ONE))

    jax.jit(lambda omega: law_at(inertia, omega))(omega)
    jax.jit(lambda inertia: law_at(inertia, omega))(inertia)
    jax.jvp(lambda omega: law_at(inertia, omega), (omega,), (omega,))
    jax.jvp(lambda inertia: law_at(inertia, omega), (inertia,), (inertia,))
    assert found == [
        (SlowFlow, Needle.OF_ANY_PHASE, False),
        (SlowFlow, Needle.UNKNOWN, True),
        (ByChance, Needle.BY_CHANCE, False),
        (ByChance, Needle.BY_CHANCE, True),
    ]
