"""The public API against a snapshot: names, signatures, fields, methods, first lines of docstrings.

    python tests/whole/test_api.py > tests/whole/api.txt     after a change that is meant

The snapshot is read from the source with `ast`, so that neither the version of Python nor a wrapper
of a function changes it.
"""

import ast
import difflib
import importlib
import inspect
import pkgutil
import re
import sys
from functools import cache
from pathlib import Path

import pytest

import dipoletop as dt
import dipoletop.cli

SNAPSHOT = Path(__file__).with_name("api.txt")
REWRITE = "python tests/whole/test_api.py > tests/whole/api.txt"
PRIVATE = re.compile(r".*(\._|\.paper\.ledger_)")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def public_modules(package=dt):
    """The modules without a leading underscore; not those in a folder that has `__all__`."""
    for info in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if not PRIVATE.match(info.name):
            module = importlib.import_module(info.name)
            yield module
            if info.ispkg and not hasattr(module, "__all__"):
                yield from public_modules(module)


def exports(module):
    """The names in `__all__`; without it, of the functions and classes made in the module."""
    if hasattr(module, "__all__"):
        return sorted(module.__all__)
    own = {n: getattr(x, "__module__", None) or "" for n, x in vars(module).items() if callable(x)}
    return sorted(n for n in own if n[0] != "_" and own[n].startswith(module.__name__))


def of_module(module, known):
    """The lines of a module; what another one has shown is only named."""
    yield f"# {module.__name__}: {first_line(module.__doc__)}"
    for name in exports(module):
        value = inspect.unwrap(getattr(module, name))
        node = definition(value)
        if id(value) in known:
            yield f"{name}: see {known[id(value)]}"
        elif isinstance(node, ast.ClassDef):
            bases = ", ".join(map(written, node.bases))
            yield f"class {name}({bases}):  # {first_line(ast.get_docstring(node))}"
            ours = [(n, base) for base in reversed(value.__mro__) if (n := definition(base))]
            yield from (f"    {line}" for n, _ in ours for line in fields(n))
            yield from (f"    {x}" for x in sorted({x for pair in ours for x in methods(*pair)}))
        elif isinstance(node, Function):
            yield function(node, value, name)
        else:
            yield f"{name}: {type(value).__name__}"
        known.setdefault(id(value), module.__name__)
    yield ""


@cache
def tree(path):
    return ast.parse(Path(path).read_text(encoding="utf-8"))


def definition(value):
    """The syntax tree of a function or class of ours; None for anything else."""
    if not getattr(value, "__module__", "").startswith("dipoletop") or inspect.ismodule(value):
        return None
    node = tree(sys.modules[value.__module__].__file__)
    for name in getattr(value, "__qualname__", "").split("."):
        named = [inner for inner in node.body if getattr(inner, "name", "") == name]
        if not named:
            return None
        node = named[-1]
    return node


def function(node, owner, name):
    """The signature and the first line of the docstring."""
    constants = vars(sys.modules[owner.__module__])
    defaults = [*node.args.defaults, *node.args.kw_defaults]
    plain = {
        each.id: repr(constants[each.id])
        for each in defaults
        if isinstance(each, ast.Name) and isinstance(constants.get(each.id), int | float | str)
    }
    signature = re.sub(r"=(\w+)", lambda m: f"={plain.get(m[1], m[1])}", written(node.args))
    result = f" -> {written(node.returns)}" if node.returns else ""
    return f"def {name}({signature}){result}:  # {first_line(ast.get_docstring(node))}".rstrip("# ")


def fields(node):
    """The public fields of a class, and what else it assigns, in their order."""
    assigned = [item for item in node.body if isinstance(item, ast.AnnAssign | ast.Assign)]
    return [written(item) for item in assigned if written(item)[0] != "_"]


def methods(node, owner):
    """The public properties and methods of a class."""
    for item in node.body:
        name = getattr(item, "name", "_")
        if isinstance(item, Function) and (name[0] != "_" or name in ("__init__", "__call__")):
            decorators = "".join(f"@{written(decorator)} " for decorator in item.decorator_list)
            yield decorators + function(item, owner, name)


def written(node):
    """Code without the paths of modules: `jax.Array` is `Array`."""
    return re.sub(r"\b(?:[a-z_]\w*\.)+(?=[A-Za-z_])", "", ast.unparse(node))


def first_line(text):
    return (text or "").strip().partition("\n")[0]


def of_command(command, path="dipoletop"):
    """The command line: each command, its arguments, its options and their defaults."""
    yield f"$ {path}  # {first_line(command.help)}"
    for parameter in command.params:
        value = parameter.default if isinstance(parameter.default, int | float | str) else ""
        names = "/".join([*parameter.opts, *parameter.secondary_opts])
        yield f"    {names} {value}".rstrip()
    for name, inner in sorted(getattr(command, "commands", {}).items()):
        yield from of_command(inner, f"{path} {name}")


def snapshot():
    known = {}
    lines = [line for module in [dt, *public_modules()] for line in of_module(module, known)]
    return "\n".join([*lines, *of_command(dipoletop.cli.main)]) + "\n"


def test_a_misspelt_name_is_answered_with_the_nearest():
    with pytest.raises(AttributeError, match="no attribute 'classfy'; did you mean 'classify'\\?"):
        dt.classfy  # noqa: B018
    assert not hasattr(dt, "__wrapped__")


def test_public_api_is_that_of_the_snapshot():
    before, now = SNAPSHOT.read_text(encoding="utf-8"), snapshot()
    changes = difflib.unified_diff(before.splitlines(), now.splitlines(), "before", "now", n=0)
    assert before == now, "\n".join([*changes, "", f"If this is meant: {REWRITE}"])


if __name__ == "__main__":
    sys.stdout.write(snapshot())
