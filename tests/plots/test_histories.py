"""Pictures of histories: curves, bands, marks of the axes of rotation, refusals."""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import plots
from dipoletop.plots import histories
from dipoletop.plots.histories import Curves
from dipoletop.prediction import Prediction

TIMES = np.geomspace(1.0, 1e4, 9)
MOMENTS = np.array([0.5, 0.8, 1.0])


def prediction(*outcomes, strength=2.0):
    """Predictions whose numbers are not computed."""
    n = len(outcomes)
    residual = np.array([outcome == dt.Outcome.RESIDUAL for outcome in outcomes], float)
    probability = np.zeros((n, 8))
    probability[:, 0], probability[:, 4] = residual, 1 - residual
    numbers = {name: jnp.ones(n) for name in ("omega_inf", "half_time", "radiated_energy", "error")}
    return Prediction(
        outcome=jnp.array(outcomes),
        probability=jnp.array(probability),
        ratio=jnp.array(residual / 4),
        ratio_quantiles=jnp.ones((n, 5)),
        lifetime=jnp.full(n, jnp.inf),
        regime=jnp.ones(n, int),
        variables=jnp.ones((n, 15)),
        strength=strength,
        **numbers,
    )


@pytest.fixture
def drawn(monkeypatch):
    """The picture of given curves E/E₀; L and h follow from them."""

    def draw(energy, predictions, **settings):
        curves = Curves(
            TIMES, energy, np.sqrt(energy), 1 + energy, MOMENTS[2] / MOMENTS[::-1], 10.0
        )
        monkeypatch.setattr(histories, "curves_of", lambda *_: curves)
        return plots.history(predictions, **settings)

    return draw


def test_one_rotation_is_a_curve(drawn):
    energy = (0.1 + 0.9 / (1 + TIMES / 10))[None]
    above, middle, below = drawn(energy, prediction(dt.Outcome.RESIDUAL)).axes[:3]
    for ax, values in ((above, energy), (middle, np.sqrt(energy)), (below, 1 + energy)):
        np.testing.assert_array_equal(ax.lines[0].get_data(), (TIMES, values[0]))
        assert ax.get_xscale() == "log"
    assert above.get_title(loc="left") == r"Residual rotation, $L_\infty/L_0 = 0.25$"
    assert above.lines[1].get_xdata()[0] == 10.0
    (right,) = below.child_axes
    marks = {
        label.get_text(): tick
        for label, tick in zip(right.get_yticklabels(), right.get_yticks(), strict=True)
    }
    assert marks == {"about $J_3$": 1.0, "separatrix": 1.25, "about $J_1$": 2.0}
    assert {label.get_va() for label in right.get_yticklabels()} == {"center"}  # at their lines


def test_many_rotations_are_bands_as_far_as_they_are_known(drawn):
    energy = np.linspace(0.2, 1.0, 21)[:, None] * np.ones(9)
    energy[3, 4:] = np.nan  # one of 21 is less than 5 %
    energy[7, 6:] = np.nan
    outcomes = [dt.Outcome.RESIDUAL] * 15 + [dt.Outcome.STOP] * 6
    above, middle, _ = drawn(energy, prediction(*outcomes)).axes[:3]
    times, median = above.lines[0].get_data()
    np.testing.assert_array_equal(times, TIMES[:6])
    np.testing.assert_allclose(median[:4], 0.6)
    x, band = above.collections[1].get_paths()[0].vertices.T
    whole = band[x <= TIMES[3]]
    assert (whole.min(), whole.max()) == (pytest.approx(0.24), pytest.approx(0.96))
    legend = [text.get_text() for text in middle.get_legend().get_texts()]
    assert legend == ["median", "25 – 75 %", "5 – 95 %"]
    assert above.get_title(loc="left") == "21 starts: 71.4 % residual rotation, 28.6 % stop"


def test_units_and_given_axes(drawn):
    energy = (1 / (1 + TIMES))[None]
    _, given = plt.subplots(3)
    figure = drawn(energy, prediction(dt.Outcome.STOP, strength=1.0), axes=given)
    assert figure is given[0].figure
    assert given[2].get_xlabel() == r"time $\tau = t/\tau_0$"
    assert not given[0].child_axes
    (years,) = drawn(energy, prediction(dt.Outcome.STOP)).axes[0].child_axes
    assert years.get_xlabel() == "time (years)"


def test_bad_arguments_are_refused(drawn):
    good = prediction(dt.Outcome.STOP)
    with pytest.raises(ValueError, match="`prediction` must not be FAILED, but is"):
        plots.history(prediction(dt.Outcome.FAILED))
    with pytest.raises(ValueError, match="`times` must be positive and rising, but are not"):
        plots.history(good, times=[2.0, 1.0])
    with pytest.raises(ValueError, match="`axes` must be three axes, or None, but has 1"):
        plots.history(good, axes=plt.subplots(1, squeeze=False)[1])
