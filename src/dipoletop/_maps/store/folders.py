"""Folders on disk: absolute paths, and folders that appear complete or not at all."""

import contextlib
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from ..._base.refusals import refuse
from .errors import StoreMismatch

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PREFIX = ".dipoletop-"
LOCK = "lock"
"""The file in a temporary folder that the process which made it has locked."""
_own: set[Path] = set()  # on some file systems a lock does not exclude one's own threads


def absolute_path(argument: str, path: Any) -> Path:
    """Return a path of any type as an absolute one, valid after a change of working directory.

    `~` is the home folder, and a URL may begin with `file:`; other URLs are refused.
    """
    try:
        text = os.fsdecode(path)
    except TypeError:
        refuse(argument, "be a path", f"is {path!r}")
    scheme, mark, _ = text.partition("://")
    if mark and scheme.isalnum():
        url = urlsplit(text)
        if url.scheme != "file" or url.netloc not in ("", "localhost"):
            refuse(argument, "be a path, or a URL of a file of this machine", f"is {text!r}")
        text = url2pathname(url.path)
    return Path(os.path.abspath(os.path.expanduser(text)))


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
            fresh = stack.enter_context(hidden_folder(path.parent)) / path.name
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


@contextlib.contextmanager
def hidden_folder(parent: Path) -> Iterator[Path]:
    """Make an empty temporary folder, which no other process removes while this one lives."""
    # The name is short, and independent of the store's, which may have the largest allowed length.
    prefix = f"{PREFIX}{platform.node()[:60]}-{os.getpid()}-"
    with tempfile.TemporaryDirectory(prefix=prefix, dir=parent) as name:
        folder = Path(name)
        _own.add(folder)
        try:
            with open(folder / LOCK, "wb") as file:
                _takes_lock(file)
                empty = folder / "new"  # beside the lock
                empty.mkdir()
                yield empty
        finally:
            _own.discard(folder)


def remove_left_folders(parent: Path) -> None:
    """Remove temporary folders of killed processes of this machine.

    The number of a process does not show that it has ended: in a container others are counted.
    """
    for folder in parent.glob(f"{PREFIX}{platform.node()[:60]}-*"):
        with contextlib.suppress(OSError), open(folder / LOCK, "r+b") as file:
            if folder not in _own and _takes_lock(file):
                shutil.rmtree(folder, ignore_errors=True)


def _takes_lock(file: IO[bytes]) -> bool:
    """Lock a file; return False if another process has locked it, or if there are no locks."""
    locks: Any = fcntl
    if locks is None:
        return False
    try:
        locks.flock(file, locks.LOCK_EX | locks.LOCK_NB)
    except OSError:
        return False
    return True
