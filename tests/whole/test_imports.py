"""Imports run one way, in the order that CONTRIBUTING gives; none is hidden, none in a circle."""

import ast
import graphlib
from importlib.util import resolve_name
from pathlib import Path

ROOT = Path(__file__).parents[2] / "src"
ORDER = """_base | bodies | radiation particles | surroundings | equations | exact planar _branch
    | _averaging | emission noise stability torques | _engines | _runs | _maps | boundary | adaptive
    atlases complexity continuation prediction uncertainty validation | fitting | plots | paper
    | explorer | cli"""
RANK = {page: rank for rank, pages in enumerate(ORDER.split("|")) for page in pages.split()}
# Exceptions by page, and why. The list shall become shorter: an entry without need fails.
INSIDE_FUNCTIONS = {  # and any in cli: a command imports what it needs, so `--help` is quick
    ("_engines", "_engines"): "llvmlite",
    ("explorer", "explorer"): "panel",
}


def imports():
    """Every import below the package: module, what it imports, whether in a function or an `if`."""
    for path in ROOT.rglob("*.py"):
        *folder, stem = path.relative_to(ROOT).with_suffix("").parts
        tree = ast.parse(path.read_text(encoding="utf-8"))
        late = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.If)]
        inside = {id(node) for block in late for node in ast.walk(block)}
        for node in ast.walk(tree) if folder[1:] or stem != "__init__" else ():
            module = ".".join([*folder[1:], *([stem] if stem != "__init__" else [])])
            if isinstance(node, ast.Import):
                yield from ((module, alias.name, id(node) in inside) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = resolve_name("." * node.level + (node.module or ""), ".".join(folder))
                for alias in node.names:
                    file = ROOT.joinpath(*base.split("."), alias.name)
                    deeper = file.is_dir() or file.with_suffix(".py").exists()
                    yield module, f"{base}.{alias.name}" if deeper else base, id(node) in inside


ALL = sorted(imports())
OURS = [(m, to.removeprefix("dipoletop."), h) for m, to, h in ALL if to.startswith("dipoletop")]
PAGES = [(m.split(".")[0], to.split(".")[0], inside) for m, to, inside in OURS]


def test_imports_run_one_way():
    assert {(a, b) for a, b, _ in PAGES if a != b and RANK[b] >= RANK[a]} == set()
    drawing = {m.split(".")[0] for m, to, h in ALL if not h and to.startswith("matplotlib")}
    assert {page for page in drawing if RANK[page] < RANK["plots"]} == set()
    edges = {m: {to for n, to, h in OURS if n == m and not h} - {m} for m, *_ in OURS}
    graphlib.TopologicalSorter(edges).prepare()  # raises CycleError


def test_functions_hide_no_other_imports():
    hidden = {(a, b) for a, b, inside in PAGES if inside and a != "cli"}
    assert hidden == set(INSIDE_FUNCTIONS)
