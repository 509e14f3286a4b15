"""Folders on disk: absolute paths, and folders that appear complete or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..._base.checks import refuse
from .errors import StoreMismatch


def absolute_path(argument: str, path: Any) -> Path:
    """A path of any type as an absolute one, which stays valid when the process changes folder."""
    try:
        return Path(os.path.abspath(os.fsdecode(path)))
    except TypeError:
        refuse(argument, "be a path", f"is {path!r}")


def exists(argument: str, path: Path) -> bool:
    """Whether there is something at a path; a link to nothing is refused."""
    if os.path.exists(path):
        return True
    if os.path.lexists(path):
        reason = f"{path} is a link to nothing"
        raise StoreMismatch(argument, path, "be a path to a folder", reason)
    return False


@contextlib.contextmanager
def atomic_folder(argument: str, path: Path) -> Iterator[Path]:
    """A hidden folder to be filled, which is moved to `path` at the end."""
    with contextlib.ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Its name is short: that of `path` may be as long as the file system allows.
            hidden = tempfile.TemporaryDirectory(prefix=".dipoletop-", dir=path.parent)
            fresh = Path(stack.enter_context(hidden)) / path.name
            fresh.mkdir()
        except (OSError, ValueError) as error:
            must = "be a path where a folder can be made"
            reason = f"{path} is not: {getattr(error, 'strerror', None) or error}"
            raise StoreMismatch(argument, path, must, reason) from None
        yield fresh
        os.replace(fresh, path)
