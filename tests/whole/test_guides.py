"""The guides: the programs on each page name what exists; they run, and print what they say."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "notebooks"
PAGES = [NOTEBOOKS / "get_started.md", *sorted((NOTEBOOKS / "guides").glob("*.md"))]
SAID = re.compile(r"print\(.*\)  +# (\w[\w.]*)(?:: .*)?$", re.MULTILINE)


def program(page):
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    return "\n".join(blocks)


def imported(tree):
    """The modules and names that a program takes from this library, by what it calls them."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            parts = [part for part in node.names if part.name.startswith("dipoletop")]
            found |= {
                part.asname or part.name: importlib.import_module(part.name) for part in parts
            }
        elif isinstance(node, ast.ImportFrom) and node.module.startswith("dipoletop"):
            module = importlib.import_module(node.module)
            found |= {part.asname or part.name: getattr(module, part.name) for part in node.names}
    return found


def check_names(source):
    """Look up all that a program uses by name: functions, classes, and arguments of their calls."""
    tree = ast.parse(source)
    known = imported(tree)

    def resolved(node):
        if isinstance(node, ast.Name):
            return known.get(node.id)
        owner = resolved(node.value) if isinstance(node, ast.Attribute) else None
        return None if owner is None else getattr(owner, node.attr)

    used = 0
    for node in ast.walk(tree):
        used += resolved(node) is not None
        function = resolved(node.func) if isinstance(node, ast.Call) else None
        if function is not None:
            given = {word.arg: None for word in node.keywords if word.arg}
            inspect.signature(function).bind_partial(**given)
    return used


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.stem)
def test_what_a_page_uses_exists(page):
    assert check_names(program(page)) > 3


def test_a_name_that_does_not_exist_is_found():
    head = "import dipoletop as dt\nfrom dipoletop import planar\n"
    assert check_names(head + "planar.wobble(dt.Outcome.STOP)") > 0
    with pytest.raises(AttributeError, match="simulat"):
        check_names(head + "dt.simulat(0)")
    with pytest.raises(AttributeError, match="END"):
        check_names(head + "dt.Outcome.END")
    with pytest.raises(TypeError, match="tolerance"):
        check_names(head + "dt.classify(0, 0, tolerance=1)")


@pytest.mark.slow
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
