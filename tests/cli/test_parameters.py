"""Values on the command line: numbers with π, and words for levels and axes."""

import math

import click
import pytest

import dipoletop as dt
from dipoletop.cli.commands import AXIS, LEVEL
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


def test_words_of_the_command_line_are_converted_at_once():
    assert AXIS.convert("w-perp", None, None) == "w_perp"
    for order in (1, 2, 3, 4):
        assert dt.equation_at(LEVEL.convert(f"order-{order}", None, None), 0.1).order == order
    assert isinstance(dt.equation_at(LEVEL.convert("semi", None, None), 0.1), dt.TransverseSemi)
    assert isinstance(dt.equation_at(LEVEL.convert("full", None, None), 0.1), dt.TransverseFull)
    with pytest.raises(click.BadParameter, match="'w_perp' is not one of 'delta', 'w-perp'"):
        AXIS.convert("w_perp", None, None)
