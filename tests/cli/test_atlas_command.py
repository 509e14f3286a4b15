"""`dipoletop atlas`: what it draws and writes; a whole run is slow, since it compiles."""

import numpy as np
import pytest

from command_line import invoke, said, table
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
