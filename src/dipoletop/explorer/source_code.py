"""Python code of equations and problems, for a user's script."""

import dataclasses
import inspect
import textwrap
from types import NoneType
from typing import Any

import numpy as np

from ..equations.levels import Level

PUBLIC = "dipoletop."


def start_of(names: tuple[str, ...]) -> str:
    """Return the expression of the start ω₀ in these quantities."""
    if "amplitude" in names:
        return "dt.cylindrical(amplitude * jnp.sin(theta), amplitude * jnp.cos(theta), phi)"
    return "dt.cylindrical(w_perp, w3, phi)"


def of_top(level: Level | None, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the lines that define the problem of the transverse top at a level."""
    equation = f'dt.equation_at("{level}", delta)'
    return _function("problem", names, f"return {equation}, {start_of(names)}")


def of_starts(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the lines that define the problem of one equation, over its starts."""
    return _function("problem", names, f"return equation, {start_of(names)}")


def _function(name: str, arguments: tuple[str, ...], line: str) -> tuple[str, ...]:
    return f"def {name}({', '.join(arguments)}):", f"    {line}"


def of_equation(equation: Any) -> tuple[str, ...]:
    """Return the lines that define an equation; for a user's class, a comment to fill it in."""
    written = _literal(equation)
    if written is None:
        kind = type(equation).__qualname__
        return (
            "# `equation` is the one that was given to `dt.explore`, of your own class",
            f"# {kind}.",
        )
    return (f"equation = {written}",)


def of_function(problem: Any) -> tuple[str, ...]:
    """Return the lines of a user's problem: its code if Python finds it, else a comment."""
    name = getattr(problem, "__name__", "problem")
    try:
        lines = textwrap.dedent(inspect.getsource(problem)).rstrip().splitlines()
    except (OSError, TypeError):
        lines = []
    if not lines or not lines[0].startswith("def "):
        return ("# `problem` is the function that was given to `dt.explore`.",)
    return (*lines, *(() if name == "problem" else ("", f"problem = {name}")))


def _literal(value: Any) -> str | None:
    """Return an expression for a value; None if it has no short one."""
    if isinstance(value, bool | int | float | str | NoneType):
        return repr(value)
    if hasattr(value, "__array__"):
        return repr(np.asarray(value).tolist())
    kind = type(value)
    if not dataclasses.is_dataclass(value) or not kind.__module__.startswith(PUBLIC):
        return None
    fields = [field.name for field in dataclasses.fields(value) if field.init]
    parts = {name: _literal(getattr(value, name)) for name in fields}
    if any(part is None for part in parts.values()):
        return None
    return f"dt.{kind.__name__}({', '.join(f'{name}={part}' for name, part in parts.items())})"
