"""Pictures of continuations: curves, bands, hatching, thresholds."""

import dataclasses
import subprocess
import sys
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dipoletop import plots
from dipoletop._base.types import Outcome
from dipoletop.continuation import Continuation, continuation, follow_spectrum
from dipoletop.equations.levels import Level

# Functions bear the names of these modules, so the modules are taken by what they define.
ANALYSIS = sys.modules[Continuation.__module__]
PICTURES = sys.modules[plots.diagram.__module__]
N = 1000
DELTAS = [-0.9, -0.5, -0.4, -0.2, -0.1, 0.3, 0.76]


@pytest.fixture(scope="module")
def shapes():
    return continuation(DELTAS, n=N)


def test_keywords_reach_the_curves(shapes):
    order_1 = Continuation("delta", (Level.ORDER_1,), shapes.basins[:1])
    curve: Any = plots.continuation(order_1, c="red", lw=7).lines[0]
    assert (curve.get_color(), curve.get_linewidth()) == ("red", 7)


def test_a_diagram_shows_fractions_and_growth(shapes, monkeypatch):
    def at_deltas(delta, w, *, levels):  # of these the program is compiled already
        assert (delta[0], delta[-1]) == (-0.9, 0.76)
        return follow_spectrum(DELTAS, w, levels=levels)

    monkeypatch.setattr(ANALYSIS, "follow_spectrum", at_deltas)
    monkeypatch.setattr(PICTURES, "follow_spectrum", at_deltas)
    order_1 = Continuation("delta", (Level.ORDER_1,), shapes.basins[:1])
    above, below = plots.diagram(order_1).axes
    lines: Any = above.lines, below.lines
    assert above.get_shared_x_axes().joined(above, below)
    share = shapes.fractions(Outcome.RESIDUAL).share[0]
    np.testing.assert_array_equal(lines[0][0].get_xydata(), np.column_stack([DELTAS, share]))
    for ax in lines:
        marked = [line.get_xdata()[0] for line in ax if line.get_color() == "0.4"]
        np.testing.assert_allclose(marked, [-0.5, 0], atol=1e-9)
    d, falling = lines[1][0].get_xydata().T
    np.testing.assert_allclose(falling, -(1 + 2 * d) / (1 - d), rtol=1e-9, atol=1e-9)


def test_a_curve_ends_where_too_little_is_decided(shapes, monkeypatch):
    monkeypatch.setattr(PICTURES, "thresholds", lambda continuation: [])
    basin = shapes.basins[1]
    outcome = basin.outcome.copy()
    outcome[-1, 0, : N // 2] = Outcome.UNDECIDED
    basin = dataclasses.replace(basin, columns={**basin.columns, "outcome": outcome.ravel()})
    half = Continuation("delta", (Level.SEMI,), (basin,))
    _, ax = plt.subplots()
    assert plots.continuation(half, ax=ax) is ax
    assert np.flatnonzero(np.isnan(ax.lines[0].get_ydata())).tolist() == [len(DELTAS) - 1]
    corners = ax.collections[1].get_paths()[0].vertices
    hatched = sorted({y for x, y in np.asarray(corners) if x == DELTAS[-1]})
    residual, stop = (half.fractions(end).share[0, -1] for end in (Outcome.RESIDUAL, Outcome.STOP))
    np.testing.assert_allclose(hatched, [residual, 1 - stop])


@pytest.mark.parametrize(
    ("amplitudes", "scale"),
    [([0.01, 0.02, 0.3], "linear"), ([0.01, 0.1, 1.0], "log"), ([0.1, 0.2, 0.3], "linear")],
)
def test_amplitudes_have_the_scale_on_which_they_are_even(shapes, amplitudes, scale):
    basin = shapes.basins[1]
    axes = {"delta": np.array([-0.2]), "amplitude": np.array(amplitudes)}
    columns = {name: basin.column(name)[:3].ravel() for name in ("outcome", "stop")}
    basin = dataclasses.replace(
        basin, shape=(1, 3, N), coords={**basin.coords, **axes}, columns=columns
    )
    ax = plots.continuation(Continuation("amplitude", (Level.SEMI,), (basin,)))
    assert ax.get_xscale() == scale
    assert ax.get_title().endswith("= $-0.2$")


@pytest.mark.system
def test_matplotlib_waits_for_a_picture():
    script = (
        "import sys, dipoletop; "
        "from dipoletop import adaptive, boundary, complexity, continuation, fitting, uncertainty; "
        "assert 'matplotlib' not in sys.modules; dipoletop.plots.basin"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
