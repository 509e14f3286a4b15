"""The unfolding against the equation of motion, resolved runs, capture, and the slow flow."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop import prediction
from dipoletop._averaging.capture import capture
from dipoletop._averaging.laws import (
    Needle,
    SlowFlow,
    averaged_end,
    averaged_law_and_end,
    coverage,
    half_time_from,
    unfolded_end,
)
from dipoletop._averaging.planar_orbits import Expansion, PlanarMotion, entry_q, settle
from dipoletop._averaging.predicted_ends import Start
from dipoletop._averaging.unfolding import phases

ONE = jnp.asarray(np.float64(1))
DIRECTION = np.array([0.5, 0.3, 0.8])
rate = eqx.filter_jit(lambda equation, y: equation(0.0, y))


def _body(delta, eta):
    return dt.Body(jnp.diag(jnp.array([1.0, 1 - eta, 1 - delta])), [1.0, 0.0, 0.0])


def _variables(delta, eta, omega):
    body = _body(delta, eta)
    return jnp.concatenate([body.inertia.ravel(), body.dipole, jnp.asarray(omega)])


def _start(size, phi, z):
    """The ω of ω⊥ = `size`."""
    return size * np.array([np.cos(phi), np.sin(phi), z * size])


@pytest.mark.parametrize("delta", [-0.2, 0.4])
def test_semi_reduced_level_tends_to_the_unfolded_system(delta):
    """For |η| ~ u, of both signs; the difference is of the order u."""
    for size, largest in ((1e-2, 1e-2), (1e-3, 1e-4)):
        u = size**2
        for asymmetry in (-1.5, 3.0):
            equation = dt.SemiReduced(_body(delta, asymmetry * u))
            for phi, z in ((0.3, 3.0), (1.2, -2.0)):
                w1, w2, w3 = _start(size, phi, z)
                r1, r2, r3 = np.asarray(rate(equation, np.array([w1, w2, w3])))
                fall = 2 * (w1 * r1 + w2 * r2)
                rates = [w1 * r2 - w2 * r1, r3 - w3 * fall / u, fall]
                plane = PlanarMotion(jnp.asarray(delta), jnp.asarray(asymmetry))
                expected = rate(plane, np.array([phi, z, 0.0]))
                np.testing.assert_allclose(np.array(rates) / u**2, expected, atol=largest)


@pytest.mark.parametrize(("delta", "asymmetry"), [(0.4, 2.0), (0.4, -0.7), (-0.2, -5.0)])
def test_loss_at_the_residual_line_is_that_of_an_integration(delta, asymmetry):
    plane = PlanarMotion(jnp.asarray(delta), jnp.asarray(asymmetry))
    y = np.array([np.pi + 1e-4, 3e-4 / delta, 0.0])
    last = solve_ivp(lambda t, y: np.asarray(rate(plane, y)), (0, 60), y, rtol=1e-10, atol=1e-14).y
    det, loss = eqx.filter_jit(PlanarMotion.line)(plane, jnp.asarray(y))
    assert float(loss) == pytest.approx(-last[2, -1], rel=1e-5)
    slopes = jax.jit(jax.jacfwd(rate, argnums=1))(plane, np.array([np.pi, 0.0, 0.0]))
    assert float(det) == pytest.approx(np.linalg.det(slopes[:2, :2]), rel=1e-12)


@pytest.mark.slow
def test_a_vanishing_asymmetry_leaves_the_capture_of_the_axisymmetric_top():
    """Sampled phases of η = 0 have the mean and quantiles of the closed distribution."""
    delta = jnp.asarray(0.4)

    @jax.jit
    def sampled(ratio):
        plane = PlanarMotion(delta, ratio)
        q = entry_q(delta, ratio)
        lanes = jax.vmap(lambda y: settle(plane, y))(phases(plane, q))
        return lanes, Expansion(-1.5 * delta / (1 - delta)).log_w(q)

    exact = jax.jit(capture)(delta)
    for ratio, rel in ((0.0, 1e-3), (1e-6, 2e-3)):
        lanes, log_w = sampled(jnp.asarray(ratio))
        x = np.exp(lanes.log_ratio - log_w)
        assert np.all(lanes.residual)
        assert np.mean(x) == pytest.approx(float(jnp.exp(exact.log_mean)), rel=rel)
        quantiles = np.quantile(x, [0.25, 0.5, 0.75])
        found = np.exp(exact.log_quantiles([0.25, 0.5, 0.75]))
        np.testing.assert_allclose(quantiles, found, rtol=1e-2)


KNOWN = [(0.4, r) for r in (-3, -0.3, 0.3, 30)] + [(-0.2, r) for r in (-3, 0, 0.3, 30)]


@pytest.mark.slow
def test_starts_of_known_phase_end_as_resolved_runs_do():
    """Labels agree, and ω∞ within the estimated error, for discs and needles of any η/u."""
    rng = np.random.default_rng(3)
    compared = 0
    for size, delta, asymmetry in [(1e-3, *x) for x in KNOWN] + [(1e-4, 0.4, 0.3), (1e-4, -0.2, 0)]:
        eta = asymmetry * size**2
        angles, z = rng.uniform(0, 2 * np.pi, 4), rng.uniform(-4, 4, 4) / abs(delta)
        starts = np.array([_start(size, *each) for each in zip(angles, z, strict=True)])
        runs = dt.classify_many(dt.SemiReduced(_body(delta, eta)), starts, value="unchecked")
        for k, start in enumerate(starts):
            axial = 0 if delta > 0 else 2
            end = unfolded_end(_variables(delta, eta, start), ONE, axial, False)
            if end.outcome == dt.Outcome.UNDECIDED:  # neighbours end otherwise
                assert end.error == 0.5
                continue
            assert end.outcome == runs.outcome[k]
            if runs.outcome[k] == dt.Outcome.RESIDUAL and jnp.isfinite(end.omega_inf):
                assert abs(float(end.omega_inf / runs.omega_inf[k] - 1)) < end.error
                compared += 1
    assert compared > 12


@pytest.mark.slow
@pytest.mark.parametrize(("delta", "asymmetry"), [(0.8, -0.1), (0.9, -0.025), (0.8, 1e-3)])
def test_random_phases_end_as_often_residual_as_resolved_runs(delta, asymmetry, monkeypatch):
    monkeypatch.setattr(prediction, "HANDOVER", np.inf)
    rng = np.random.default_rng(11)
    starts = np.empty((200, 3))
    flat, angles = np.hypot(*DIRECTION[:2]), rng.uniform(0, 2 * np.pi, 200)
    starts[:, 0], starts[:, 1] = flat * np.cos(angles), flat * np.sin(angles)
    starts[:, 2] = DIRECTION[2] * rng.uniform(0.96, 1.04, 200)  # some turns more or less
    body = _body(delta, asymmetry * 1e-6)
    runs = dt.classify_many(dt.SemiReduced(body), 1e-3 * starts, value="unchecked")
    momentum = 1e-3 * np.linalg.norm(starts * [1, 1, 1 - delta], axis=1)
    residual = np.asarray(runs.outcome == dt.Outcome.RESIDUAL)
    ratio = np.where(residual, np.abs(runs.omega_inf), 0.0) / momentum
    predicted = dt.predict(body, 1e-3 * DIRECTION)
    assert predicted.regime == dt.Regime.UNFOLDED
    share = float(predicted.probability[:2].sum())
    spread = np.sqrt(share * (1 - share) / 200) + 1 / 256
    assert abs(np.mean(residual) - share) < 3 * spread
    assert abs(np.mean(ratio) - predicted.ratio) < 3 * np.std(ratio) / np.sqrt(200)
    for level, quantile in zip((0.25, 0.5, 0.75), predicted.ratio_quantiles[1:4], strict=True):
        assert np.mean(ratio < float(quantile) * 0.99) < level + 0.1
        assert np.mean(ratio <= float(quantile) * 1.01) > level - 0.1


@pytest.mark.slow
def test_slow_flow_and_unfolding_agree_within_their_errors():
    """And the smaller error is taken; a slow flow of small error is not compared."""
    regimes = []
    for delta in (0.4, 0.8):
        for asymmetry in (1e-2, 1.0, 1e2, 1e6):
            variables = _variables(delta, asymmetry * 1e-10, 1e-5 * DIRECTION)
            slow = averaged_end(variables, ONE, Needle.NO)
            turns, errors = coverage(variables, ONE)
            best = averaged_law_and_end(Start(variables, ONE), SlowFlow(Needle.NO))[1]
            regimes.append(int(best.regime))
            if not jnp.isfinite(errors[0]):
                assert best.regime == dt.Regime.SLOW_FLOW
                continue
            assert turns[0]
            end = unfolded_end(variables, ONE, 0, True)
            assert abs(float(end.ratio / slow.ratio - 1)) < slow.error + end.error
            np.testing.assert_allclose(end.ratio_quantiles[1:], slow.ratio, rtol=float(slow.error))
            assert best.error == jnp.minimum(slow.error, end.error)
    assert set(regimes) == {dt.Regime.SLOW_FLOW, dt.Regime.UNFOLDED}


def test_a_half_time_of_known_phase_is_that_of_the_equations():
    """The semi-reduced level by another integrator; any L∞/L₀ tells which energy is half."""
    delta, omega, ratio = 0.5, np.array([9e-7, 5e-7, 2e-13]), 0.9
    inertia = np.array([1.0, 1.0, 1 - delta])

    def energy(w):
        return inertia @ w**2 / 2

    last = (ratio * np.linalg.norm(inertia * omega)) ** 2 / 2
    half = (energy(omega) + last) / 2 / energy(omega)

    def rates(t, w):
        w1, w2, w3 = w
        right = [
            -delta * w1 * w3 - (w @ w + delta * (1 + delta) * w3**2) * w2,
            -(w @ w - delta * w2**2) * w3,
        ]
        left = np.array([[1, 2 * w1], [-2 * w1, 1 - delta]])
        return [delta * w2 * w3, *np.linalg.solve(left, right)]

    def above(t, w):
        return energy(w) / energy(omega) - half

    above.terminal = True
    settings = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-24, "events": above}
    run = solve_ivp(rates, (0, 1e15), omega, **settings)
    found = half_time_from(_variables(delta, 0.0, omega), ONE, jnp.asarray(ratio))
    assert float(found) == pytest.approx(run.t[-1], rel=1e-5)
