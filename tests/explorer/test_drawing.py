"""Drawing: coarse first, then what `dt.sweep` gives; a failure is reported."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

import dipoletop as dt
from dipoletop.explorer import drawing, pictures, scenes, views

TOP = scenes.scene_of_top({})
SMALL = replace(views.first_view(TOP, levels=("semi",)), size=64)


def drawn(crew, view):
    """All pictures of a view, without the pauses."""
    shown, failed = [], []
    pieces = sum(1 for _ in crew.pictures(view, shown.append, failed.append))
    assert failed == []
    return shown, pieces


@pytest.fixture(autouse=True)
def nothing_takes_time(monkeypatch):
    """Sizes and pieces depend on the time that sweeps take, here on what a test says of it."""
    monkeypatch.setattr(drawing, "OVERHEAD", math.inf)


@pytest.fixture(scope="module")
def crew():
    return drawing.Drawing(TOP)


@pytest.mark.parametrize(
    ("levels", "rtol"),
    [((dt.Level.SEMI,), 1e-4), ((dt.Level.ORDER_1, dt.Level.SEMI), SMALL.rtol)],
)
def test_the_last_picture_is_that_of_a_sweep(crew, levels, rtol):
    shown, _ = drawn(crew, replace(SMALL, levels=levels, rtol=rtol))
    sizes = [picture.size for picture in shown]
    assert [picture.is_final for picture in shown] == [False] * (len(shown) - 2) + [True] * 2
    assert [picture.has_fine_edges for picture in shown] == [False] * (len(shown) - 1) + [True]
    assert sizes == sorted(sizes)
    assert sizes[-1] == 64
    final = shown[-2]
    cells = views.cells_of(TOP, SMALL, 64)
    for basin, level in zip(final.basins, levels, strict=True):
        assert basin == dt.sweep(TOP.problem_at(level), cells.grid, rtol=rtol)
    outcomes = [dt.plots.unfold(basin).outcome[0, 0] for basin in final.basins]
    assert all(image.shape == (64, 64, 4) for image in final.images)
    if len(levels) == 2:
        assert final.differs == np.mean(outcomes[0] != outcomes[1])
        assert final.differs > 0


def test_edges_are_those_of_a_finer_sweep(crew):
    *_, final, fine = drawn(crew, SMALL)[0]
    assert fine.basins == final.basins
    assert all(image.shape == (192, 192, 4) for image in fine.images)
    np.testing.assert_array_equal(fine.images[0][1::3, 1::3], final.images[0])
    cells = views.cells_of(TOP, SMALL, 192)
    whole = dt.sweep(TOP.problem_at(dt.Level.SEMI), cells.grid)
    expected = pictures.picture_of(SMALL, [whole], cells.folded, 192, True).planes[0]
    outcomes = fine.planes[0].columns["outcome"]
    wrong = outcomes != expected.columns["outcome"]
    assert np.mean(wrong) < 1e-3  # tongues thinner than a pixel
    coarse = final.planes[0].columns["outcome"].repeat(3, 0).repeat(3, 1)
    assert np.sum(wrong) < np.sum(coarse != expected.columns["outcome"]) / 20


def test_close_starts_and_large_pictures_have_no_finer_edges(crew):
    close = replace(SMALL, ranges={"phi": (0.3, 0.3 + 64 * 5 * np.spacing(0.3)), "w3": (0.1, 0.2)})
    assert not drawn(crew, close)[0][-1].has_fine_edges
    assert not drawn(crew, replace(SMALL, size=512))[0][-1].has_fine_edges


@pytest.mark.parametrize(("cost", "size"), [(1e-7, 64), (2e-4, 32), (1.0, drawing.FEWEST)])
def test_the_first_picture_is_as_fine_as_time_allows(cost, size):
    crew = drawing.Drawing(TOP)
    crew.sweep(dt.Level.SEMI, views.cells_of(TOP, SMALL, 16).grid, 1e-8, "unchecked")
    crew._cost[dt.Level.SEMI, "unchecked"] = cost  # seconds for each of a quarter of the starts
    shown: list = []
    next(crew.pictures(SMALL, shown.append, pytest.fail))
    assert shown[0].size == size


def test_long_work_comes_in_pieces(crew, monkeypatch):
    drawn(crew, SMALL)
    monkeypatch.setattr(drawing, "PIECE", 1e-4)
    crew._cost[dt.Level.SEMI, True] = 1e-6
    shown, pieces = drawn(crew, SMALL)
    assert pieces > 3
    assert shown[-1].basins[0] == drawn(crew, SMALL)[0][-1].basins[0]


def test_loose_pictures_differ_from_the_last_one_nowhere_that_is_seen(crew):
    drawn(crew, SMALL)
    crew._cost[dt.Level.SEMI, "unchecked"] = 1e-7
    first, *_, last, _ = drawn(crew, SMALL)[0]
    assert first.size == 64
    assert first.basins[0].attrs["rtol"] == drawing.LOOSE
    np.testing.assert_array_equal(first.basins[0].outcome, last.basins[0].outcome)
    difference = first.images[0].astype(int) - last.images[0]
    assert np.max(np.abs(difference)) <= 4
    narrow = {"phi": (0.3, 0.3 + 1e-5), "w3": (0.2, 0.3)}
    close = drawn(crew, replace(SMALL, ranges=narrow))[0][0]
    assert close.basins[0].attrs["rtol"] == 1e-8


def test_nothing_is_traced_again(crew):
    calls = []
    problem = TOP.problem_at(dt.Level.SEMI)

    def counted(**point):
        calls.append(point)
        return problem(**point)

    other = drawing.Drawing(replace(TOP, problem_at=lambda _: counted))
    drawn(other, SMALL)
    before = len(calls)
    shown, _ = drawn(other, replace(SMALL, values=SMALL.values | {"w_perp": 0.3}, rtol=1e-6))
    few = len(calls)  # tiles of another length, at most
    drawn(other, replace(SMALL, values=SMALL.values | {"w_perp": 0.31}, rtol=1e-6))
    assert before > 0
    assert few - before <= 2
    assert len(calls) == few
    assert shown[-1].basins[0].coords["w_perp"].tolist() == [0.3]


def test_a_failure_is_reported():
    def broken(**point):
        raise ValueError("Argument `point` must be another one, but is this.")

    scene = replace(TOP, problem_at=lambda _: broken)
    failed = []
    work = drawing.Drawing(scene).pictures(SMALL, pytest.fail, failed.append)
    assert next(work, None) is None
    assert str(failed[0]).startswith("Argument `point` must be another one")


def test_a_picture_is_refined_after_a_rest(crew):
    before = time.monotonic()
    work = crew.pictures(SMALL, lambda _: None, pytest.fail)
    assert next(work) >= before + drawing.REST


def test_hatching_marks_exactly_where_outcomes_differ():
    inside = np.zeros((64, 64), bool)
    inside[10:30, 20:50] = True
    inside[40, 5:60] = True  # thin
    image = np.full((64, 64, 4), 77, np.uint8)
    pictures.hatch(image, inside)
    changed = np.any(image != 77, axis=2)
    assert not changed[~inside].any()
    assert changed[40, 5:60].all()
    assert changed[10, 20:50].all()
    assert 0.3 < np.mean(changed[12:28, 22:48]) < 0.9
    for colour in (0, 255):
        assert (image[..., 0] == colour).any()
