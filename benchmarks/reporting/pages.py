"""The results: numbers in results/*.json, and the pages that are made of them in results/*.md.

    python -m benchmarks.reporting.pages     write all pages and the table in README.md again

A page is the docstring of its module here, and below it the tables that its `body` makes.
"""

import argparse
import inspect
import json
from types import ModuleType
from typing import Any

from benchmarks.reporting import (
    derivative_costs,
    derivatives,
    directions,
    explorer,
    faults,
    label_precision,
    labels,
    precision,
    residual,
    savings,
    scaling,
    slow_flow,
    speed,
    stress,
    summary,
    surveys,
)
from benchmarks.reporting.measure import ROOT

HERE = ROOT / "benchmarks"
RESULTS = HERE / "results"
PAGES: dict[str, tuple[ModuleType, ...]] = {
    "speed": (speed, precision, scaling, derivative_costs, savings),
    "labels": (labels,),
    "label_precision": (label_precision,),
    "residual": (residual,),
    "derivatives": (derivatives,),
    "directions": (directions,),
    "stress": (stress,),
    "slow_flow": (slow_flow,),
    "faults": (faults,),
    "surveys": (surveys,),
    "explorer": (explorer,),
}
"""For each file of numbers the modules that make its pages."""
BEGIN, END = "<!-- summary -->", "<!-- end of summary -->"


def read(name: str) -> Any:
    """The numbers that were kept before; none: an empty list."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


def show(name: str, numbers: Any, *, keep: bool) -> None:
    """Print the tables of these numbers; `keep` writes the numbers and the pages."""
    for module in PAGES[name]:
        print(module.body(numbers), end="\n\n", flush=True)
    if keep:
        save(name, numbers)


def save(name: str, numbers: Any) -> None:
    """Write the numbers, their pages, and the table of the README."""
    text = json.dumps(numbers, indent=1, ensure_ascii=False)
    (RESULTS / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    if name == "speed":
        precision.figure(numbers["precision"], RESULTS / "work_precision.png")
    if name == "label_precision":
        label_precision.figure(numbers, RESULTS / "label_precision.png")
    write(name)


def write(name: str) -> None:
    """Write the pages of the numbers that were kept, and the table of the README."""
    for module in PAGES[name]:
        path = RESULTS / f"{module.__name__.rpartition('.')[2]}.md"
        path.write_text(page(module, read(name)), encoding="utf-8")
    readme = HERE / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    table = summary.body({name: read(name) for name in PAGES})
    after = rest.split(END)[1]
    readme.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")


def page(module: ModuleType, numbers: Any) -> str:
    """A page: the title and the text of the module, then its tables."""
    title, _, text = inspect.cleandoc(module.__doc__ or "").partition("\n")
    return f"# {title.rstrip('.')}\n{text}\n\n{module.body(numbers)}\n"


def main() -> None:
    """Write all pages again."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    for name in PAGES:
        write(name)


if __name__ == "__main__":
    main()
