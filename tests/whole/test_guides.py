"""The guides: the programs on each page run from top to bottom, and print what they say."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
PAGES = [NOTEBOOKS / "get_started.md", *sorted((NOTEBOOKS / "guides").glob("*.md"))]
SAID = re.compile(r"print\(.*\)  +# (\w[\w.]*)(?:: .*)?$", re.MULTILINE)


def program(page):
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    return "\n".join(blocks)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_programs_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = program(page)
    try:
        exec(compile(source, str(page), "exec"), {"__name__": page.stem})
    finally:
        plt.close("all")
    printed = capsys.readouterr().out
    for word in SAID.findall(source):
        assert word in printed.split()
    text = page.read_text("utf-8")
    for output in re.findall(r"^```text\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        assert output in printed


def test_what_a_page_says_is_found():
    assert SAID.findall(program(NOTEBOOKS / "get_started.md")) == ["RESIDUAL", "0.1209", "True"]
