"""What a map shows before it is drawn: titles, shares, colours that every eye tells apart."""

import itertools

import numpy as np
import pytest
from made_basins import R, S, made
from matplotlib.colors import to_rgb

from dipoletop import plots
from dipoletop.plots.column_shading import BLUES, OLIVES, SIGNED
from dipoletop.plots.map_layout import CLASSES

# Machado, Oliveira & Fernandes (2009), severity 1: linear RGB as the colour-blind see it.
SIGHT = {
    "normal": np.eye(3),
    "protan": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deutan": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritan": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}


def cielab(colour, sight):
    """CIE 1976 L*a*b* of an sRGB colour under D65."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(sight @ linear, 0, 1)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(to_xyz) @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_differ_to_every_eye(sight):
    # A difference of 2.3 is just noticeable; 15 is plain also in small patches.
    def apart(one, other):
        return np.linalg.norm(cielab(one, SIGHT[sight]) - cielab(other, SIGHT[sight]))

    colours = [colour for _, colour in CLASSES.values()]
    assert min(apart(a, b) for a, b in itertools.combinations(colours, 2)) > 20
    ramp = SIGNED(np.linspace(0, 1, 21))
    assert min(apart(a, b) for a in colours[1:] for b in ramp) > 15
    darkness = np.linspace(0, 1, 21)
    assert min(map(apart, BLUES(darkness), OLIVES(darkness))) > 15


@pytest.mark.parametrize(
    ("certified", "words"),
    [
        (True, "all outcomes"),
        (False, "no outcome"),
        ([[True, True, False], [True, True, True]], "83.3 % of the outcomes"),
    ],
)
def test_the_title_says_the_level_what_is_fixed_and_what_is_certified(certified, words):
    axes = {"amplitude": [0.3, 0.4], "delta": [-0.2], "w1": [0.0, 1.0, 2.0]}
    certified = np.expand_dims(certified, -2) if np.ndim(certified) else certified
    found = made([[[R, R, R]], [[R, S, R]]], certified=certified, axes=axes)
    expected = f"Semi-reduced\n$\\delta$ = −0.2, {words} certified for this level"
    assert plots.basin(found).get_title() == expected


def test_shares_are_never_rounded_to_none_or_all():
    some = np.zeros((100, 100), bool)
    some[0, :3] = True
    assert "< 0.1 %" in plots.basin(made(np.full((100, 100), R), certified=some)).get_title()
    assert "99.9 %" in plots.basin(made(np.full((100, 100), R), certified=~some)).get_title()
