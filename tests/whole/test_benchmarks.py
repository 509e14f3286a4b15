"""The benchmarks: their pages are those of the kept numbers, and their documented paths start."""

import subprocess
import sys

import numpy as np
import pytest

from benchmarks.accuracy import label_doubt
from benchmarks.reporting import pages, speed, summary
from dipoletop._runs import blocks


@pytest.mark.parametrize("name", pages.PAGES)
def test_pages_are_made_of_the_numbers(name):
    for module in pages.PAGES[name]:
        path = pages.RESULTS / f"{module.__name__.rpartition('.')[2]}.md"
        assert path.read_text(encoding="utf-8") == pages.page(module, pages.read(name))


def test_readme_is_short_and_its_table_that_of_the_numbers():
    text = (pages.HERE / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert summary.body({name: pages.read(name) for name in pages.PAGES}) in text


def test_older_numbers_and_those_of_fresh_processes_are_shown():
    numbers = pages.read("speed")
    clock = {"min": 1.5, "median": 2.0}
    clocks = {"first_seconds": 4.0, "seconds": clock, "processor_seconds": clock}
    rows = [{"name": name, "peak_bytes": 3e8, **clocks} for name in ("native", "heyoka")]
    rows[1] |= {"first_seconds": 10.0, "peak_bytes": 1.5e8}
    numbers["fresh_outcomes"] = {"starts": 4096, "rows": rows}
    others: dict = {name: [] for name in pages.PAGES}
    lines = summary.body(others | {"speed": numbers}).splitlines()
    assert any("4.00 / 2.00" in line and "2.50 / 1.00" in line for line in lines)
    assert any("batches: 150" in line and "0.500" in line for line in lines)
    assert "in fresh processes" in speed.body(numbers)
    del numbers["fresh_outcomes"]
    assert "A fresh process" not in summary.body(others | {"speed": numbers})


def test_labels_that_only_the_second_pass_has_right_are_counted(monkeypatch):
    rng = np.random.default_rng(0)
    case = label_doubt.tops("1", "tops, −½ < δ < 0", 4096, rng)
    middles, truth = list(label_doubt.closing_in(case, rng))[-1]
    kept = label_doubt.judged(middles, truth)
    run = blocks.RunBlock.run

    def without_doubt(block, limits):
        runs, doubt = run(block, limits)
        return blocks.Ended(runs, np.where(runs.outcome > 0, 0.0, doubt))

    monkeypatch.setattr(blocks.RunBlock, "run", without_doubt)
    doubtless = label_doubt.judged(middles, truth)
    assert kept["wrong_once"] == doubtless["wrong_once"] == 0
    assert kept["wrong_first"] == doubtless["wrong_first"] == doubtless["lost"] > kept["lost"]
    assert kept["again"] > doubtless["again"]  # without doubt only what did not end
    assert len(doubtless["lost_starts"]) == min(doubtless["lost"], label_doubt.SHOWN)


@pytest.mark.system
@pytest.mark.parametrize("script", ["run.py", "bench_device.py"])
def test_scripts_start_by_their_paths(script, tmp_path):
    command = [sys.executable, str(pages.HERE / script), "--help"]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
