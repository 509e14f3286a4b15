"""Folders on disk: where a path points to, and folders that are there whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .._base.checks import refuse


def absolute(argument: str, path: Any) -> Path:
    """A path, given in any way, that means the same wherever the process goes."""
    try:
        return Path(os.path.abspath(os.fsdecode(path)))
    except TypeError:
        refuse(argument, "be a path", f"is {path!r}")


def there(argument: str, place: Path) -> bool:
    """Whether something is at a place; a link to nothing is refused."""
    if os.path.exists(place):
        return True
    if os.path.lexists(place):
        refuse(argument, "be a path to a folder", f"{place} is a link to nothing")
    return False


@contextlib.contextmanager
def whole(argument: str, place: Path) -> Iterator[Path]:
    """A folder that gets its name when it is complete."""
    with contextlib.ExitStack() as stack:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            # A name of its own length: that of `place` may be as long as names can be.
            hidden = tempfile.TemporaryDirectory(prefix=".dipoletop-", dir=place.parent)
            fresh = Path(stack.enter_context(hidden)) / place.name
            fresh.mkdir()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            refuse(argument, "be a path where a folder can be made", f"{place} is not: {reason}")
        yield fresh
        os.replace(fresh, place)
