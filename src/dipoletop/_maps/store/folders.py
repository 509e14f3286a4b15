"""Folders on disk: absolute paths, and folders that appear complete or not at all."""

import contextlib
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..._base.checks import refuse
from .errors import StoreMismatch

PREFIX = ".dipoletop-"


def absolute_path(argument: str, path: Any) -> Path:
    """Return a path of any type as an absolute one, valid after a change of working directory."""
    try:
        return Path(os.path.abspath(os.fsdecode(path)))
    except TypeError:
        refuse(argument, "be a path", f"is {path!r}")


def exists(argument: str, path: Path) -> bool:
    """Return whether something exists at a path; refuse a broken link."""
    if os.path.exists(path):
        return True
    if os.path.lexists(path):
        reason = f"{path} is a link to nothing"
        raise StoreMismatch(argument, path, "be a path to a folder", reason)
    return False


@contextlib.contextmanager
def atomic_folder(argument: str, path: Path) -> Iterator[Path]:
    """Make a hidden folder to be filled, and move it to `path` at the end.

    Raises:
        FileExistsError: another process has made the folder in the meantime.
        StoreMismatch: no folder can be made there.
    """
    with contextlib.ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_left_folders(path.parent)
            hidden = hidden_folder(path.parent)
            fresh = Path(stack.enter_context(hidden)) / path.name
            fresh.mkdir()
        except (OSError, ValueError) as error:
            must = "be a path where a folder can be made"
            reason = f"{path} is not: {getattr(error, 'strerror', None) or error}"
            raise StoreMismatch(argument, path, must, reason) from None
        yield fresh
        try:
            os.replace(fresh, path)
        except OSError as error:
            if not path.exists():
                raise
            raise FileExistsError(f"{path} exists") from error


def hidden_folder(parent: Path) -> "tempfile.TemporaryDirectory[str]":
    """Return a temporary folder whose name contains the process that made it."""
    # The name is short, and independent of the store's, which may have the largest allowed length.
    prefix = f"{PREFIX}{platform.node()[:60]}-{os.getpid()}-"
    return tempfile.TemporaryDirectory(prefix=prefix, dir=parent)


def remove_left_folders(parent: Path) -> None:
    """Remove temporary folders of killed processes of this machine."""
    for folder in parent.glob(f"{PREFIX}{platform.node()[:60]}-*"):
        process = folder.name.rsplit("-", 2)[1]
        if process.isdigit() and not _is_alive(int(process)):
            shutil.rmtree(folder, ignore_errors=True)


def _is_alive(process: int) -> bool:
    if os.name == "nt":  # where signal 0 is not a mere test
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it belongs to somebody else
        return True
    return True
