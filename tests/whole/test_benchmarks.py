"""The benchmarks: their pages are those of the kept numbers, and their documented paths start."""

import re
import string
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.accuracy import label_doubt
from benchmarks.reporting import pages, render, views
from dipoletop._runs import blocks


@pytest.mark.parametrize("name", pages.NAMES)
def test_pages_are_made_of_the_numbers(name):
    for page in pages.pages(name):
        text = page.read_text(encoding="utf-8")
        assert pages.BLOCK.search(text)
        assert pages.renewed(page, pages.shown(name)) == text


def test_readme_is_short_and_its_table_that_of_the_numbers():
    page = pages.HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    assert len(re.sub("<!--.*?-->\n*", "", text, flags=re.DOTALL).splitlines()) <= 120
    numbers = {name: pages.shown(name) for name in pages.NAMES}
    assert pages.renewed(page, views.summary(numbers)) == text


def fields(template):
    return [name for _, name, *_ in string.Formatter().parse(template) if name]


@pytest.mark.parametrize("name", pages.NAMES)
def test_what_pages_ask_for_is_in_the_numbers(name):
    numbers, find = pages.shown(name), render.Formatter().get_field
    for page in pages.pages(name):
        for _, template, _ in pages.BLOCK.findall(page.read_text(encoding="utf-8")):
            for part in template.split("\n\n"):
                rows = [numbers]
                if part.startswith("@"):
                    place, _, *lines = part[1:].split("\n")
                    rows, part = find(place, (), numbers)[0], "\n".join(lines)
                found = {
                    field: any(
                        find(field, (row,), row if isinstance(row, dict) else {})[0] is not None
                        for row in rows
                    )
                    for field in fields(part)
                }
                assert all(found.values()), found


def test_tables_have_sums_pairs_and_dashes():
    clock = {"min": 1.5, "median": 2.0}
    rows = [
        {"name": "a", "n": 2, "starts": 1000, "seconds": clock, "processor_seconds": clock},
        {"name": "b", "n": 3, "errors": [1e-3, float("nan")]},
    ]
    template = (
        "{rows[sum][n]} of {rows[max][n]}; {none}\n\n@rows\n{rows[last][name]} | us | errors\n"
    )
    template += "{name} | {us:/n} | {errors:/.0e}"
    text, table = render.render(template, render.prepared({"rows": rows})).split("\n\n")
    assert text == "5 of 3; —"
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    assert lines[0] == ["b", "us", "errors"]
    assert lines[2:] == [["a", "2000 / 2000", "—"], ["b", "—", "1e-03 / —"]]


def test_labels_that_only_the_second_pass_has_right_are_counted(monkeypatch):
    rng = np.random.default_rng(0)
    case = label_doubt.tops("1", "tops, −½ < δ < 0", 4096, rng)
    middles, truth = list(label_doubt.closing_in(case, rng))[-1]
    kept = label_doubt.judged(middles, truth)
    run = blocks.RunBlock.run

    def without_doubt(block, *arguments, **options):
        ended = run(block, *arguments, **options)
        return ended._replace(doubt=np.where(ended.runs.outcome > 0, 0.0, ended.doubt))

    monkeypatch.setattr(blocks.RunBlock, "run", without_doubt)
    doubtless = label_doubt.judged(middles, truth)
    assert kept["wrong_once"] == doubtless["wrong_once"] == 0
    assert kept["wrong_first"] == doubtless["wrong_first"] == doubtless["lost"] > kept["lost"]
    assert kept["again"] > doubtless["again"]  # without doubt only what did not end
    assert len(doubtless["lost_starts"]) == min(doubtless["lost"], label_doubt.SHOWN)


@pytest.mark.system
def test_the_script_for_a_device_starts_by_its_path(tmp_path):
    """`.ci/run` starts the other one."""
    command = [sys.executable, str(pages.HERE / "bench_device.py"), "--help"]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
