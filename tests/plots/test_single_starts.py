"""Starts as dots: along one axis, and over two quantities of single starts."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_basins import R, S, U, legend, made, sample
from matplotlib import colormaps
from matplotlib.colors import to_rgba

import dipoletop as dt
from dipoletop import Stop, plots
from dipoletop.plots.column_shading import SIGNED
from dipoletop.plots.map_layout import CLASSES

BLUE, GREY = (CLASSES[outcome, Stop.NONE][1] for outcome in (R, S))


def along_delta(outcome, omega_inf):
    axes = {"w_perp": [0.2], "delta": np.linspace(-0.4, 0.2, len(outcome))}
    return made([outcome], np.array([omega_inf]), axes=axes)


def drawn(ax):
    return {line.get_color(): line.get_xydata() for line in ax.lines if line.get_marker() == "o"}


def test_a_column_against_the_only_axis():
    found = along_delta([R, S, R, U], [0.1, 0.0, -0.2, np.nan])
    ax = plots.line(found)
    dots = drawn(ax)
    np.testing.assert_allclose(dots[BLUE], [[-0.4, 0.1], [0.0, -0.2]], atol=1e-15)
    np.testing.assert_allclose(dots[GREY], [[-0.2, 0.0]], atol=1e-15)
    unknown = [line for line in ax.lines if line.get_marker() == "|" and len(line.get_xdata())]
    (mark,) = unknown
    np.testing.assert_allclose(mark.get_xdata(), [0.2])
    assert legend(ax) == ["residual rotation", "stop", "undecided"]
    assert ax.get_xlabel() == r"$\delta$"
    assert r"$\omega_\perp$ = 0.2" in ax.get_title()
    assert ax.get_yscale() == "linear"
    squares = [line for line in plots.line(found, marker="s", ms=9).lines if len(line.get_xdata())]
    assert {(line.get_marker(), line.get_markersize()) for line in squares} == {("s", 9), ("|", 9)}


def test_times_are_logarithmic_and_other_axes_are_fixed():
    axes = {"w_perp": [0.1, 0.2], "delta": [-0.3, -0.2, -0.1]}
    time = np.array([[1.0, 10, 100], [2.0, 20, 200]])
    ax = plots.line(made([[R] * 3, [S] * 3], time=time, axes=axes), "time", at={"w_perp": 0.19})
    assert ax.get_yscale() == "log"
    np.testing.assert_array_equal(drawn(ax)[GREY][:, 1], [2.0, 20.0, 200.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"`basin` must have one axis of numbers .* has w_perp, delta of lengths \(2, 3\)"),
        ({"column": "certified"}, "`column` must name a column of numbers"),
        ({"column": "speed"}, "`column` must be a column of this basin"),
    ],
)
def test_line_refuses(options, message):
    with pytest.raises(ValueError, match=message):
        plots.line(made([[R] * 3, [S] * 3]), **options)
    assert plt.get_fignums() == []


def test_a_sample_is_a_map_of_directions():
    ax = plots.starts(sample([R, R, S, S], [0.1, -0.1, 0.0, 0.0]))
    (dots,) = ax.collections
    expected = [[0, 0], [np.pi / 2, 0], [1.5 * np.pi, 0.5**0.5], [0, -1]]
    np.testing.assert_allclose(dots.get_offsets(), expected, atol=1e-15)
    colours = [SIGNED(1.0), SIGNED(0.0), to_rgba(GREY), to_rgba(GREY)]
    np.testing.assert_allclose(dots.get_facecolors(), colours, atol=0.01)
    assert (ax.get_xlabel(), ax.get_ylabel()[:17]) == (r"$\varphi$", r"$\cos\vartheta = ")


def test_starts_over_what_a_sample_drew():
    found = sample([R, R, S, S], [0.1, -0.1, 0.0, 0.0])
    ax = plots.starts(found, "gamma", "amplitude", shade=None)
    sizes = [0.1, 0.2, 0.02**0.5, 0.3]
    np.testing.assert_allclose(ax.collections[0].get_offsets(), np.c_[np.arange(4) / 10, sizes])
    faces = plots.starts(found, shade="certified").collections[0].get_facecolors()
    assert [face[3] == 0 for face in faces] == [False, True, False, False]
    large = plots.starts(found, s=99, cmap="PuOr").collections[0]
    assert large.get_sizes().tolist() == [99]
    np.testing.assert_allclose(large.get_facecolors()[0], colormaps["PuOr"](1.0), atol=0.01)


def test_starts_over_listed_points():
    points = dt.Points(w3=[0.1, 0.2, 0.3], phi=[0.0, 1.0, 2.0])
    columns = dict(sample([R, S, S], [0.1, 0.0, 0.0]).columns)
    del columns["omega0"], columns["gamma"]
    found = dt.Basin(points.dims, points.shape, points.coords, columns, {"level": "x"})
    ax = plots.starts(found, "phi", "w3")
    np.testing.assert_array_equal(ax.collections[0].get_offsets(), [[0, 0.1], [1, 0.2], [2, 0.3]])
    assert ax.get_title() == "X\n66.7 % of the outcomes certified for this level"
    with pytest.raises(ValueError, match="`y` must be among w3, phi, but is 'cos_theta'"):
        plots.starts(found)


def test_starts_refuse_grids():
    for grid in (made([[R, S], [R, S]]), made([R, S], axes={"delta": [0.1, 0.2]})):
        with pytest.raises(ValueError, match="must be over a `Sample` or `Points`"):
            plots.starts(grid)
