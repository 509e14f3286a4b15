"""Values on the command line, and the quantities of a top in both ways to give a start."""

import math

import numpy as np
import pytest

import dipoletop as dt
from command_line import refusal
from dipoletop._maps.top_parameters import describe
from dipoletop._maps.top_problems import initial_condition
from dipoletop.cli.options import DURATION, LEVEL, NUMBER, grid_over, start_values


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.25", 0.25),
        ("-1e-3", -1e-3),
        ("pi", math.pi),
        ("-pi/4", -math.pi / 4),
        ("2pi", 2 * math.pi),
        ("2*pi/3", 2 * math.pi / 3),
    ],
)
def test_numbers_may_be_multiples_of_pi(text, value):
    assert NUMBER.convert(text, None, None) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.2, "0.2"), (math.pi, "π"), (-math.pi / 4, "-π/4"), (2 * math.pi / 3, "2π/3")],
)
def test_multiples_of_pi_are_shown_as_such(value, text):
    assert describe({"phi": value}) == f"φ = {text}"


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("1.5h", 5400), ("30m", 1800), ("1:00:05", 3605), ("75", 75)]
)
def test_times_are_read_as_batch_systems_write_them(text, seconds):
    assert DURATION.convert(text, None, None) == seconds


@pytest.mark.parametrize("text", ["0", "-3s", "soon", "1d", "2:", "1:2:3:4"])
def test_other_times_are_refused(text):
    said = f"{text!r} is not a time such as 90s, 30m, 2h or 1:30:00."
    assert said in refusal("map", f"--time-limit={text}")


def test_every_word_for_a_level_is_one():
    assert LEVEL.choices == tuple(dt.Level)


def test_axes_are_spelled_as_options():
    assert "'w_perp' is not one of 'delta', 'w-perp'" in refusal("map", "--x", "w_perp")
    assert "'w_perp' is not one of 'delta', 'w-perp'" in refusal("map", "--range", "w_perp", 0, 1)


def test_both_ways_to_give_a_start_agree():
    one = start_values({"w_perp": 0.3, "w3": 0.4})
    other = start_values({"amplitude": 0.5, "theta": math.atan2(0.3, 0.4)})
    assert list(one) == ["delta", "w_perp", "w3", "phi"]
    assert list(other) == ["delta", "phi", "amplitude", "theta"]
    np.testing.assert_allclose(initial_condition(one), initial_condition(other), rtol=1e-14)


@pytest.mark.parametrize(("high", "last"), [(math.pi, 0.75 * math.pi), (3.0, 3.0)])
def test_a_range_of_phi_that_repeats_ends_before_its_end(high, last):
    grid, text = grid_over(("phi", "delta"), {"phi": (0.0, high)}, (4, 2), {})
    assert grid.dims == ("w_perp", "w3", "delta", "phi")
    assert grid.coords["phi"][-1] == pytest.approx(last)
    assert text.startswith("4 × 2 starts: φ from 0 to ")
    assert text.endswith("δ from -1 to 0.9, at ω⊥ = 0.2, ω₃ = 0.2")


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("", "--output must be a folder or the first part of a file name, but is empty."),
        ("/proc/nope/x", "--output: the folder /proc/nope"),
    ],
)
@pytest.mark.parametrize("command", ["map", "simulate", "predict", "atlas", "figures"])
def test_an_output_that_cannot_be_is_refused_before_anything_is_computed(command, output, said):
    line = refusal(command, "--output", output)
    assert line.startswith(said)
    assert "Errno" not in line
