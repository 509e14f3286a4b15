"""The pages of the API reference, made from what the package exports: nothing can be forgotten.

A name of the top level is on the page of the subject that it belongs to, by the module that it is
made in; a public module has a page with its other names.
"""

import ast
import importlib
import inspect
import pkgutil
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx

import dipoletop

SUBJECTS = {
    "equations": ("Equations of motion", ["equations"]),
    "motions": ("Motions and their ends", ["_base", "_branch", "_runs"]),
    "maps": ("Maps, samples and stores", ["_maps", "explorer"]),
    "bodies": ("Bodies", ["bodies"]),
    "real_particles": (
        "Real particles",
        ["particles", "prediction", "surroundings", "noise", "atlases", "emission"],
    ),
    "equilibria": ("Equilibria", ["stability"]),
}
"""Pages of the top level: title, and the modules whose exports are there."""
NOT_FOR_READERS = ("dipoletop.cli", "dipoletop.paper.ledger_")
"""The command line has `--help`; the ledger is read through `paper.ledger`."""


def top_level() -> dict[str, str]:
    """Every name that `dipoletop` exports, except modules, and the module that it comes from."""
    stub = Path(dipoletop.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = [node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module for node in imports if node.module for alias in node.names}


def subject_of(module: str) -> str:
    """The page of the exports of a module."""
    first = module.split(".")[0]
    for page, (_, homes) in SUBJECTS.items():
        if first in homes:
            return page
    raise LookupError(f"No page for what `{module}` exports: add it to SUBJECTS.")


def public_modules(package: ModuleType = dipoletop) -> list[ModuleType]:
    """All modules without a leading underscore; of a folder with `__all__` only the folder."""
    found = []
    for info in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        private = info.name.rpartition(".")[2].startswith("_")
        if not private and not info.name.startswith(NOT_FOR_READERS):
            module = importlib.import_module(info.name)
            inside = info.ispkg and not hasattr(module, "__all__")
            found += [module, *(public_modules(module) if inside else [])]
    return found


def names_of(module: ModuleType) -> list[str]:
    """The names of a module: its `__all__`, else the functions and classes that it makes."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    return [
        name
        for name, value in vars(module).items()
        if name[0] != "_"
        and callable(value)
        and (getattr(value, "__module__", "") or "").startswith(module.__name__)
    ]


def entry(full: str, value: Any) -> str:
    """The directive that makes the entry of a name."""
    if inspect.isclass(value):
        # Members of an enumeration without a text of their own are members all the same.
        more = "\n   :undoc-members:" if issubclass(value, Enum) else ""
        # Members that equations share are members of each of them.
        more += "\n   :inherited-members: Module" if issubclass(value, eqx.Module) else ""
        return f".. autoclass:: {full}{more}\n"
    return f".. auto{'function' if callable(value) else 'data'}:: {full}\n"


def title(text: str) -> str:
    """A title of reStructuredText."""
    return f"{text}\n{'=' * len(text)}\n"


def first_sentence(value: Any) -> str:
    """The first line of a docstring, which is a sentence."""
    text = (inspect.getdoc(value) or "").partition("\n")[0] if callable(value) else ""
    return text.replace("|", r"\|").replace("*", r"\*")


def page(heading: str, intro: str, names: dict[str, Any]) -> str:
    """A page: what it is about, its names with their first sentences, the entries."""
    rows = [f"   * - :py:obj:`~{full}`\n     - {first_sentence(x)}" for full, x in names.items()]
    table = ".. list-table::\n   :class: names\n\n" + "\n".join(rows) + "\n" if rows else ""
    gallery = f".. minigallery:: {' '.join(names)}\n   :add-heading: In the gallery\n"
    entries = "\n".join(entry(full, value) for full, value in names.items())
    return "\n".join([title(heading), intro, table, entries, gallery if rows else ""])


def pages() -> dict[str, str]:
    """The text of every page by its file name, without the ending."""
    homes = top_level()
    found = {}
    for slug, (heading, _) in SUBJECTS.items():
        names = [name for name, home in homes.items() if subject_of(home) == slug]
        values = {f"dipoletop.{name}": getattr(dipoletop, name) for name in names}
        intro = "All of this is at the top level: ``import dipoletop as dt``.\n"
        found[slug] = page(heading, intro, values)
    for module in public_modules():
        known = {name: getattr(dipoletop, name) for name in homes}
        own, elsewhere = {}, []
        for name in names_of(module):
            value = getattr(module, name)
            if known.get(name) is value:
                elsewhere.append(f":py:obj:`~dipoletop.{name}`")
            else:
                own[f"{module.__name__}.{name}"] = value
        intro = f".. automodule:: {module.__name__}\n   :no-members:\n"
        if elsewhere:
            intro += f"\nAt the top level: {', '.join(elsewhere)}.\n"
        found[module.__name__] = page(module.__name__.removeprefix("dipoletop."), intro, own)
    return found


def write(app: Any) -> None:
    """Write the pages that are new or changed, and remove those that are left over."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    texts = pages()
    for old in folder.glob("*.rst"):
        if old.stem not in texts:
            old.unlink()
    for name, text in texts.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect to the beginning of a build."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
