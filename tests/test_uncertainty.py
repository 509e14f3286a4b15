"""Covariances and ranges carried to a fate, against closed forms and brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from dipoletop._maps.basin import Share
from dipoletop.equations._common import OfOmega
from dipoletop.uncertainty import Estimate, Index, Propagation, SobolIndices, propagate, sobol

START = jnp.array([1.0, 0.0, 0.0])


class Told(OfOmega):
    """An equation whose fate is known at the start: ω∞ is a number, 0 a stop, NaN not known."""

    value: jax.Array

    def __call__(self, t, y, args=None):
        return -y

    def verdict(self, y):
        outcome = jnp.where(jnp.isnan(self.value), 0, jnp.where(self.value == 0, 2, 1))
        return outcome, self.value, outcome > 0


def plane(a, b):
    return Told(0.5 + 2 * a - b), START


def half_plane(a, b):
    value = 0.5 + 2 * a - b
    return Told(jnp.where(value > 0, value, 0.0)), START


COVARIANCE = np.array([[0.004, 0.001], [0.001, 0.009]])
LINEAR_STD = np.sqrt(4 * 0.004 - 4 * 0.001 + 0.009)  # of 2a − b


def near(estimate, truth):
    return abs(estimate.value - truth) < 4 * estimate.error


@pytest.mark.slow
def test_a_linear_fate_has_the_variance_of_the_law():
    mean = {"a": 0.5, "b": 0.5}  # ω∞ = 1, nearly seven standard deviations from 0
    found = propagate(plane, mean, COVARIANCE, n=4000, seed=3)
    assert found.omega_inf == 1
    assert found.gradient == {"a": 2.0, "b": -1.0}
    np.testing.assert_allclose(found.linear_std, LINEAR_STD, rtol=1e-12)
    assert found.trusted
    assert found.other.count == 0 < found.other.high < 1e-3
    assert found.shares["RESIDUAL"].count == 4000
    assert near(found.mean, 1.0)
    assert near(found.std, LINEAR_STD)
    # of a normal distribution
    np.testing.assert_allclose(found.mean.error, LINEAR_STD / np.sqrt(4000), rtol=0.05)
    np.testing.assert_allclose(found.std.error, LINEAR_STD / np.sqrt(8000), rtol=0.1)
    assert found == propagate(plane, mean, COVARIANCE, n=4000, seed=3)
    assert found.mean != propagate(plane, mean, COVARIANCE, n=4000, seed=4).mean


def test_beside_a_boundary_the_shares_are_those_of_the_normal_distribution():
    mean = {"a": 0.0, "b": 0.5 - LINEAR_STD}  # one standard deviation from the stops
    found = propagate(half_plane, mean, COVARIANCE, n=4000)
    inside = norm.cdf(1)
    share = found.shares["RESIDUAL"]
    assert abs(share.share - inside) < 4 * np.sqrt(inside * (1 - inside) / 4000)
    assert share.low < inside < share.high
    assert found.other == found.shares["STOP"]
    assert not found.trusted
    # the normal distribution cut off at −1
    shift = norm.pdf(1) / inside
    assert near(found.mean, LINEAR_STD * (1 + shift))
    assert near(found.std, LINEAR_STD * np.sqrt(1 - shift - shift**2))


def test_the_other_sign_is_another_fate():
    found = propagate(plane, {"a": 0.0, "b": 0.5 - LINEAR_STD}, COVARIANCE, n=4000)
    assert list(found.shares) == ["RESIDUAL"]
    assert found.other.low < norm.cdf(-1) < found.other.high
    assert not found.trusted


@pytest.mark.parametrize(
    ("covariance", "std"),
    [
        (np.diag([1e-4, 0.0]), 2e-2),
        (np.full((2, 2), 1e-4), 1e-2),  # a and b vary together: 2 − 1
        ([[1e-20, 5e-12], [5e-12, 1e-2]], np.sqrt(4e-20 - 4 * 5e-12 + 1e-2)),  # in uneven units
        (np.zeros((2, 2)), 0.0),
    ],
)
def test_a_covariance_may_be_singular_or_uneven(covariance, std):
    found = propagate(plane, {"a": 0.0, "b": 0.0}, covariance, n=4000)
    np.testing.assert_allclose(found.linear_std, std, rtol=1e-7, atol=1e-12)
    assert abs(found.std.value - std) <= 4 * found.std.error + 1e-12


def test_what_is_not_known_at_the_mean_is_not_told():
    def lost(a, b):
        return Told(jnp.sqrt(a + b)), START

    mean = {"a": -0.5, "b": -0.5}
    found = propagate(lost, mean, np.diag([0.25, 0.0]), n=1000, max_steps=5)
    assert np.isnan([found.omega_inf, found.gradient["a"], found.linear_std]).all()
    assert not found.trusted
    assert found.other.share == 1  # also of the draws that end as the mean does, unknown
    assert found.shares["UNDECIDED"].low < norm.cdf(2) < found.shares["UNDECIDED"].high
    certain = propagate(lost, mean, np.zeros((2, 2)), n=10, max_steps=5)
    assert np.isnan([*certain.mean, *certain.std]).all()


def test_indices_of_ishigami():
    def problem(x, y, z):
        return Told(jnp.sin(x) * (1 + 0.1 * z**4) + 7 * jnp.sin(y) ** 2), START

    found = sobol(problem, dict.fromkeys("xyz", (-np.pi, np.pi)), n=4096)
    b, p8 = 0.1 * np.pi**4, 0.1**2 * np.pi**8
    alone, cross = (1 + b / 5) ** 2 / 2, p8 / 18 - p8 / 50  # Ishigami & Homma 1990
    variance = alone + 49 / 8 + cross
    first = np.array([alone, 49 / 8, 0]) / variance
    total = np.array([alone + cross, 49 / 8, cross]) / variance
    for indices, truth in ((found.first, first), (found.total, total)):
        assert list(indices) == list("xyz")
        value, low, high = np.array(list(indices.values())).T
        assert np.max(np.abs(value - truth)) < 0.01
        assert np.all((low < truth) & (truth < high))
        assert np.all(high - low < 0.2)
    np.testing.assert_allclose((found.mean, found.variance), (3.5, variance), rtol=0.01)
    assert (found.runs, found.unknown) == (5 * 4096, 0)


def test_indices_are_variances_of_conditional_means():
    """Of ω∞, or of 1 for a rotation of either sense; z does nothing."""

    def value(x, y, np=np):
        return -np.maximum(np.sin(3 * x) * y - 0.2 * x, 0.0)

    def problem(x, y, z):
        return Told(value(x, y, jnp)), START

    middles = (np.arange(1000) + 0.5) / 1000
    omega_inf = value(2 * middles[:, None], middles - 0.2)
    bounds = {"x": (0.0, 2.0), "y": (-0.2, 0.8), "z": (0.0, 1.0)}
    for target, f in (("omega_inf", omega_inf), ("residual", 1.0 * (omega_inf < 0))):
        found = sobol(problem, bounds, n=4096, target=target)
        assert found.target == target
        for name, along, across in (("x", 1, 0), ("y", 0, 1)):
            assert abs(found.first[name].value - f.mean(along).var() / f.var()) < 0.02
            assert abs(found.total[name].value - (1 - f.mean(across).var() / f.var())) < 0.02
        assert found.first["z"] == found.total["z"] == (0, 0, 0)
        np.testing.assert_allclose((found.mean, found.variance), (f.mean(), f.var()), rtol=0.02)


def test_a_single_parameter_explains_all():
    found = sobol(lambda x: (Told(1 + x), START), {"x": (0.0, 1.0)}, n=1024)
    assert found.runs == 3 * 1024
    assert found.first["x"].value == pytest.approx(1, abs=0.02)
    assert found.total["x"].value == pytest.approx(1, abs=0.02)


def test_few_unknown_runs_are_replaced_and_many_refused():
    def problem(x, y):
        return Told(jnp.where(x > 0.99, jnp.nan, 1 + y)), START

    bounds = {"x": (0.0, 1.0), "y": (0.0, 1.0)}
    found = sobol(problem, bounds, n=512, most_unknown=0.02, max_steps=5)
    assert found.unknown == pytest.approx(0.01, abs=0.003)
    assert found.first["y"].value == pytest.approx(1, abs=0.05)
    assert found.first["x"].value == pytest.approx(0, abs=0.05)
    with pytest.raises(ValueError, match=r"`most_unknown` must be at least .*, but that share is"):
        sobol(problem, bounds, n=512, most_unknown=0.005, max_steps=5)


def test_summaries_show_estimates_with_their_errors():
    assert repr(Estimate(0.25, 0.01)) == "0.25 ± 0.01"
    shares, other = {"STOP": Share(1.0, 0.9, 1.0, 40)}, Share(0.0, 0.0, 0.1, 0)
    unknown = Estimate(np.nan, np.nan)
    assert repr(Propagation(0.5, {"a": 2.0}, 0.1, shares, other, unknown, unknown)).startswith(
        "Propagation(omega_inf=0.5, gradient={a: 2}, linear_std=0.1, shares={STOP: "
    )
    indices = {"a": Index(0.25, 0.2, 0.3)}
    assert "first={a: 0.25 [0.2, 0.3]}" in repr(
        SobolIndices("residual", indices, indices, 0.5, 0.25, 12, 0.0)
    )
