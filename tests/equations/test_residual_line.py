"""The linear motion near the residual line, against the Jacobians of the equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dipoletop import Body, Level, Reduced, SemiReduced
from dipoletop.equations._verdicts.residual_line import linear_part, solve_lyapunov

N = 24


@pytest.mark.parametrize(
    "level", [Level.ORDER_1, pytest.param(Level.ORDER_2, marks=pytest.mark.slow), Level.SEMI]
)
def test_linear_part_is_the_jacobian_of_the_equation(level):
    rng = np.random.default_rng(3)
    j = rng.uniform([0.5, 0.7, 0.9], [0.6, 0.8, 1.0], (N, 3))
    strength, mu = rng.uniform(0.3, 2.0, N), rng.uniform(0.01, 0.3, N)
    sign = jnp.asarray(rng.choice([-1.0, 1.0], N))
    dipole = np.sqrt(strength)[:, None] * np.eye(3)[0]
    body = jax.jit(jax.vmap(Body, out_axes=-1))(j[:, :, None] * np.eye(3), dipole)
    equation = SemiReduced(body) if level is Level.SEMI else Reduced(body, level.order)
    w = jnp.asarray(mu * j[:, 0] / strength)

    def column(i):
        on_line = jnp.stack([w * sign, jnp.zeros(N), jnp.zeros(N)])
        unit = jnp.zeros((3, N)).at[i].set(1.0)
        return jax.jvp(lambda y: equation(0.0, y), (on_line,), (unit,))[1] / w[None]

    second, third = jax.jit(jax.vmap(column))(jnp.array([1, 2]))
    a, b = (jnp.asarray(j[:, i] / j[:, 0]) for i in (1, 2))
    l11, l12, l21, l22 = linear_part(a, b, jnp.asarray(mu), level)
    np.testing.assert_allclose(second, [0 * l11, l11, sign * l21], atol=1e-13)
    np.testing.assert_allclose(third, [0 * l11, sign * l12, l22], atol=1e-13)


def test_full_linear_part_solves_its_quadratic_equation():
    """(I⊥ − 2μ n× − μℓ)ℓ = I⊥ℓ₀ − μ, and the eigenvalues are the small ones."""
    a, b, mu = 1.3, 0.8, 0.05
    l11, l12, l21, l22 = linear_part(jnp.array(a), jnp.array(b), jnp.array(mu), Level.FULL)
    matrix = np.array([[l11, l12], [l21, l22]])
    across = np.array([[0.0, -1.0], [1.0, 0.0]])
    left = (np.diag([a, b]) - 2 * mu * across - mu * matrix) @ matrix
    np.testing.assert_allclose(left, [[-mu, b - 1], [1 - a, -mu]], rtol=1e-13, atol=1e-15)
    assert np.max(np.abs(np.linalg.eigvals(matrix))) < 1


def test_lyapunov_equation():
    m, q = np.array([[-0.3, 1.2], [-0.7, -0.1]]), np.array([[2.0, 0.4], [0.4, 1.0]])
    elements = jnp.asarray(m.ravel()), jnp.asarray(q[np.triu_indices(2)])
    p11, p12, p22 = solve_lyapunov(*map(tuple, elements))
    p = np.array([[p11, p12], [p12, p22]])
    np.testing.assert_allclose(m.T @ p + p @ m, -q, atol=1e-14)
