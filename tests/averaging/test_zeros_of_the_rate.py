"""The rate F of the slow flow: no pair of its zeros is overlooked, however near they are."""

import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._averaging.slow_flow import Side

RNG = np.random.default_rng(3)


@jax.jit
@jax.vmap
def rates(moments, z):
    """F of a dipole along each axis, and its first two derivatives by z."""

    def rate(z):
        return jnp.stack([Side(moments, axis).growth(z) for axis in jnp.eye(3)])

    one = jnp.ones_like(z)
    (value, first), (_, second) = jax.jvp(lambda z: jax.jvp(rate, (z,), (one,)), (z,), (one,))
    return value, first, second


def folds(number):
    """Bodies whose F has two zeros next to each other, around a known place."""
    moments = np.sort(1 - RNG.dirichlet(np.ones(3), number), axis=1)
    moments = np.where(RNG.random((number, 1)) < 0.5, moments, moments[:, ::-1])
    moments /= np.max(moments, axis=1, keepdims=True)
    place = RNG.uniform(-14, 19, number)
    value, first, second = map(np.asarray, rates(jnp.asarray(moments), jnp.asarray(place)))
    size = [np.max(np.abs(x), axis=1, keepdims=True) for x in (value, first)]
    # Squared direction cosines at which F = F′ = 0. Then F is moved, away from its curvature.
    system = np.stack([value / size[0], first / size[1], np.ones((number, 3))], axis=1)
    weights = np.linalg.solve(system, np.broadcast_to([0.0, 0.0, 1.0], (number, 3))[..., None])
    weights = weights[..., 0]
    curvature = np.sum(weights * second, axis=1)
    apart = 10 ** RNG.uniform(-3, -0.5, number)
    axis = np.arange(number), np.argmax(-value * np.sign(curvature)[:, None], axis=1)
    moved = apart**2 * np.abs(curvature) / 2
    weights[axis] += moved / np.abs(value[axis])
    visible = moved > 1e-13 * size[0][:, 0]
    good = np.all(weights > 0, axis=1) & visible & (value[axis] * curvature < 0)
    chosen = moments, weights / np.sum(weights, axis=1, keepdims=True), place, curvature
    return [jnp.asarray(x[good]) for x in chosen]


def test_two_zeros_next_to_each_other_are_seen():
    moments, weights, place, curvature = folds(4000)
    assert place.size > 500
    assert np.min(place) < -9
    assert np.max(place) > 18
    sample = jax.jit(jax.vmap(lambda *row: Side(*row[:2]).sample(row[2])))
    points, positive, _ = sample(moments, weights, place)
    near = np.abs(points - place[:, None]) < 0.35
    between = np.any(near & (positive == (curvature < 0)[:, None]), axis=1)
    # Beyond the zeros, F has the sign of its curvature.
    np.testing.assert_array_equal(between, True)
