"""Notebooks: a fresh execution prints what is committed.

    python tests/check_notebooks.py                  all of them, or those that are named
    python tests/check_notebooks.py --write PATH …   execute, and keep the outputs

Texts must be the same; numbers must agree to six digits. A cell with the tag `varies` prints
times, versions or paths, which are not compared; one with the tag `rounding` prints errors of
rounding, so numbers below 1e-6 are all alike there. Pictures are not compared, but must be there.
"""

import argparse
import base64
import io
import os
import re
import sys
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from PIL import Image

FOLDER = Path(__file__).parents[1] / "notebooks"
NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
ADDRESS = re.compile(r"0x[0-9a-f]{6,}")
DIGITS, ROUNDING = 1e-6, 1e-6
TIMEOUT = 900
KEPT = ("text/plain", "text/markdown", "image/png")
"""What is kept of an output. Other forms repeat the text, with identifiers that always change."""


def executed(path: Path) -> Any:
    """The notebook after a fresh execution, with outputs as they are kept."""
    os.environ.pop("MPLBACKEND", None)  # the kernel draws into the notebook
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    run = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=TIMEOUT, kernel_name="python3", resources=run).execute()
    notebook.metadata.clear()
    notebook.metadata.update(metadata)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = merged([kept(output) for output in cell.outputs])
    return notebook


def kept(output: Any) -> Any:
    """An output without what always changes, its picture with fewer bytes."""
    if "data" in output:
        output.data = {kind: output.data[kind] for kind in KEPT if kind in output.data}
        if "image/png" in output.data:
            output.data["image/png"] = smaller(output.data["image/png"])
        output.metadata = {}
    return output


def merged(outputs: list[Any]) -> list[Any]:
    """The outputs with texts joined that the kernel happened to send in pieces."""
    found: list[Any] = []
    for output in outputs:
        if found and "name" in output and found[-1].get("name") == output.name:
            found[-1].text += output.text
        else:
            found.append(output)
    return found


def smaller(picture: str) -> str:
    """The same picture, all colours true, in as few bytes as PNG allows."""
    file = io.BytesIO()
    plain = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    if plain.getcolors(256):
        plain = plain.quantize(256, dither=Image.Dither.NONE)  # exact
    plain.save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode("ascii")


def printed(cell: Any) -> str:
    """All text of the outputs of a cell, and a word for each picture."""
    parts = []
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        text = output.get("text") or data.get("text/markdown") or data.get("text/plain") or ""
        parts.append(text if text.endswith("\n") else f"{text}\n")
        parts += ["(picture)\n"] if "image/png" in data else []
    return ADDRESS.sub("(address)", "".join(parts))


def difference(before: Any, now: Any) -> str | None:
    """The first difference between the outputs of two executions of a cell, in words."""
    tags = before.metadata.get("tags", [])
    if "varies" in tags:
        return None
    old, new = printed(before).splitlines(), printed(now).splitlines()
    for k in range(max(len(old), len(new))):
        was, found = (lines[k] if k < len(lines) else "(nothing)" for lines in (old, new))
        if not same_line(was, found, "rounding" in tags):
            return f"line {k + 1} was {was.strip()!r}, and is {found.strip()!r}"
    return None


def same_line(was: str, found: str, rounding: bool = False) -> bool:
    """Whether two lines have the same words, and numbers that agree to six digits."""
    old, new = NUMBER.split(was), NUMBER.split(found)
    words = [[re.sub(r"\s+", " ", word) for word in parts[::2]] for parts in (old, new)]
    if words[0] != words[1]:
        return False
    pairs = zip(map(float, old[1::2]), map(float, new[1::2]), strict=True)
    return all(same_number(a, b, rounding) for a, b in pairs)


def same_number(a: float, b: float, rounding: bool) -> bool:
    """Whether two numbers agree to six digits, or are errors of rounding."""
    return abs(a - b) <= DIGITS * max(abs(a), abs(b)) or (
        rounding and max(abs(a), abs(b)) < ROUNDING
    )


def check(path: Path) -> str | None:
    """What is wrong with the committed outputs of a notebook, in one sentence; None if nothing."""
    committed = nbformat.read(path, as_version=4)
    try:
        fresh = executed(path)
    except CellExecutionError as error:
        return f"{path.name} does not run: {str(error).strip().splitlines()[-1]}"
    for k, (before, now) in enumerate(zip(committed.cells, fresh.cells, strict=True)):
        found = difference(before, now) if before.cell_type == "code" else None
        if found:
            return f"{path.name}, cell {k}: {found}."
    return None


def main() -> None:
    """Compare, or write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", type=Path, help="notebooks; all if none is named")
    parser.add_argument("--write", action="store_true", help="keep the outputs")
    options = parser.parse_args()
    for path in options.paths or sorted(FOLDER.glob("*.ipynb")):
        if options.write:
            nbformat.write(executed(path), path)
        elif problem := check(path):
            sys.exit(problem)
        print(path.name, "is written" if options.write else "prints what is committed", flush=True)


if __name__ == "__main__":
    main()
