"""Python code of equations and problems, for a user's script."""

import dataclasses
import inspect
import textwrap
from types import NoneType
from typing import Any

import numpy as np

PUBLIC = "dipoletop."


def of_starts(names: tuple[str, ...], equation: str = "equation") -> tuple[str, ...]:
    """Return the lines that define the problem of an equation over these quantities."""
    start = "dt.cylindrical(w_perp, w3, phi)"
    if "amplitude" in names:
        start = "dt.cylindrical(amplitude * jnp.sin(theta), amplitude * jnp.cos(theta), phi)"
    return f"def problem({', '.join(names)}):", f"    return {equation}, {start}"


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
