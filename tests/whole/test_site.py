"""The site's sources: the reference forgets no name, docstrings become tables, pictures are short.

Sphinx itself runs in `.ci/run`; it executes every picture and follows every reference.
"""

import ast
import re
import sys
from pathlib import Path

import api_pages
import docstrings
import pytest
import test_api

import dipoletop as dt

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
PICTURES = sorted((NOTEBOOKS / "gallery").glob("*.py"))


@pytest.fixture(scope="module")
def entries():
    """The full names of all entries in the reference."""
    text = "\n".join(api_pages.pages().values())
    return set(re.findall(r"^\.\. auto(?:class|function|data):: (\S+)$", text, re.MULTILINE))


def test_reference_has_every_name_of_the_top_level(entries):
    modules = {name for name in dt.__all__ if f"dipoletop.{name}" in sys.modules}
    names = {f"dipoletop.{name}" for name in set(dt.__all__) - modules}
    assert names - entries == set()


def test_reference_has_every_name_of_the_public_modules(entries):
    pages = api_pages.pages()
    for module in test_api.public_modules():
        if module.__name__ == "dipoletop.cli":
            continue  # a command, which describes itself
        assert module.__name__ in pages
        for name in test_api.exports(module):
            own = f"{module.__name__}.{name}" in entries
            elsewhere = getattr(dt, name, None) is getattr(module, name)
            assert own or (elsewhere and f"dipoletop.{name}" in entries), (module.__name__, name)


def test_docstrings_become_restructured_text():
    lines = ["| a | b |", "|---|---|", "| `x | y` | |ω| and q* |", "", "It is |ω|."]
    lines += [">>> abs(|x|)", "**bold** `code*`"]
    found = docstrings.as_rst(lines)
    assert found[:4] == ["", ".. list-table::", "   :header-rows: 1", ""]
    assert found[4:6] == ["   * - a", "     - b"]
    assert found[-3:] == [r"It is \|ω\|.", ">>> abs(|x|)", "**bold** `code*`"]
    assert r"     - \|ω\| and q\*" in found


def test_attributes_have_their_types():
    text = ["It.", "", "Attributes:", "    half_time: the time", "        it takes."]
    found = docstrings.with_types(text, dt.Prediction)
    assert found[3].startswith("    half_time (")  # an attribute of its base
    assert "Float[Array, " in found[3]
    assert found[3].endswith("): the time")


def test_a_picture_is_ten_lines():
    assert len(PICTURES) >= 20
    for path in PICTURES:
        source = path.read_text(encoding="utf-8")
        title, line, *_ = ast.get_docstring(ast.parse(source)).splitlines()
        assert line == "=" * len(title), path.name
        _, code = source.split('jax.config.update("jax_enable_x64", True)\n')
        lines = [text for text in code.splitlines() if text.strip()]
        assert len(lines) <= 10, path.name
