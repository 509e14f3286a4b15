"""Addresses: they give back their view to the last bit, and refuse all else in a sentence."""

from dataclasses import replace
from urllib.parse import parse_qs

import pytest

from dipoletop.equations.levels import Level
from dipoletop.explorer import scenes, views

TOP = scenes.scene_of_top({})
FIRST = views.first_view(TOP, levels=TOP.at_first)


def opened(query):
    return views.view_at(TOP, FIRST, parse_qs(query.removeprefix("?"), keep_blank_values=True))


@pytest.mark.parametrize(
    "view",
    [
        FIRST,
        replace(FIRST, levels=(Level.ORDER_1, Level.SEMI), rtol=1e-5, size=512),
        replace(FIRST, ranges={"phi": (0.1 + 1e-15, 0.1 + 3e-15), "w3": (1 / 3, 2 / 3)}),
        views.in_system(TOP, FIRST, ("delta", "amplitude", "theta", "phi"), "theta", "amplitude"),
        views.in_system(TOP, FIRST, ("delta", "amplitude", "theta", "phi"), "delta", "phi"),
    ],
)
def test_an_address_gives_back_its_view(view):
    again = opened(views.address_of(view))
    assert replace(again, values=again.fixed) == replace(view, values=view.fixed)


def test_options_may_be_spelled_as_on_the_command_line():
    view = opened("x=phi&y=w3&w-perp=0.3&phi=0..pi/2")
    assert view.fixed["w_perp"] == 0.3
    assert view.ranges["phi"] == (0.0, pytest.approx(1.5707963267948966))
    assert opened("amplitude=0.3").y == "theta"


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("delta=3", r"Argument `delta` must lie in \[-1, 1\), but is 3\."),
        ("delta=abc", "Argument `delta` must be a finite number, but is 'abc'."),
        ("delta=nan", "Argument `delta` must be a finite number, but is 'nan'."),
        ("delta=", "Argument `delta` must be a finite number, but is ''."),
        ("delta=1&delta=2", "Argument `delta` must be given once, but is given 2 times."),
        ("phi=0.3", "Argument `phi` must be a range such as 0..0.5, since it is an axis"),
        ("phi=1..0", "Argument `phi` must have a range that increases, but has 1 to 0."),
        ("w_perp=0..1", "Argument `w_perp` must be a finite number, but is '0..1'."),
        ("level=best", "Argument `level` must be one of order-1.*but is 'best'."),
        ("level=full", "Argument `level` must be one of .*but is 'full'."),
        ("level=semi&level=order-1&level=order-2", "Argument `level` must be one level, or two"),
        ("x=gamma", "Argument `x` must be one of delta.*but is 'gamma'."),
        ("x=phi&y=phi", "Argument `y` must be another axis than `x`"),
        ("x=w3&y=theta", "Argument `start` must be given by"),
        ("size=100000", "Argument `size` must be one of 64"),
        ("rtol=1e-30", "Argument `rtol` must lie between"),
        ("seed=1", "Argument `address` must name only x, y, level.*but names 'seed'."),
    ],
)
def test_bad_addresses_are_refused(query, sentence):
    with pytest.raises(ValueError, match=sentence):
        opened(query)
