"""Angular speeds from texts and numbers."""

import re

import jax
import numpy as np
import pytest

from dipoletop.particles import angular_speed


@pytest.mark.parametrize(
    ("text", "turns_per_second"),
    [
        ("1 GHz", 1e9),
        ("1GHz", 1e9),
        (" 2.5e-3 THz ", 2.5e9),
        (".5 kHz", 500),
        ("3. MHz", 3e6),
        ("7E+1Hz", 70),
        ("90 rpm", 1.5),
        ("12 rad/s", 12 / (2 * np.pi)),
        ("0 Hz", 0),
    ],
)
def test_texts(text, turns_per_second):
    speed = angular_speed(text)
    assert speed.shape == ()
    np.testing.assert_allclose(speed, 2 * np.pi * turns_per_second, rtol=4e-16)


def test_numbers_are_in_radians():
    assert angular_speed(3) == 3.0
    np.testing.assert_array_equal(angular_speed([1.0, 2.0]), [1.0, 2.0])
    traced = jax.jit(jax.vmap(angular_speed))(np.array([1.0, -1.0, np.inf]))
    np.testing.assert_array_equal(traced, [1.0, np.nan, np.nan])


UNITS = "be a number with a unit among Hz, kHz, MHz, GHz, THz, rad/s, rpm"


@pytest.mark.parametrize(
    ("spin", "must", "was"),
    [
        ("1", UNITS, "is '1'"),
        ("GHz", UNITS, "is 'GHz'"),
        ("1 ghz", UNITS, "is '1 ghz'"),
        ("1 mHz", UNITS, "is '1 mHz'"),
        ("-1 GHz", UNITS, "is '-1 GHz'"),
        ("nan Hz", UNITS, "is 'nan Hz'"),
        ("1 GHz s", UNITS, "is '1 GHz s'"),
        ("1e999 Hz", "be finite", "is inf"),
        (-1.0, "not be negative", "is -1.0"),
        (np.nan, "be finite", "is nan"),
        (True, "be a real number", "has dtype bool"),
        (None, "be a real number", "is None"),
        (["1 GHz"], "be a real number", "is ['1 GHz']"),
        ([[1.0]], "have shape (), or one batch axis in front", "has shape (1, 1)"),
    ],
)
def test_refusals(spin, must, was):
    sentence = re.escape(f"Argument `spin` must {must}, but {was}.")
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        angular_speed(spin)
