"""The sentences that refuse a bad argument."""

from typing import Any, NoReturn

LONGEST = 2000  # characters of a value that a message shows


def one_line(value: Any) -> str:
    """Return a value as text on one line, cut if it is long, without control characters."""
    shown = printable(" ".join(str(value).split()))  # some values print over many lines
    return shown[:LONGEST] + " …" if len(shown) > LONGEST else shown


def printable(text: str) -> str:
    """Return a text in which characters that control a terminal are written as escapes."""
    return "".join(x if x.isprintable() else ascii(x)[1:-1] for x in text)


def refusal(name: str, must: str, was: Any) -> str:
    """Return the message of a refusal: "Argument `name` must …, but …."."""
    return f"Argument `{name}` must {must}, but {one_line(was)}."


def refuse(name: str, must: str, was: Any) -> NoReturn:
    """Raise a ValueError with a refusal."""
    raise ValueError(refusal(name, must, was))


def described(value: Any) -> str:
    """Return a short description of a value of a wrong type."""
    if isinstance(value, type):
        return f"is the class {value.__name__}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return f"is {value!r}"
    return f"is of type {type(value).__name__}"
