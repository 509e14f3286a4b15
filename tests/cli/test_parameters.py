"""Values on the command line: numbers with π, and words for levels and axes."""

import math

import pytest
from command_line import refusal

import dipoletop as dt
from dipoletop.cli.commands import LEVEL
from dipoletop.cli.parameters import Number


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.25", 0.25),
        ("-1e-3", -1e-3),
        ("pi", math.pi),
        ("pi/30", math.pi / 30),
        ("-pi/4", -math.pi / 4),
        ("2pi", 2 * math.pi),
        ("2*pi/3", 2 * math.pi / 3),
    ],
)
def test_numbers_may_be_multiples_of_pi(text, value):
    assert Number().convert(text, None, None) == pytest.approx(value, rel=1e-15)


def test_every_word_for_a_level_is_one():
    for order in (1, 2, 3, 4):
        assert f"order-{order}" in LEVEL.choices
        assert dt.equation_at(f"order-{order}", 0.1).order == order
    assert LEVEL.choices == tuple(dt.Level)


def test_axes_are_spelled_as_options():
    assert "'w_perp' is not one of 'delta', 'w-perp'" in refusal("map", "--x", "w_perp")
    assert "'w_perp' is not one of 'delta', 'w-perp'" in refusal("map", "--range", "w_perp", 0, 1)
