"""The benchmarks: their pages are those of the kept numbers, and their documented paths start."""

import subprocess
import sys

import pytest

from benchmarks.reporting import pages, summary


@pytest.mark.parametrize("name", pages.PAGES)
def test_pages_are_made_of_the_numbers(name):
    for module in pages.PAGES[name]:
        path = pages.RESULTS / f"{module.__name__.rpartition('.')[2]}.md"
        assert path.read_text(encoding="utf-8") == pages.page(module, pages.read(name))


def test_readme_is_short_and_its_table_that_of_the_numbers():
    text = (pages.HERE / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert summary.body({name: pages.read(name) for name in pages.PAGES}) in text


@pytest.mark.parametrize("script", ["run.py", "bench_device.py"])
def test_scripts_start_by_their_paths(script, tmp_path):
    command = [sys.executable, str(pages.HERE / script), "--help"]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
