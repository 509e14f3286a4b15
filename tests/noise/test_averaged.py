"""Noise averaged over free rotation: closed forms of the averages, equilibria, resolved paths."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_resolved import MOMENTS, body, near

import dipoletop as dt
from dipoletop._averaging.free_rotation import averages, elliptic_means, path
from dipoletop.noise import (
    Bath,
    averaged_ensemble,
    diffusion,
    ensemble,
    rotator_density,
    with_noise,
)
from dipoletop.noise.averaged import _Averaged, random_phase
from dipoletop.noise.bath import Kicks
from dipoletop.noise.paths import Schedule, follow

EPS = 1e-20


@jax.jit
def turned(moments, momenta, seed):
    z = jax.random.normal(jax.random.key(seed), (2, momenta.shape[1]))
    return random_phase(moments, momenta, z)


def orbit(x, high):
    """L of size 1 at φ = 0, moments J_a, J_b, J_c, and x."""
    a, c = (2, 0) if high else (0, 2)
    ordered = jnp.asarray(MOMENTS[[a, 1, c]])
    to_a, to_b, *_ = path(ordered, jnp.asarray(x), jnp.asarray(1 - x))
    momentum = np.zeros(3)
    momentum[a] = np.sqrt(x * to_b / to_a)
    momentum[c] = np.sqrt(1 - momentum[a] ** 2)
    return momentum, ordered, jnp.asarray(x), jnp.asarray(1 - x)


@pytest.mark.parametrize("high", [False, True])
@pytest.mark.parametrize("x", [0.01, 0.7, 0.999])
def test_random_phases_have_the_distribution_in_time(x, high):
    momentum, ordered, x, rest = orbit(x, high)
    *_, m, m1 = path(ordered, x, rest)
    many = jnp.broadcast_to(jnp.asarray(momentum)[:, None], (3, 20_000))
    seen = []
    for k in range(40):
        many = turned(jnp.asarray(MOMENTS), many, k)
        seen.append(np.asarray(many[1]) ** 2 / float(x))
    late = np.stack(seen[20:])
    sn2, sn4 = elliptic_means(m, m1)
    spread = 4 * np.sqrt(float(sn4 - sn2**2) / 20_000)
    assert abs(late.mean() - sn2) < spread
    assert abs((late**2).mean() - sn4) < spread
    h = jnp.sum(many**2 / MOMENTS[:, None], axis=0)
    np.testing.assert_allclose(jnp.sum(many**2, axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(h, np.sum(momentum**2 / MOMENTS), rtol=1e-12)
    c = 0 if high else 2
    assert np.all(np.asarray(many[c]) > 0)


@pytest.mark.parametrize("moments", [(1, 1, 1), (1, 1, 2), (1, 2, 2)])
def test_random_phases_of_symmetric_bodies(moments):
    moments = jnp.asarray(moments, float)
    start = jnp.broadcast_to(jnp.array([[0.3], [0.4], [0.5]]), (3, 1000))
    found = turned(moments, start, 0)
    np.testing.assert_allclose(jnp.sum(found**2, axis=0), 0.5, rtol=1e-12)
    kept = jnp.sum(found**2 / moments[:, None], axis=0)
    np.testing.assert_allclose(kept, jnp.sum(start**2 / moments[:, None], axis=0), rtol=1e-12)
    if moments[0] == moments[2]:
        np.testing.assert_array_equal(found, start)
    else:
        assert np.std(found[1]) > 0.1


@pytest.mark.parametrize("high", [pytest.param(False, marks=pytest.mark.slow), True])
def test_diffusion_and_drift_are_the_closed_averages(high):
    """D_EE = θκ⟨|d₂|²⟩ and D_EL = θκ⟨L̂·d₁×d₂⟩; friction −κ of both, of E and of L²/2."""
    momentum, ordered, x, rest = orbit(0.4, high)
    dipole = np.array([0.5, 0.6, -0.4]) / np.linalg.norm([0.5, 0.6, -0.4])
    a, c = (2, 0) if high else (0, 2)
    squares = jnp.asarray(dipole[[a, 1, c]] ** 2)
    r, growth = (squares @ mean for mean in averages(ordered, x, rest))
    _, to_b, *_ = path(ordered, x, rest)
    h = float(np.sum(momentum**2 / MOMENTS))
    power = float(h * r - x * to_b * growth)  # dh/ds = x Db F = hr − ⟨|d₂|²⟩
    many = jnp.broadcast_to(jnp.asarray(momentum)[:, None], (3, 100_000))
    for k in range(20):
        many = turned(jnp.asarray(MOMENTS), many, k)
    kicks = Kicks(dt.Body(np.diag(MOMENTS), dipole), Bath(1.0), (True, False))
    lost = np.asarray(jax.jit(Kicks.radiated)(kicks, many))
    rate = np.asarray(many) / MOMENTS[:, None]
    np.testing.assert_allclose(np.mean(np.sum(rate * lost, axis=0)), -power, rtol=1e-2)
    np.testing.assert_allclose(np.mean(np.sum(many * lost, axis=0)), -float(r), rtol=1e-2)
    field = jax.jit(Kicks.field)
    units = jnp.broadcast_to(jnp.eye(3)[..., None], (3, *many.shape))
    columns = [np.asarray(field(kicks, many, unit)) for unit in units]
    many = np.asarray(many)
    heated = sum(np.sum(rate * each, axis=0) ** 2 for each in columns)
    mixed = sum(np.sum(rate * e, axis=0) * np.sum(many * e, axis=0) for e in columns)
    along = sum(np.sum(many * e, axis=0) ** 2 for e in columns)
    found = diffusion(dt.Body(np.diag(MOMENTS), dipole), Bath(1.0), momentum / MOMENTS)
    np.testing.assert_allclose(np.mean(heated), found.energy, rtol=1e-2)
    np.testing.assert_allclose(np.mean(mixed), found.mixed, rtol=1e-2)
    np.testing.assert_allclose(np.mean(along), found.momentum, rtol=1e-2)
    np.testing.assert_allclose(found.energy, power, rtol=1e-12)
    np.testing.assert_allclose(found.mixed, float(r), rtol=1e-12)


@pytest.mark.slow
def test_without_noise_the_mean_end_is_the_prediction():
    """L∞/L₀ of paths that start at one E and L, and cross the separatrix at any phase."""
    grain = dt.Body(np.diag([1.0, 1.3, 1.8]), [0.0, 0.0, 1.0])
    start = 1e-20 * np.array([3.0, 0.5, 1.0])
    predicted = dt.predict(grain, start)
    found = averaged_ensemble(grain, Bath(), start, [0.0, 1e44], n=1000, step=0.05)
    ratio = found.size[:, -1] / found.size[:, 0]
    near(found.mean(ratio), float(predicted.ratio), bias=0.01)
    share = predicted.probability[dt.Fate.POSITIVE]
    near(found.mean(found.well[:, -1] == 3), float(share), bias=0.01)


@pytest.mark.slow
def test_gas_alone_keeps_the_equilibrium():
    gas, times = Bath(0.0, np.diag([1e-3, 2e-3, 3e-3]), drag_heat=1.0), [0.0, 6e3, 9e3, 1.2e4]
    found = averaged_ensemble(body(1e-20), gas, [1.0, 0, 0], times, n=3000)
    late = found.omega[:, 1:]
    near(found.mean(np.mean(MOMENTS * late**2, axis=1)), np.ones(3), bias=0.005)


def test_escape_times_and_wells():
    gas = Bath(0.0, 1e-3, drag_heat=1.0)
    found = averaged_ensemble(body(1e-20), gas, [0, 0, 1.0], [0.0, 1e3], n=50)
    with pytest.raises(ValueError, match="`omega0` must make the body turn much faster than"):
        averaged_ensemble(body(1.0), Bath(1.0), [0, 0, 1.0], [0.0, 1.0], n=50)
    well = found.well
    assert set(np.unique(well)) <= {-3, -1, 1, 3}
    times = found.escape_times(well == well[:, :1])
    left = well[:, 1] != well[:, 0]
    np.testing.assert_array_equal(times[left], found.ts[1])
    assert np.all(np.isinf(times[~left]))
    with pytest.raises(ValueError, match=r"`inside` must have shape \(50, 2\)"):
        found.escape_times([True])
    assert "50 paths at 2 times from 0 to" in repr(found)


@pytest.mark.slow
def test_equilibrium_of_a_triaxial_body():
    """Means of each axis, of L² and of L⁴; and the share of the wells round the axis of J₁."""
    found = averaged_ensemble(
        body(1.0), Bath(EPS**2), [EPS / 2] * 3, np.linspace(0, 40 / EPS**2, 41), n=8192
    )
    late = found.omega[:, 10:] / EPS
    near(found.mean(np.mean(MOMENTS * late**2, axis=1)), np.ones(3), bias=0.005)
    near(found.mean(np.mean((found.size[:, 10:] / EPS) ** 2, axis=1)), 4.2, bias=0.005)
    near(found.mean(np.mean((found.size[:, 10:] / EPS) ** 4, axis=1)), 30.24, bias=0.01)
    p1, p2, p3 = 1 / MOMENTS
    high = 2 / np.pi * np.arctan(np.sqrt((p1 - p2) * MOMENTS[0] / ((p2 - p3) * MOMENTS[2])))
    near(found.mean(np.mean(np.abs(found.well[:, 10:]) == 1, axis=1)), high)


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "drag_heat", "heat"), [(1.0, 1.0, 0.25), (1.0, 0.25, 1.0)])
def test_a_rotator_in_two_baths(drag, drag_heat, heat):
    """A sphere that turns across its dipole, with a drag across it: the closed law in a plane."""
    bath = Bath(heat, np.diag([drag, drag, 0.0]), drag_heat=drag_heat)
    turning = dt.Body(np.eye(3), [0.0, 0.0, 1.0])
    found = averaged_ensemble(turning, bath, [0.5, 0, 0], np.linspace(0, 20, 9), n=8192)
    omega = np.linspace(0.0, 14.0, 20001)
    density = omega * rotator_density(omega, drag=drag, drag_heat=drag_heat, heat=heat)
    expected = np.sum(omega**2 * density) / np.sum(density)
    assert np.max(np.abs(found.omega[..., 2])) < 1e-12
    late = np.sum(found.omega[:, 3:, :2] ** 2, axis=-1)
    near(found.mean(np.mean(late, axis=1)), expected, bias=0.01)


@pytest.mark.slow
def test_the_drift_of_the_noise_is_needed():
    """Without it the motion cools down to nothing: the fault that is easy to make."""
    kicks = Kicks(body(1.0), Bath(EPS**2), (True, False))
    wrong = eqx.tree_at(lambda each: each.shift, kicks, jnp.zeros(3))
    size, count, moments = 0.05 / EPS**2, 1024, jnp.asarray(MOMENTS)
    plan = Schedule(size * np.arange(count), np.full(count, size), np.ones(count, int))
    start = jnp.broadcast_to(jnp.asarray(EPS * MOMENTS / 2)[:, None], (3, 1024))
    squares = [
        np.mean(np.sum(follow(_Averaged(each, moments), start, plan, 0)[:, 1] ** 2, axis=-1))
        for each in (kicks, wrong)
    ]
    np.testing.assert_allclose(squares[0] / EPS**2, 4.2, rtol=0.1)
    assert squares[1] < 0.4 * squares[0]


@pytest.mark.slow
def test_averaged_and_resolved_paths_agree():
    """From a fast start, braked and heated: E, |L| and their spread at four times."""
    top = body(0.004)
    bath = Bath(0.05, 0.0005, drag_heat=0.2)
    ts, start = np.array([0.0, 30.0, 100.0, 300.0]), [0.9, 0.5, 0.6]
    noisy = with_noise(dt.Reduced(top, order=1), bath)
    turning = ensemble(noisy, start, ts, n=3000, step=0.1)
    averaged = averaged_ensemble(top, bath, start, ts, n=3000, seed=1, step=0.02)
    for name in ("energy", "size"):
        one, other = (found.mean(getattr(found, name)) for found in (turning, averaged))
        error = np.hypot(one.error, other.error)
        assert np.all(np.abs(one.value - other.value) < 4 * error + 0.004 * one.value)
        one, other = (np.std(getattr(found, name)[:, 1:], axis=0) for found in (turning, averaged))
        np.testing.assert_allclose(one, other, rtol=0.06)


def test_the_equilibrium_belongs_to_the_weight_of_the_period():
    """⟨E⟩ = 3/2 and ⟨L²⟩ = ΣJ by the density |L| T e^{−E}, on both sides of the separatrix."""
    x, weights = (np.polynomial.legendre.leggauss(60)[k] for k in (0, 1))
    u = (1 + x) / 2
    places, jacobian = 1 - (1 - u) ** 4, 2 * (1 - u) ** 3 * weights
    total = np.zeros(3)
    for high, wells in ((False, 2), (True, 2)):
        for place, weight in zip(places, jacobian, strict=True):
            momentum, ordered, at, _ = orbit(place, high)
            h = float(np.sum(momentum**2 / MOMENTS))
            _, to_b, *_ = path(ordered, at, 1 - at)
            turn = diffusion(body(1.0), Bath(1.0), momentum / MOMENTS).period
            # dE dL = ½L²|to_b| dx dL, and T = T₁/L: ∫L² e^{−hL²/2}dL and its moments
            share = wells * weight * abs(float(to_b)) * float(turn) * (2 / h) ** 1.5
            total += share * np.array([1.0, 1.5, 3 / h])
    np.testing.assert_allclose(total[1:] / total[0], [1.5, 4.2], rtol=1e-5)
