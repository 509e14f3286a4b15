"""`dipoletop simulate`: the curves of figure 2, how runs end, other levels, refusals."""

import csv
import math
import re

import numpy as np
import pytest
from command_line import invoke, refusal

from dipoletop import validation


@pytest.fixture(scope="module")
def trajectory(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trajectory")
    return invoke("simulate", "--level", "order-1", "--output", folder / "t.pdf"), folder


def read(path):
    with path.open() as lines:
        return {
            float(line["tau"]): {name: float(value) for name, value in line.items()}
            for line in csv.DictReader(lines)
        }


def test_simulate_gives_figure_2a(trajectory):
    result, folder = trajectory
    assert result.exit_code == 0, result.output
    assert (folder / "t.pdf").stat().st_size > 5_000
    rows = read(folder / "t.csv")
    assert len(rows) == 1001
    for tau, expected in zip((10, 100, 1000), validation.RESIDUAL_ORBIT, strict=True):
        found = [rows[tau][f"omega_{k}"] for k in (1, 2, 3)]
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert f"{tau:10g} {expected[0]:16.9e}"[:24] in result.output
    w1, w2, w3 = (rows[0][f"omega_{k}"] for k in (1, 2, 3))
    assert rows[0]["energy"] == pytest.approx((w1**2 + w2**2 + 1.2 * w3**2) / 2, rel=1e-14)
    # dE/dτ = −power but for the Schott term, which is small against E at the end.
    assert 0 < rows[1000]["power"] < rows[0]["power"]
    sentence = "residual rotation; certified: in a region proven to decide for this level of the"
    assert sentence in result.output
    value, consistent = re.findall(r"ω∞ = ([\d.]+\d)", result.output)
    assert float(value) == pytest.approx(validation.RESIDUAL_ROTATION, rel=1e-9)
    # 0.1193 by the full equation; semi-reduced: an error of relative order ω².
    assert "Order 1 lacks a leading term of the full equation; at the semi-red" in result.output
    assert float(consistent) == pytest.approx(0.1193, rel=0.04)


def test_simulate_says_how_a_stopping_top_stops(tmp_path):
    arguments = ["--level", "order-1", "--phi", "pi/3", "--tau-max", 100, "--rtol", "1e-9"]
    result = invoke("simulate", *arguments, "--output", f"{tmp_path}/", "--format", "svg")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["trajectory.csv", "trajectory.svg"]
    rows = read(tmp_path / "trajectory.csv")
    assert len(rows) == 1001
    for tau, expected in zip((10, 100), validation.STOPPING_ORBIT, strict=False):
        found = [rows[tau][f"omega_{k}"] for k in (1, 2, 3)]
        np.testing.assert_allclose(found, expected, atol=1e-8)
    assert "Outcome: stop (rotating); certified" in result.output
    assert "ω∞ = 0\n" in result.output
    assert "this start ends so: stop (rotating), ω∞ = 0." in result.output


def test_simulate_at_another_level_from_spherical_angles(trajectory, tmp_path):
    size = 0.2 * math.sqrt(2)
    start = ["--amplitude", size, "--theta", "pi/4", "--delta", -0.2]
    what = ["--points", 11]
    result = invoke("simulate", *what, *start, "--output", tmp_path / "t")
    assert result.exit_code == 0, result.output
    assert list(read(tmp_path / "t.csv")) == [100.0 * k for k in range(11)]
    first, same = (read(path)[0.0] for path in (tmp_path / "t.csv", trajectory[1] / "t.csv"))
    for k in (1, 2, 3):
        assert first[f"omega_{k}"] == pytest.approx(same[f"omega_{k}"], rel=1e-14)
    assert "|ω| = 0.282843, ϑ = π/4. Level: semi-reduced." in result.output
    assert "Order 1" not in result.output
    (value,) = re.findall(r"ω∞ = (\S+)", result.output)
    # 0.1193 by the full equation, 0.0989 by order 1; semi-reduced: an error of relative order ω².
    assert float(value) == pytest.approx(0.1193, rel=0.04)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("--max-steps 3", "The run did not reach τ = 1000: it ended after 3 steps of at most 3."),
        ("--tau-max 0", "--tau-max must be positive, but is 0."),
        ("--theta 1 --w3 1", "theta and w3 cannot be mixed"),
        ("--delta -1.1", "Argument `delta` must lie in [-1, 1), but is -1.1."),
        ("--points 1", "Invalid value for '--points'"),
    ],
)
def test_a_run_that_cannot_be_is_refused_in_one_line(tmp_path, arguments, line):
    assert line in refusal("simulate", "--output", f"{tmp_path}/t", *arguments.split())
    assert list(tmp_path.iterdir()) == []
