"""The notebooks: committed with small outputs, and compared with a fresh execution as they should.

The execution itself is in `.ci/run`: python tests/check_notebooks.py.
"""

import base64
import io
import re

import nbformat
import pytest
from PIL import Image

import check_notebooks

PATHS = sorted(check_notebooks.FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_outputs_are_committed_and_small(path):
    assert path.stat().st_size < 800_000
    notebook = nbformat.read(path, as_version=4)
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    for cell in notebook.cells:
        assert "execution" not in cell.metadata
        for output in cell.get("outputs", []):
            assert output.output_type != "error"
            assert set(output.get("data", {})) <= set(check_notebooks.KEPT)
            if "image/png" in output.get("data", {}):
                picture = base64.b64decode(output.data["image/png"])
                assert len(picture) < 250_000
                assert Image.open(io.BytesIO(picture)).width <= 1300


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_cell_that_prints_times_is_marked(path):
    for cell in nbformat.read(path, as_version=4).cells:
        if re.search(r"\.seconds\b|perf_counter|%time", cell.source):
            assert "varies" in cell.metadata.get("tags", []), cell.source


@pytest.mark.parametrize(
    ("was", "found", "same"),
    [
        ("omega = 0.1193", "omega = 0.1193", True),
        ("omega = 0.1193", "omega = 0.1194", False),
        ("x = 1.00000012", "x = 1.00000013", True),
        ("x = 1.000012", "x = 1.000013", True),
        ("x = 1.00012", "x = 1.00013", False),
        ("5 runs", "6 runs", False),
        ("a   1", "a 1", True),
        ("RESIDUAL", "STOP", False),
        ("off by 3e-13", "off by 5e-13", False),
    ],
)
def test_lines_are_compared_to_six_digits(was, found, same):
    assert check_notebooks.same_line(was, found) == same


def test_errors_of_rounding_are_alike_where_a_cell_says_so():
    assert check_notebooks.same_line("off by 3e-13", "off by 5e-13", rounding=True)
    assert not check_notebooks.same_line("off by 3e-3", "off by 5e-3", rounding=True)


def cell(text, tags=()):
    return nbformat.v4.new_code_cell(
        "", outputs=[nbformat.v4.new_output("stream", text=text)], metadata={"tags": list(tags)}
    )


def test_the_first_difference_is_told():
    told = check_notebooks.difference
    assert told(cell("a 1\nb 2\n"), cell("a 1\nb 3\nc\n")) == "line 2 was 'b 2', and is 'b 3'"
    assert told(cell("a\n"), cell("a\nc\n")) == "line 2 was '(nothing)', and is 'c'"
    assert told(cell("a 1"), cell("a 2")) is not None
    assert told(cell("a 1", ["varies"]), cell("b 2")) is None


def test_a_missing_picture_is_told():
    drawn = nbformat.v4.new_output("display_data", data={"image/png": ""})
    before = nbformat.v4.new_code_cell("", outputs=[drawn])
    assert check_notebooks.difference(before, nbformat.v4.new_code_cell("")) is not None


@pytest.mark.system
def test_a_notebook_is_executed_and_compared(tmp_path):
    path = tmp_path / "small.ipynb"
    source = "print(f'{2 / 3:.9f}')"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)]), path)
    told = check_notebooks.check(path)
    assert "cell 0: line 1 was '(nothing)', and is '0.666666667'" in told
    nbformat.write(check_notebooks.executed(path), path)
    assert check_notebooks.check(path) is None
    path.write_text(path.read_text().replace("print(f", "printf(f"))
    assert "does not run" in check_notebooks.check(path)
