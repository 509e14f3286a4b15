"""Views: starts are those of the whole picture, zooms end at rounding, bad values do not pass."""

import math
from dataclasses import replace

import numpy as np
import pytest

import dipoletop as dt
from dipoletop.explorer import scenes, views

TOP = scenes.scene_of_top({})


def view_of(**changes):
    return replace(views.first_view(TOP, levels=("semi",)), **changes)


def test_a_page_begins_with_the_whole_plane_of_starts():
    view = views.first_view(TOP, levels=TOP.at_first)
    assert (view.x, view.y, view.levels) == ("phi", "w3", (dt.Level.SEMI,))
    assert view.ranges == {"phi": (0.0, 2 * math.pi), "w3": (-0.6, 0.6)}
    assert view.fixed == {"delta": -0.2, "w_perp": 0.2}


@pytest.mark.parametrize(
    "ranges",
    [
        {"phi": (0.0, 2 * math.pi), "w3": (-0.5, 0.5)},
        {"phi": (0.0, 2 * math.pi), "w3": (-0.1, 0.5)},
        {"phi": (0.5, 1.5), "w3": (-0.5, 0.5)},
    ],
)
def test_symmetries_give_the_same_picture_as_all_starts(ranges):
    view = view_of(ranges=ranges)
    cells = views.cells_of(TOP, view, 16)
    assert cells.folded == (ranges["w3"] == (-0.5, 0.5) and ranges["phi"][0] == 0)
    assert cells.count == (64 if cells.folded else 256)
    problem = TOP.problem_at(dt.Level.SEMI)
    basin = dt.sweep(problem, cells.grid)
    whole = dt.plots.unfold(basin) if cells.folded else basin
    axes = {name: views.middles(*span, 16) for name, span in ranges.items()}
    grid = dt.Grid(delta=-0.2, w_perp=0.2, w3=axes["w3"], phi=axes["phi"])
    expected = dt.sweep(problem, grid)
    assert 0.2 < np.mean(expected.outcome == dt.Outcome.STOP) < 0.8
    np.testing.assert_array_equal(whole.outcome, expected.outcome)
    np.testing.assert_allclose(whole.omega_inf, expected.omega_inf, rtol=1e-6)
    for name, values in axes.items():
        np.testing.assert_allclose(whole.coords[name], values, atol=1e-15)


@pytest.mark.parametrize("place", [(0.3, 0.2), (math.pi, 0.0), (6.28, -0.599)])
def test_zooms_end_where_rounding_ends_them(place):
    view, ended = view_of(), ()
    for _ in range(2000):
        ranges = {}
        for name, centre in zip((view.x, view.y), place, strict=True):
            half = (view.ranges[name][1] - view.ranges[name][0]) / 4
            ranges[name] = centre - half, centre + half
        view, ended = views.zoomed(TOP, view, ranges)
        if len(ended) == 2:
            break
    assert set(ended) == {"phi", "w3"}
    grid = views.cells_of(TOP, view, view.size).grid
    for name, centre in zip((view.x, view.y), place, strict=True):
        values = grid.coords[name]
        steps = np.diff(values)
        assert np.all(steps > 0)
        assert np.max(steps) < 1.5 * np.min(steps) or centre == 0
        assert values[0] < centre < values[-1]
        if centre:  # not wider than it must be
            assert np.max(steps) < 10 * np.spacing(abs(centre))
    for column in ("phi", "w3"):
        points = {"w3": place[1], "phi": place[0]} | {column: grid.coords[column]}
        w3, phi = np.broadcast_arrays(points["w3"], points["phi"])
        starts = np.asarray(dt.cylindrical(0.2 * np.ones(w3.shape), w3, phi))
        assert len(np.unique(starts, axis=0)) == view.size
    again, _ = views.zoomed(TOP, view, view.ranges)
    for name, span in view.ranges.items():
        assert again.ranges[name] == pytest.approx(span, rel=1e-12)


def test_ranges_stay_within_the_bounds_of_their_quantities():
    view = views.first_view(TOP, "phi", "delta", levels=("semi",))
    moved, _ = views.zoomed(TOP, view, {"phi": (-9.0, 1.0), "delta": (0.5, 1.7)})
    assert moved.ranges["phi"] == (-9.0, 1.0)
    low, high = moved.ranges["delta"]
    assert high < 1
    assert high - low == pytest.approx(1.2)
    wide, _ = views.zoomed(TOP, view, {"phi": (0.0, 1.0), "delta": (-5.0, 5.0)})
    assert wide.ranges["delta"] == (-1.0, math.nextafter(1.0, 0.0))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"values": {"delta": 1.0}}, r"Argument `delta` must lie in \[-1, 1\), but is 1\."),
        ({"values": {"w_perp": -0.1}}, "Argument `w_perp` must be at least 0, but is -0.1."),
        ({"values": {"w_perp": math.nan}}, "Argument `w_perp` must be a finite number, but is nan"),
        ({"values": {"w_perp": "x"}}, "Argument `w_perp` must be a finite number, but is 'x'."),
        ({"ranges": {"phi": (1.0, 1.0)}}, "Argument `phi` must have a range that increases"),
        ({"levels": (dt.Level.FULL,)}, "Argument `level` must be one of semi, order-1.*'full'"),
        ({"levels": 2 * (dt.Level.SEMI,)}, "Argument `level` must be one level, or two different"),
        ({"levels": ()}, "Argument `level` must be one level, or two different ones, but is none"),
        ({"size": 100}, "Argument `size` must be one of 64, 128, 256, 512, 1024, but is 100."),
        ({"rtol": 2.0}, "Argument `rtol` must lie between .* and 1 in float64, but is 2."),
        ({"y": "phi"}, "Argument `y` must be another axis than `x`, but is 'phi' too."),
    ],
)
def test_bad_values_are_refused(changes, sentence):
    view = view_of()
    for name in ("values", "ranges"):
        if name in changes:
            changes = changes | {name: getattr(view, name) | changes[name]}
    with pytest.raises(ValueError, match=sentence):
        views.checked_view(TOP, replace(view, **changes))
