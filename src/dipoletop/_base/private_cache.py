"""A cache of files between processes that only this user can have written.

Its content may be executed. So an entry is used only if it and its folder belong to the user,
nobody else may write there, and its checksum is right. Any error counts as a missing entry, so that
the cache never makes a computation fail.
"""

import contextlib
import os
import stat
import sys
import tempfile
from pathlib import Path

from .digests import SIZE, digest

VARIABLE = "DIPOLETOP_CACHE"
"""The environment variable that names the folder of the cache, or switches it off."""
LIMIT = 64 * 2**20
"""Largest total size of the entries in bytes; beyond it the oldest are removed."""


def load(key: bytes) -> bytes | None:
    """Return the content saved under this key, or None."""
    folder = _folder()
    if folder is None:
        return None
    try:
        # Links, and pipes, which would make this process wait, are not entries.
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        with open(os.open(folder / key.hex(), flags | getattr(os, "O_BINARY", 0)), "rb") as file:
            state = os.fstat(file.fileno())
            if not (stat.S_ISREG(state.st_mode) and _is_private(state)):
                return None
            entry = file.read()
    except OSError:
        return None
    content = entry[SIZE:]
    return content if entry[:SIZE] == digest(key, content) else None


def save(key: bytes, content: bytes) -> None:
    """Save the content under this key, in place of an older one; not if it exceeds the limit."""
    folder = _folder(make=True)
    if folder is None or len(content) > LIMIT - SIZE:
        return
    with contextlib.suppress(OSError):
        number, name = tempfile.mkstemp(prefix=".", dir=folder)  # for this user only
        try:
            with open(number, "wb") as file:
                file.write(digest(key, content) + content)
            os.replace(name, folder / key.hex())
        except OSError:
            os.unlink(name)
            raise
        _remove_oldest(folder)


def location() -> Path | None:
    """The folder of the cache, whether it is there or not; None if it is switched off."""
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() in ("0", "off", "no", "false"):
        return None
    if os.path.isabs(wanted):
        return Path(wanted)
    home = os.path.expanduser("~")
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.join(home, "AppData", "Local")
    elif sys.platform == "darwin":
        base = os.path.join(home, "Library", "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME", "")
        if not os.path.isabs(base):  # as the XDG standard requires
            base = os.path.join(home, ".cache")
    return Path(base) / "dipoletop" if os.path.isabs(base) else None


def subfolder(name: str) -> Path | None:
    """Return a folder in the cache for files of another library, without the oldest beyond a limit.

    None if there is no cache, or if others may write to the folder.
    """
    folder = _folder(make=True)
    if folder is None:
        return None
    try:
        within = folder / name
        within.mkdir(mode=0o700, exist_ok=True)
        if not _is_private(within.lstat()):
            return None
        _remove_oldest(within)
    except OSError:
        return None
    return within


def _folder(make: bool = False) -> Path | None:
    """Return the folder of the cache if it exists and only this user can write to it, else None."""
    folder = location()
    try:
        if folder is None:
            return None
        if make:
            folder.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):
                folder.mkdir(mode=0o700)
        state = folder.lstat()
    except OSError:
        return None
    return folder if stat.S_ISDIR(state.st_mode) and _is_private(state) else None


def _is_private(state: os.stat_result) -> bool:
    """Return whether this user owns a file and nobody else may write to it."""
    if not hasattr(os, "getuid"):  # Windows: a user's folder is closed to others
        return True
    return state.st_uid == os.getuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _remove_oldest(folder: Path) -> None:
    """Remove the oldest entries until the rest is within the limit."""
    files = []
    for file in os.scandir(folder):
        with contextlib.suppress(OSError):  # another process has removed it
            state = file.stat(follow_symlinks=False)
            if stat.S_ISDIR(state.st_mode):
                continue
            files.append((state.st_mtime_ns, state.st_size, file.path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= LIMIT:
            return
        with contextlib.suppress(OSError):
            os.unlink(path)
        total -= size
