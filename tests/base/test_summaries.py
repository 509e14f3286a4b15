"""Numbers and arrays in a few words."""

from typing import NamedTuple

import numpy as np
import pytest

from dipoletop._base.summaries import span, summary


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([0.5, 2.0, 1.0], "0.5 to 2"),
        ([3, 3], "3"),
        ([np.nan, 1.0, np.nan], "1 and 2 NaN"),
        ([np.nan], "1 NaN"),
        ([], "none"),
    ],
)
def test_an_array_is_shown_by_its_range(values, text):
    assert span(np.asarray(values)) == text


class Result(NamedTuple):
    values: np.ndarray
    few: np.ndarray
    slope: dict[str, float]
    slope_error: dict[str, float]
    note: str


def test_a_summary_has_numbers_with_their_errors_and_no_long_array():
    result = Result(np.zeros((2, 5)), np.array([1 / 3]), {"a": 2.0}, {"a": 0.5}, "")
    assert summary(result, "note", slope="slope_error") == (
        "Result(values=<2 × 5: 0>, few=[0.333333], slope={a: 2 ± 0.5})"
    )
