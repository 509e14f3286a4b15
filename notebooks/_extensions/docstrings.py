"""Docstrings are Markdown with Google sections; Sphinx reads reStructuredText.

What differs is changed: tables of pipes, bars such as |ω|, and single asterisks. The types of
attributes are added from the annotations.
"""

import inspect
import re
from typing import Any

ROW = re.compile(r"^(\s*)\|\s(.*)\s\|\s*$")
RULE = re.compile(r"^\s*\|(-+\|)+\s*$")
CODE = re.compile(r"(`[^`]*`)")
SIGNS = re.compile(r"\||(?<!\*)\*(?!\*)|(?<=\w)_(?!\w)|(?<![^ ])\+(?= )")
ATTRIBUTE = re.compile(r"^    (\w+): ")


def as_rst(lines: list[str]) -> list[str]:
    """The lines of a docstring for Sphinx."""
    found: list[str] = []
    example = False
    for k, line in enumerate(lines):
        example = line.strip() != "" and (example or line.lstrip().startswith(">>>"))
        row = ROW.match(line)
        if example:
            found.append(line)
        elif RULE.match(line):
            continue
        elif row:
            header = k + 1 < len(lines) and RULE.match(lines[k + 1]) is not None
            found.extend(_table_row(row[1], row[2], header))
        else:
            found.append(_escaped(line))
    return found


def _table_row(indent: str, text: str, header: bool) -> list[str]:
    """A row of a list-table; the header begins the table."""
    begin = ["", f"{indent}.. list-table::", f"{indent}   :header-rows: 1", ""] if header else []
    cells = [_escaped(cell.strip()) for cell in re.split(r"\s\|\s", text)]
    marks = ["   * -", *["     -"] * (len(cells) - 1)]
    return begin + [f"{indent}{mark} {cell}" for mark, cell in zip(marks, cells, strict=True)]


def _escaped(text: str) -> str:
    """Signs outside of code that reStructuredText would take for its own stand for themselves."""
    parts = CODE.split(text)
    parts[::2] = [SIGNS.sub(r"\\\g<0>", part) for part in parts[::2]]
    return "".join(parts)


def with_types(lines: list[str], owner: Any) -> list[str]:
    """The section "Attributes" with the type of each attribute."""
    annotations: dict[str, Any] = {}
    for base in reversed(inspect.getmro(owner)):
        annotations |= inspect.get_annotations(base)
    found, inside = [], False
    for line in lines:
        inside = line == "Attributes:" or (inside and (line.startswith("    ") or not line))
        name = ATTRIBUTE.match(line) if inside else None
        kind = annotations.get(name[1]) if name else None
        if name and kind is not None:
            text = kind if isinstance(kind, str) else inspect.formatannotation(kind)
            text = re.sub(r"\b(?:\w+\.)+(?=\w)", "", text).replace("*", r"\*")
            line = f"    {name[1]} ({text}): {line[name.end() :]}"
        found.append(line)
    return found


def process(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Change the lines in place, before napoleon reads them."""
    from sphinx.ext.napoleon import GoogleDocstring  # the tests of this page need no Sphinx

    lines[:] = as_rst(lines)
    if what == "class":
        lines[:] = with_types(lines, value)
    elif what in ("attribute", "data", "property"):
        # Napoleon takes words before a colon in the first line for a type: let it be a comment.
        parsed = GoogleDocstring(lines, app.config, app, "method", name, value, options)
        lines[:] = ["..", "", *parsed.lines()]


def setup(app: Any) -> dict[str, bool]:
    """Connect to autodoc, ahead of napoleon, whose priority is 500."""
    app.connect("autodoc-process-docstring", process, priority=400)
    return {"parallel_read_safe": True}
