"""The README: its example runs as printed; its commands, names and links lead somewhere."""

import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest

import dipoletop as dt
from dipoletop.cli import main

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize(
    "command", ["pip install . && dipoletop map", "pip install -e '.[test]' && pytest"]
)
def test_commands_stand_verbatim(command):
    assert f"{command}\n" in blocks("bash")


@pytest.mark.slow
def test_example_runs_as_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (source,) = blocks("python")
    names = {}
    exec(compile(source, "README.md", "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    assert f"# {printed[0]}\n" in source
    for picture in ("trajectory.png", "map.png"):
        assert (tmp_path / picture).stat().st_size > 10_000

    # Start a of figure 2: residual, at 0.1193 by the full equation, at 0.0989 by the paper's.
    verdict, basin = names["verdict"], names["basin"]
    assert verdict.outcome == dt.Outcome.RESIDUAL
    assert abs(verdict.omega_inf - 0.1193) < 0.1 * abs(0.0989 - 0.1193)
    assert abs(names["trajectory"].omega[-1, 0] - verdict.omega_inf) < 1e-7

    # At φ = 0 the top keeps rotating for small ω₃ and stops for large ω₃, once and for all.
    stops = basin.outcome[:, 0] == dt.Outcome.STOP
    assert not stops[0]
    assert stops[-1]
    assert np.all(np.diff(stops.astype(int)) >= 0)
    np.testing.assert_array_equal(dt.Basin.load("map.zarr").outcome, basin.outcome)

    # 0.5894 ± 0.01 of the isotropic starts keep rotating, by an independent sample.
    numbers = re.search(r"RESIDUAL.*?=(.+?), low=(.+?), high=(.+?), count=(\d+)", printed[1])
    share, low, high, count = map(float, numbers.groups())
    assert low - 0.01 < 0.5894 < high + 0.01
    assert count == round(1000 * share)


def test_first_screen_holds_the_essentials():
    assert len(README.splitlines()) <= 120
    screen = "\n".join(README.splitlines()[:48])
    assert "pip install . && dipoletop map" in screen
    assert "notebooks/figures/map.png" in screen
    assert blocks("python")[0] in screen


def test_names_in_the_first_table_exist():
    table = re.search(r"^\| to … .*?\n\n", README, re.DOTALL | re.MULTILINE)[0]
    for row in table.split("\n")[2:-2]:
        owner = ""
        for name in re.findall(r"`(\.?[A-Za-z]\w*(?:\.\w+)*)", row.split("|")[2]):
            full = owner + name if name.startswith(".") else name
            owner = full.rpartition(".")[0]
            pkgutil.resolve_name(f"dipoletop.{full}")  # raises if there is none


def test_commands_of_the_command_line_exist():
    for words in re.findall(r"\bdipoletop ([a-z]+(?: [a-z]+)?)`", README):
        command = main
        for word in words.split():
            command = command.commands[word]


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\]\(([^)]+)\)", README))))
def test_links_lead_somewhere(target):
    assert target.startswith("https://") or (ROOT / target).is_file()
