"""Cylindrical variables: exact at quarter turns, and back."""

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop.equations.coordinates import to_cylindrical


def test_cylindrical_start_is_exact_at_quarter_turns():
    """ω₁ = 0 exactly at φ = π/2: these planes decide outcomes."""
    assert dt.cylindrical(0.2, 0.1, jnp.pi / 2)[0] == 0
    assert dt.cylindrical(0.2, 0.1, jnp.pi)[1] == 0
    assert dt.cylindrical(0.2, 0.1, -jnp.pi / 2)[1] == -0.2
    angles = jnp.linspace(-7.0, 7.0, 101)
    flat = dt.cylindrical(0.3, 0.0, angles)  # as `classify_many` takes them
    expected = 0.3 * jnp.stack([jnp.cos(angles), jnp.sin(angles), 0 * angles], axis=1)
    assert jnp.allclose(flat, expected, rtol=0, atol=1e-15)


def test_a_start_moves_with_its_angle_at_quarter_turns_too():
    angles = np.arange(-4, 5) * np.pi / 2
    slopes = jax.vmap(jax.jacfwd(lambda phi: dt.cylindrical(0.3, 0.1, phi)))(angles)
    expected = 0.3 * np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=1)
    np.testing.assert_allclose(slopes, expected, atol=1e-15)


def test_back_to_cylindrical_variables():
    """φ comes back in (−π, π]."""
    w_perp, w3, phi = np.random.default_rng(5).uniform([[0], [-1], [-3]], [[1], [1], [3]], (3, 20))
    there_and_back = to_cylindrical(dt.cylindrical(w_perp, w3, phi).T)
    np.testing.assert_allclose(there_and_back, [w_perp, w3, phi], rtol=1e-13)
