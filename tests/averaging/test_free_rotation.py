"""Averages over free rotation: against sampled averages of the radiation, in extended precision."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from dipoletop._averaging.free_rotation import averages

BODIES = {
    "generic": ("1", "1.4", "2"),
    "nearly spherical": ("1", "1.000000001", "1.000000003"),
    "nearly oblate": ("1", "1.0000000001", "1.3"),
    "nearly prolate": ("1", "1.5", "1.5000000001"),
    "plate": ("1", "1.3", "2.3"),
    "needle": ("0.001", "1", "1.0005"),
}
PLACES = ("1e-12", "0.001", "0.3", "0.7", "0.99", "0.999999")


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a, b):
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def _sampled(moments, x, points=40):
    """The means r and F for a dipole along each axis, from n₁ = Ω×n and n₂ = Ω×n₁ + Ω̇×n.

    Over a quarter of the period, of which the others are images.
    """
    a, b, c = p = [1 / j for j in moments]
    to_a, to_b, a_to_b = a - c, b - c, a - b
    m = a_to_b * x / (a_to_b + (1 - x) * to_b)
    means = [[mp.mpf(0)] * 3, [mp.mpf(0)] * 3]
    for k in range(points):
        u = mp.ellipk(m) * (k + mp.mpf(1) / 2) / points
        sn, cn, dn = (mp.ellipfun(name, u, m=m) for name in ("sn", "cn", "dn"))
        ya, yb = x * to_b / to_a, x
        momentum = [mp.sqrt(ya) * cn, mp.sqrt(yb) * sn, mp.sqrt(1 - ya) * dn]
        omega = [j * y for j, y in zip(p, momentum, strict=True)]
        change = [j * y for j, y in zip(p, _cross(momentum, omega), strict=True)]
        for axis in range(3):
            n = [mp.mpf(i == axis) for i in range(3)]
            first = _cross(omega, n)
            second = [v + w for v, w in zip(_cross(omega, first), _cross(change, n), strict=True)]
            means[0][axis] += _dot(momentum, _cross(first, second)) / points
            means[1][axis] += _dot(second, second) / points
    h = c + x * to_b
    growth = [(h * r - e) / (x * to_b) for r, e in zip(*means, strict=True)]
    return means[0], growth


@pytest.mark.parametrize("reverse", [False, True], ids=["low", "high"])
@pytest.mark.parametrize("name", BODIES)
def test_averages_are_those_of_the_free_rotation(name, reverse):
    with mp.workdps(60):
        # float64 numbers, so that both see the same body.
        moments = [mp.mpf(float(j)) for j in BODIES[name]][:: -1 if reverse else 1]
        for place in PLACES:
            x = mp.mpf(float(place))
            r, growth = _sampled(moments, x)
            rest = jnp.asarray(float(1 - x))
            means = averages(jnp.asarray([float(j) for j in moments]), jnp.asarray(float(x)), rest)
            for exact, here in zip((r, growth), means, strict=True):
                size = max(map(abs, exact))  # near a zero of F only its place is certain
                for v, e in zip(here, exact, strict=True):
                    assert abs(float(v) - e) < 1e-12 * abs(e) + 2e-16 * size, (place, v, e)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.5), (1.0, 1.0, 1.6)])
def test_derivatives_of_a_top_are_those_of_its_neighbours(moments):
    """By x, and by each moment: also by one of the two equal ones alone."""

    def rates(numbers):
        j, x = numbers[:3], numbers[3]
        return jnp.concatenate(averages(j, x, 1 - x))

    at, step = np.array([*moments, 0.3]), 1e-5
    slopes = jax.jacfwd(rates)(jnp.asarray(at))
    for k, change in enumerate(step * np.eye(4)):
        numeric = (rates(at + change) - rates(at - change)) / (2 * step)
        np.testing.assert_allclose(slopes[:, k], numeric, rtol=1e-7, atol=1e-8)
