"""Old public names, which work for one more release with a warning that tells the new ones."""

import functools
import sys
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_INSIDE = ("dipoletop", "equinox", "jaxtyping", "beartype")
"""Packages whose frames lie between the call of a user and the warning."""


def _warn(old: str, new: str) -> None:
    """A `DeprecationWarning` at the line that used the old name."""
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in _INSIDE:
        frame, level = frame.f_back, level + 1
    text = f"`{old}` is deprecated and will be removed in the next release: use `{new}`."
    warnings.warn(text, DeprecationWarning, stacklevel=level)


def renamed_argument(*, old: str, new: str) -> Callable[[Function], Function]:
    """Decorator of a function with a keyword argument `new`, which still takes the name `old`."""

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def wrapped(*args: Any, **named: Any) -> Any:
            if old in named:
                if new in named:
                    raise TypeError(f"`{old}` is the old name of `{new}`: give only `{new}`.")
                name = function.__name__
                _warn(f"{name}({old}=...)", f"{name}({new}=...)")
                named[new] = named.pop(old)
            return function(*args, **named)

        return wrapped  # pyright: ignore[reportReturnType]

    return decorate


def deprecated(*, new: str) -> Callable[[Function], Function]:
    """Decorator of a function, a method or a property's getter that `new` replaces."""

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def wrapped(*args: Any, **named: Any) -> Any:
            _warn(function.__qualname__, new)
            return function(*args, **named)

        return wrapped  # pyright: ignore[reportReturnType]

    return decorate


def renamed_attributes(module: str, names: dict[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a module whose attributes got new names, as {old: new}.

    For example `__getattr__ = renamed_attributes(__name__, {"Uncertainty": "Exponent"})`.
    """

    def getattribute(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        _warn(f"{module}.{name}", f"{module}.{names[name]}")
        return getattr(sys.modules[module], names[name])

    return getattribute
