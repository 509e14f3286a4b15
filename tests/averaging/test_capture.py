"""Capture against another integrator, direct integration of the top, and sampled phases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.stats import kstest

import dipoletop as dt
from dipoletop._averaging.capture import PARTS, _of_rods, capture, end_of_top
from dipoletop._averaging.planar_orbits import ENTRY, Expansion

# δ: probability of residual rotation, mean, 5, 25, 50, 75, 95 % of X: 20 000 phases by themselves.
SAMPLED = {
    0.1: (1.000, 3.247, 0.866, 2.273, 3.562, 4.407, 4.692),
    0.3: (1.000, 1.164, 0.349, 0.877, 1.289, 1.526, 1.602),
    0.5: (1.000, 0.968, 0.271, 0.719, 1.081, 1.279, 1.339),
    0.8: (0.826, 0.885, 0.291, 0.718, 0.986, 1.120, 1.159),
    0.95: (0.717, 0.839, 0.343, 0.716, 0.925, 1.026, 1.056),
}
captures = jax.jit(lambda deltas: jax.lax.map(capture, deltas))  # traced without a batch
averaged = jax.jit(dt.exact.averaged)
each_end = jax.jit(jax.vmap(end_of_top, in_axes=(None, 0, None)))
N = 256  # starts at once


def ends_of_tops(delta, starts):
    """With as many captures as elsewhere: these take long to compile."""
    found = jax.tree.map(lambda leaf: leaf[0], captures(np.full(len(SAMPLED), delta)))
    return each_end(jnp.asarray(delta), jnp.asarray(starts), found)


@pytest.mark.slow
def test_distribution_is_that_of_sampled_phases():
    found = captures(jnp.array(list(SAMPLED)))
    quantiles = jax.vmap(lambda one: one.log_quantiles())(found)
    logs = jnp.concatenate([found.log_mean[:, None], quantiles], axis=1)
    expected = np.array(list(SAMPLED.values()))
    np.testing.assert_allclose(found.residual, expected[:, 0], atol=1e-3)
    np.testing.assert_allclose(jnp.exp(logs[:, 0]), expected[:, 1], rtol=1e-3)
    np.testing.assert_allclose(jnp.exp(logs), expected[:, 1:], rtol=6e-3)
    # With wobbling stops as zeros the median of the last but one is a lower quantile of the rest.
    needle = jax.tree.map(lambda leaf: leaf[3], found)
    within = (0.5 - (1 - needle.residual)) / needle.residual
    of_all = needle.log_quantiles_of_all([0.1, 0.5])
    assert of_all[0] == -jnp.inf
    np.testing.assert_allclose(of_all[1], needle.log_quantiles([within])[0], rtol=1e-12)


def test_the_distribution_of_rods_is_that_of_its_integral():
    """X² = 3cos²φ − 2 with the weight cos²φ: its share, its mean, its means in parts."""

    def total(first, last, power=1.0):
        weighted = lambda phi: np.cos(phi) ** 2 * max(3 * np.cos(phi) ** 2 - 2, 0.0) ** power  # noqa: E731
        return quad(weighted, first, last, epsabs=1e-13)[0]

    edge = np.arccos(np.sqrt(2 / 3))
    share, mean, *parts = _of_rods()
    whole = total(0.0, edge, 0.0)
    np.testing.assert_allclose(share, whole / (np.pi / 4), rtol=1e-12)
    np.testing.assert_allclose(np.exp(mean), total(0.0, edge, 0.5) / whole, rtol=1e-6)
    for part in (1, PARTS // 2, PARTS - 1):  # X falls with φ
        ends = [
            brentq(lambda phi, k=k: total(0.0, phi, 0.0) / whole - 1 + k / PARTS, 0.0, edge)
            for k in (part + 1, part)
        ]
        of_part = total(*ends, 0.5) / total(*ends, 0.0)
        np.testing.assert_allclose(np.exp(parts[part]), of_part, rtol=1e-5)


@pytest.mark.parametrize("delta", [0.05, 0.4, 0.9])
def test_expansion_counts_turns_and_keeps_its_constant(delta):
    def field(phi, y):
        z, sine = y[0], np.sin(2 * phi)
        phi_rate = -delta * z - sine / 2
        z_rate = z * (1 - (2 + delta) / (1 - delta) * np.cos(phi) ** 2) - sine / (1 - delta)
        return np.array([z_rate, -2 * np.sin(phi) ** 2]) / phi_rate

    expansion = Expansion(jnp.asarray(-1.5 * delta / (1 - delta)))
    for factor, error in ((1, 1e-6), (4, 2e-10)):  # of the sixth order
        q = factor * ENTRY * (1 - float(expansion.a))
        y0, settings = [q / (2 * delta), 0.0], {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13}
        z, log_u = solve_ivp(field, (0, -np.pi), y0, **settings).y[:, -1]
        before, after = jnp.asarray(q), jnp.asarray(2 * delta * z)
        gained = expansion.turns(after) - expansion.turns(before)
        kept = log_u / 2 + expansion.log_w(after) - expansion.log_w(before)
        np.testing.assert_allclose(gained, -1.0, rtol=error)
        np.testing.assert_allclose(kept, 0.0, atol=error)
        np.testing.assert_allclose(expansion.q(expansion.turns(before)), q, rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [0.3, 0.5, 0.8])
def test_direct_integration_keeps_as_much(delta):
    rng = np.random.default_rng(7)
    omega0 = rng.normal(size=(N, 3))
    omega0 *= 1e-3 / np.linalg.norm(omega0, axis=1)[:, None]
    omega0[::8, 2] *= 1e-3  # here the phase is known
    ends = ends_of_tops(delta, omega0)
    direct = dt.classify_many(dt.TransverseSemi(delta), jnp.asarray(omega0))
    stops = np.asarray(direct.outcome == dt.Outcome.STOP)
    speed = np.linalg.norm(omega0, axis=1)
    log_ratio = np.log(np.where(stops, 1.0, np.abs(direct.omega_inf)) / speed)
    measured = ~stops & np.isfinite(log_ratio)  # the smallest ω∞ are not

    known = ~np.asarray(ends.random)
    assert 32 <= np.sum(known) < 64
    np.testing.assert_array_equal(np.asarray(ends.wobbling)[known], stops[known])
    positive = np.asarray(direct.omega_inf > 0)
    assert np.all(((np.asarray(ends.along) == 1) == positive)[known & measured])
    error = np.abs(np.asarray(ends.capture.log_mean) - log_ratio)[known & measured]
    assert np.median(error) < 2e-5  # of the order u; more next to the ends of a basin
    assert np.quantile(error, 0.9) < 1e-2

    chance = ~known & ~stops
    first = np.argmax(chance)
    distribution = jax.tree.map(lambda leaf: leaf[first], ends.capture)
    table = np.asarray(distribution.log_table - ends.log_scale[first])
    log_x = np.where(measured, log_ratio - ends.log_scale, -99.0)[chance]
    x = np.exp(log_x)
    assert abs(np.mean(x) - np.mean(np.exp(table))) < 3 * np.std(x) / np.sqrt(x.size)
    levels = np.interp(log_x, table, (np.arange(PARTS) + 0.5) / PARTS)
    assert kstest(levels, "uniform").pvalue > 0.01
    share, n = float(1 - distribution.residual), np.sum(~known)
    assert abs(np.mean(stops[~known]) - share) <= 3 * np.sqrt(share * (1 - share) / n)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [0.02, 0.3, 0.9])
def test_scale_is_the_constant_of_the_averaged_top(delta):
    start, sizes = np.array([0.6, 0.0, 0.8]), np.resize([1e-3, 1e-20, 1e-25], N)
    ends = ends_of_tops(delta, sizes[:, None] * start)
    np.testing.assert_allclose(ends.along + ends.against + ends.wobbling, 1.0, rtol=1e-12)
    kappa = (1 - delta) / (3 * delta)
    fall = kappa * np.log(1e-5)
    np.testing.assert_allclose(ends.log_scale[2] - ends.log_scale[1], fall, rtol=1e-12)
    # At late times u → 1/τ, so that q = 1 and u = W² at τ = 1/W².
    late = np.asarray(averaged(delta, start, 1e10))
    log_u, log_q = np.log(late[0] ** 2 + late[1] ** 2), np.log(2 * delta * late[2])
    log_w = log_u / 2 - kappa * (log_q - log_u)
    scaled = log_w + kappa * np.log(1e-25)
    np.testing.assert_allclose(ends.log_scale[2], scaled, rtol=1e-9)
    assert np.all(np.isfinite(ends.capture.log_table))


@pytest.mark.slow
def test_scale_is_free_of_the_oscillations_of_a_turn():
    delta, start = 0.3, 1e-3 * np.array([0.6, 0.0, 0.8])

    def field(_, w):  # (4.2)–(4.4)
        w1, w2, w3 = w
        square = w @ w
        rate2 = -delta * w1 * w3 - (square + delta * (1 + delta) * w3**2) * w2
        rate3 = -(square + delta * (2 * w1**2 - w2**2)) * w3 / (1 - delta)
        return delta * w2 * w3, rate2, rate3

    times = np.linspace(0, 2 * np.pi / (delta * start[2]), N)
    path = solve_ivp(field, times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-18).y.T
    ends = ends_of_tops(delta, path)
    log_w = ends.log_scale + np.log(np.linalg.norm(path, axis=1))
    assert np.ptp(log_w) < 3e-5  # of the order ω², where the oscillations are of the order ω


@pytest.mark.slow
def test_starts_on_an_axis_stop_and_others_without_spin_decide_at_once():
    starts = jnp.array([[0, 0, 1.0], [0, 1.0, 0], [0, 0, -1.0], [1.0, 0, 0], [-0.6, 0.8, 0]])
    padded = jnp.pad(1e-25 * starts, ((0, N - 5), (0, 0)), constant_values=1.0)
    ends = jax.tree.map(lambda leaf: leaf[:5], ends_of_tops(0.8, padded))
    np.testing.assert_array_equal(ends.symmetry_axis, [1, 0, 1, 0, 0])
    np.testing.assert_array_equal(ends.across, [0, 1, 0, 0, 0])
    np.testing.assert_array_equal(ends.along, [0, 0, 0, 1, 0])
    np.testing.assert_array_equal(ends.against + ends.wobbling, [0, 0, 0, 0, 1])
    np.testing.assert_allclose(ends.capture.log_mean[3], 0.0, atol=1e-12)
    assert not np.any(ends.random)


@pytest.mark.slow
def test_derivative_is_that_of_differences():
    slope = jax.jit(jax.jacfwd(capture))(jnp.asarray(0.82))
    found = captures(jnp.array([0.8199, 0.8201, 0.82, 0.82, 0.82]))
    secant = jax.tree.map(lambda leaf: (leaf[1] - leaf[0]) / 2e-4, found)
    np.testing.assert_allclose(slope.residual, secant.residual, rtol=1e-4)
    np.testing.assert_allclose(slope.log_mean, secant.log_mean, rtol=1e-4)
    slopes, secants = (x.log_table.reshape(16, -1).mean(axis=1) for x in (slope, secant))
    np.testing.assert_allclose(slopes, secants, atol=1e-2)


@pytest.mark.slow
def test_tops_that_are_no_needles_have_no_distribution():
    found = captures(jnp.array([-0.2, 0.0, 1.0, jnp.nan]))
    assert all(np.all(np.isnan(field)) for field in found)
