"""Fits against series from an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop.fitting import Fit, FitEnd, fit

TIMES = np.linspace(0.0, 60.0, 25)
TRUTH = {"delta": -0.2, "w3": 0.25, "phi": 0.7}
GUESS = {"delta": 0.1, "w3": 0.2, "phi": 0.5}


def top(delta, w3, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(w3 * 1.2, w3, phi)


def measured(delta, w3, phi):
    """ω at the times by scipy, from the semi-reduced equation as physics has it."""

    def rate(_, w):
        w1, w2, w3 = w
        square = w @ w
        left = [[1, 2 * w1], [-2 * w1, 1 - delta]]
        right = [
            -delta * w1 * w3 - square * w2 - delta * (1 + delta) * w2 * w3**2,
            -square * w3 + delta * w2**2 * w3,
        ]
        return [delta * w2 * w3, *np.linalg.solve(left, right)]

    start = [1.2 * w3 * np.cos(phi), 1.2 * w3 * np.sin(phi), w3]
    run = solve_ivp(rate, TIMES[[0, -1]], start, "DOP853", TIMES, rtol=1e-12, atol=1e-14)
    return run.y.T


CLEAN = measured(**TRUTH)


@pytest.fixture(scope="module")
def slope():
    """∂ω/∂p of the independent route, by central differences of order 4."""

    def along(name, h=1e-3):
        a, b, c, d = (measured(**TRUTH | {name: TRUTH[name] + k * h}) for k in (-2, -1, 1, 2))
        return (a - 8 * b + 8 * c - d) / (12 * h)

    return np.stack([along(name) for name in TRUTH], axis=-1)


def noisy(seed, sigma):
    return CLEAN + sigma * np.random.default_rng(seed).normal(size=CLEAN.shape)


def test_a_clean_series_gives_its_parameters_back():
    found = fit(top, TIMES, CLEAN, GUESS)
    assert found.success
    for name, value in TRUTH.items():
        assert abs(found.parameters[name] - value) < 1e-8
    assert found.chi2 < 1e-18
    assert found.dof == 72
    assert found.steps < 40


def test_the_covariance_is_the_inverse_of_fishers_matrix(slope):
    sigma = np.where(TIMES < 30, 1e-3, 4e-3)[:, None]  # one for every time
    found = fit(top, TIMES, noisy(1, sigma), GUESS, sigma=sigma)
    assert found.success
    rows = (slope / sigma[..., None]).reshape(-1, 3)
    fisher = np.linalg.inv(rows.T @ rows)
    units = np.sqrt(np.diag(fisher))
    np.testing.assert_allclose(
        found.covariance / np.outer(units, units), fisher / np.outer(units, units), atol=0.02
    )
    np.testing.assert_allclose(list(found.errors.values()), units, rtol=0.02)
    assert abs(found.chi2 - found.dof) < 4 * np.sqrt(2 * found.dof)


def test_refits_scatter_as_the_covariance_says():
    """χ² of 3 parameters, summed over 16 noisy series: mean 48, standard deviation √96."""
    distance, inside = 0.0, 0.0
    for seed in range(16):
        found = fit(top, TIMES, noisy(seed, 1e-3), TRUTH)
        assert found.success
        error = np.array([found.parameters[name] - TRUTH[name] for name in TRUTH])
        distance += error @ np.linalg.solve(found.covariance, error)
        inside += found.chi2 / found.dof
    assert abs(distance - 48) < 4 * np.sqrt(96)
    assert abs(inside / 16 - 1e-6) < 4e-6 * np.sqrt(2 / (72 * 16))


def test_without_sigma_the_residuals_give_it():
    series = noisy(3, 1e-3)
    unscaled = fit(top, TIMES, series, TRUTH, sigma=1.0)
    scaled = fit(top, TIMES, series, TRUTH)
    assert scaled.parameters == unscaled.parameters
    factor = unscaled.chi2 / unscaled.dof
    np.testing.assert_allclose(scaled.covariance, unscaled.covariance * factor, rtol=1e-12)


def test_an_end_that_is_no_minimum_is_said_to_be_none():
    short = fit(top, TIMES, CLEAN, GUESS, max_trajectories=3)
    assert not short.success
    assert short.end is FitEnd.BUDGET
    assert short.message == "No minimum within 3 trajectories."
    assert short.steps == 3
    beyond = fit(top, TIMES, measured(-1.2, 0.25, 0.7), GUESS | {"delta": -0.9})
    assert not beyond.success
    assert beyond.end is FitEnd.REFUSED
    assert "refuses" in beyond.message
    assert -1 <= beyond.parameters["delta"] < -0.99


def test_a_local_minimum_that_does_not_describe_the_series_is_no_success():
    guess = {name: GUESS[name] for name in ("delta", "w3")}
    found = fit(lambda delta, w3: top(delta, w3, 0.9), TIMES, CLEAN, guess, sigma=1e-3)
    assert found.chi2 > 100 * found.dof
    assert not found.success
    assert found.end is FitEnd.POOR


def test_a_series_that_says_nothing_has_no_covariance():
    rest = fit(top, TIMES, 0 * CLEAN, {"delta": 0.0, "w3": 0.0, "phi": 0.0})
    assert not rest.success
    assert "does not determine" in rest.message
    assert np.isnan(rest.covariance).all()
    assert np.isnan(list(rest.errors.values())).all()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"series": CLEAN[:, 0]}, r"`series` must have shape \(25, 3\), but has shape \(25,\)"),
        ({"series": CLEAN * np.nan}, r"`series` must be finite"),
        (
            {"ts": [0.0, 1.0], "series": CLEAN[:1, :2], "observe": lambda run: run.omega[:1, :2]},
            r"`series` must hold more than 3 values, one for each parameter, but holds 2",
        ),
        ({"ts": TIMES[::-1]}, r"`ts` must increase"),
        ({"sigma": 0.0}, r"`sigma` must be positive, but has 0"),
        ({"sigma": np.ones(25)}, r"`sigma` must broadcast to the series, shape \(25, 3\)"),
        ({"sigma": np.nan}, r"`sigma` must be finite"),
        ({"guess": GUESS | {"delta": 1.0}}, r"`delta` must lie in \[-1, 1\), but is 1"),
        ({"guess": {"delta": 0.0}}, r"`guess` must name the arguments of `problem`"),
        ({"guess": GUESS | {"w3": np.inf}}, r"`guess\['w3'\]` must be finite"),
        ({"rtol": 2.0}, r"`rtol` must lie between"),
        ({"max_trajectories": 0}, r"`max_trajectories` must be a positive whole number"),
    ],
)
def test_fit_refuses(change, match):
    given = {"ts": TIMES, "series": CLEAN, "guess": GUESS} | change
    with pytest.raises(ValueError, match=match):
        fit(top, **given)


def test_a_summary_has_the_parameters_with_their_errors():
    best = Fit({"a": 2.0}, np.array([[0.01]]), 9.5, 10, 7, True, "", FitEnd.MINIMUM)
    assert repr(best) == "Fit(parameters={a: 2 ± 0.1}, chi2=9.5, dof=10, steps=7, end=MINIMUM)"
