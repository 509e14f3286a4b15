"""`dipoletop atlas`: what it draws, writes and refuses; a whole run is slow, since it compiles."""

import numpy as np
import pytest

from command_line import invoke, refusal, said, table
from dipoletop import atlases


@pytest.mark.slow
def test_three_maps_over_all_bodies(tmp_path):
    text = said("atlas", "--size", 4, "--output", tmp_path)
    assert (tmp_path / "atlas.png").stat().st_size > 10_000
    rows = table(tmp_path / "atlas.csv")
    assert len(rows) == 3 * 16
    # The dipole on the axis of J₃: always residual; on that of J₂: never.
    assert {row["ending"] for row in rows if row["n3"] == "1"} == {"0"}
    assert {row["ratio"] for row in rows if row["n2"] == "1"} == {"0"}
    assert "16 bodies with the dipole on axis 3; RESIDUAL 1;" in text


def test_axes_and_sizes_reach_the_library(tmp_path, monkeypatch):
    calls = []

    def atlas(*arguments, **settings):
        calls.append((*arguments, settings))
        raise OSError("seen")

    monkeypatch.setattr(atlases, "atlas", atlas)
    invoke("atlas", "--dipole", 2, "--dipole", 2, "--size", 9, "--output", tmp_path)
    invoke("atlas", "--body", "3,4,5", "--quiet", "--output", tmp_path)
    (first, settings), (others,) = calls
    assert (first, settings) == (2, {"n": 9, "progress": False})
    np.testing.assert_array_equal(np.diag(others["body"].inertia), [3, 4, 5])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--dipole 4", "'4' is not one of '1', '2', '3'"),
        ("--dipole 1 --body 3,4,5", "--dipole and --body cannot both be given."),
        ("--body 3,4,9", "inertia must have principal moments with J1 + J2 >= J3"),
        ("--body 3,3,5", "--body must have three different moments"),
        ("--body 3,4", "'3,4' is not three numbers"),
        ("--size 1", "Invalid value for '--size'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, arguments, sentence):
    assert sentence in refusal("atlas", *arguments.split(), "--output", f"{tmp_path}/a")
    assert list(tmp_path.iterdir()) == []
