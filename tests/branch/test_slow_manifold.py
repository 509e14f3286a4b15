"""Ω̇ on the physical branch: exact values, the asymptotic series, and derivatives."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from branched import STARTS, TOP, isotropic

import dipoletop as dt


def branch(equation, omega):
    return dt.slow_manifold(equation, omega, with_error=True)


# Tabulated values of f(ω), ff′ = f + ω³, the branch of the plane rotator (A.1).
@pytest.mark.parametrize(
    ("speed", "exact", "tolerance"),
    [
        (0.1, -0.00097215149697444904, 1e-14),
        (0.3, -0.022428220160021891, 1e-13),
        (1.0, -0.4734467160950165281, 3e-14),
        (10.0, -67.523066735607424581, 1e-10),
    ],
)
def test_plane_rotator(speed, exact, tolerance):
    rate, error = branch(TOP, jnp.array([0.0, speed, 0.0]))
    assert abs(rate[1] / exact - 1) < tolerance
    assert abs(rate[1] - exact) < error < 1e-9 * abs(exact)
    assert jnp.all(rate[jnp.array([0, 2])] == 0)


@pytest.mark.parametrize(
    ("phi", "exact"),
    [(np.pi / 30, (0.00913023, -0.00967855)), (np.pi / 3, (-0.00532417, -0.01342288))],
)
def test_transverse_top(phi, exact):
    """(ω₂′, ω₃′) at the starts of figure 2."""
    rate, error = branch(TOP, STARTS[phi])
    np.testing.assert_allclose(rate[1:], exact, rtol=0, atol=6e-9)
    assert error < 1e-12


class WithShortLevels(eqx.Module):
    """The general equation, its levels in the short closed forms, which compile far faster."""

    general: dt.Full
    special: dt.TransverseFull

    def __getattr__(self, name):
        return getattr(self.special if name in ("semi", "reduced") else self.general, name)

    def __call__(self, t, y, args=None):
        return self.general(t, y, args)


@pytest.mark.slow
def test_the_general_equation_has_the_same_branch():
    body, start = dt.axisymmetric(-0.2), STARTS[np.pi / 3]
    general = dt.Full(body)
    rate, _ = branch(WithShortLevels(general, TOP), start)
    np.testing.assert_allclose(rate, branch(TOP, start)[0], rtol=1e-12)
    # The levels of the same body are the same: `test_equations`.
    assert eqx.tree_equal(general.semi, dt.SemiReduced(body))
    assert eqx.tree_equal(general.reduced(3), dt.Reduced(body, 3))


@pytest.mark.parametrize("delta", [-0.9, -0.2, 0.6])
def test_runaway_rate(delta):
    """1 and 1 − δ for the transverse top; in general the spectrum of the fast part at rest."""
    oblique = dt.Body(np.diag([0.7, 1.0, 1.5 + delta / 3]), [0.6, 0.3, 0.8])
    bodies = dt.axisymmetric(delta), oblique
    assert float(dt.TransverseFull(delta).runaway_rate) == min(1.0, 1 - delta)
    for body in bodies:
        rates = np.sort(np.linalg.eigvals(np.asarray(at_rest(body))).real)[-2:]
        np.testing.assert_allclose(dt.Full(body).runaway_rate, rates[0], rtol=1e-12)
    same = dt.Full(bodies[0]).runaway_rate
    np.testing.assert_allclose(same, dt.TransverseFull(delta).runaway_rate, rtol=1e-12)


@jax.jit
def at_rest(body):
    """The Jacobian of the full equation where nothing moves."""
    return jax.jacfwd(lambda y: dt.Full(body)(0.0, y))(jnp.zeros(6))


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [1e-10, 1e-5])
def test_a_requested_accuracy(wanted):
    """The estimate covers the error, and what misses the request is not given."""
    starts = jnp.asarray(isotropic(2, np.geomspace(0.05, 4.0, 12)[:, None], 12))

    def at(rtol):
        return [dt.slow_manifold(TOP, start, rtol=rtol, with_error=True) for start in starts]

    rates = at(wanted)
    for (rate, error), (best, rest) in zip(rates, at(wanted / 100), strict=True):
        size = jnp.max(jnp.abs(rate))
        if jnp.isfinite(size):
            assert error <= wanted * size
        if jnp.isfinite(size + best[0]):
            assert jnp.max(jnp.abs(rate - best)) <= error + rest
    found = [bool(jnp.isfinite(rate[0])) for rate, _ in rates]
    assert np.mean(found) > 0.6


@pytest.mark.slow
def test_derivatives_of_the_branch():
    """By shape and start, backwards, against differences of order 6."""
    start, way, step = dt.cylindrical(0.2, 0.2, np.pi / 30), jnp.array([0.3, -0.2, 0.4]), 4e-3

    def rate(change, moved):
        return dt.slow_manifold(dt.TransverseFull(change - 0.2), start + moved)[1]

    slopes = jax.jit(jax.grad(rate, (0, 1)))(0.0, jnp.zeros(3))
    around = [rate(k * step, k * step * way) for k in (-3, -2, -1, 1, 2, 3)]
    found = np.array([-1, 9, -45, 45, -9, 1]) / (60 * step) @ jnp.array(around)
    assert float(slopes[0] + slopes[1] @ way) == pytest.approx(float(found), rel=1e-10)


def test_small_amplitudes_have_the_series():
    """The orders approach the branch, each by a power of ω more."""
    start = jnp.array([0.3, 0.5, -0.4])
    for scale, least in ((0.02, 3.0), (0.01, 6.0)):
        rate, _ = branch(TOP, scale * start)
        errors = [float(jnp.max(jnp.abs(order - rate))) for order in series(scale * start)]
        assert all(low * least < high for high, low in itertools.pairwise(errors))


@jax.jit
def series(omega):
    return [dt.TransverseReduced(-0.2, m)(0.0, omega) for m in (1, 2, 3, 4)]
