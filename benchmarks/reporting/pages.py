"""The results: numbers in results/*.json, and the pages that show them.

    python -m benchmarks.reporting.pages     write the tables of all pages and of README.md again

The text of a page is written by hand. Within it, comments hold templates (`render.py`), and behind
each of them stands what it gives with the numbers:

    <!-- numbers
    {n} labels
    -->

    200 labels

    <!-- end of numbers -->
"""

import argparse
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from benchmarks.reporting import figures, measure, views
from benchmarks.reporting.render import prepared, render

HERE = measure.ROOT / "benchmarks"
RESULTS = HERE / "results"
NAMES = tuple(sorted(path.stem for path in RESULTS.glob("*.json")))
OF_SPEED = "precision", "scaling", "derivative_costs"
"""Pages of speed.json, beside the one with its name."""
BLOCK = re.compile(r"(<!-- numbers\n(.*?)\n-->\n).*?(<!-- end of numbers -->)", re.DOTALL)
FIGURES = {"speed": figures.work_precision, "label_precision": figures.label_precision}


def read(name: str) -> Any:
    """The numbers that were kept before."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def shown(name: str, numbers: Any = None) -> dict[str, Any]:
    """Numbers, by default those that were kept, with all that a page shows of them."""
    numbers = read(name) if numbers is None else json.loads(json.dumps(numbers))
    return views.of(name, prepared(numbers))


def pages(name: str) -> list[Path]:
    """The pages of some numbers."""
    return [RESULTS / f"{page}.md" for page in (name, *(OF_SPEED if name == "speed" else ()))]


def renewed(page: Path, numbers: dict[str, Any]) -> str:
    """The text of a page, with these numbers."""

    def block(match: re.Match[str]) -> str:
        return f"{match[1]}\n{render(match[2], numbers)}\n\n{match[3]}"

    return BLOCK.sub(block, page.read_text(encoding="utf-8"))


def show(name: str, numbers: Any, *, keep: bool = False) -> None:
    """Print the tables of these numbers; `keep` writes the numbers and the pages."""
    found = shown(name, numbers)
    for page in pages(name):
        for _, template, _ in BLOCK.findall(page.read_text(encoding="utf-8")):
            print(render(template, found), end="\n\n", flush=True)
    if keep:
        text = json.dumps(numbers, indent=1, ensure_ascii=False)
        (RESULTS / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        if name in FIGURES:
            FIGURES[name](shown(name), RESULTS)
        write(name)


def write(*names: str) -> None:
    """Write the pages of the numbers that were kept, and the summary of README.md."""
    numbers = {name: shown(name) for name in NAMES}
    todo = [(page, numbers[name]) for name in names for page in pages(name)]
    for page, found in [*todo, (HERE / "README.md", views.summary(numbers))]:
        page.write_text(renewed(page, found), encoding="utf-8")


def command(name: str, measured: Callable[..., Any], names: Any = (), check: Any = id) -> None:
    """The command of a benchmark: what is `measured` is shown, kept if asked, and checked.

    `measured` is told whether it shall be small, and what of `names` is asked for if it has some.
    """
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    if names:
        parser.add_argument("names", nargs="*", help=f"of: {'; '.join(names)}. Default: all")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")
    jax.config.update("jax_enable_x64", True)
    numbers = measured(args.small, *([args.names] if names else []))
    if not names:  # or else each row tells how it was measured
        numbers = {"command": measure.command(), **measure.machine(), **numbers}
    show(name, numbers, keep=args.write)
    check(numbers)


if __name__ == "__main__":
    write(*NAMES)
