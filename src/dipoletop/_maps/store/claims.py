"""Claims of tiles by processes, so that several can work on one store.

A claim is a lock on one byte of a file, which the operating system releases when the process ends
for any reason. Without such locks (Windows, some network file systems) every claim is granted, and
two processes compute the same tiles, with the same bytes.
"""

import contextlib
import errno
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from .errors import StoreMismatch
from .folders import fcntl  # None on Windows

_in_use: set[tuple[int, int]] = set()  # files; such locks do not exclude one's own threads
_guard = threading.Lock()


class Claims:
    """The claims of one process on the tiles of one store.

    Args:
        store: the folder of the store.
        file: the file that is locked; it is made if it does not exist.

    Raises:
        StoreMismatch: another sweep of this process has the store.
    """

    def __init__(self, store: Path, file: Path) -> None:
        self._file: IO[bytes] | None = None
        self._key: tuple[int, int] | None = None
        with _guard:
            try:
                file.touch(exist_ok=True)
                info = file.stat()
                key = info.st_dev, info.st_ino
                if key in _in_use:  # not opened: closing it would end the claims of that sweep
                    must = "be used by one sweep of a process at a time"
                    raise StoreMismatch("store", store, must, f"another one here uses {store}")
                self._file = open(file, "r+b")  # noqa: SIM115 (closed by `close`)
            except OSError:  # a read-only store: nothing can be computed twice
                return
            _in_use.add(key)
            self._key = key

    def take(self, tile: int) -> bool:
        """Claim a tile; False if another process has it."""
        return self._lock(1, tile) is not False

    @contextlib.contextmanager
    def everything(self) -> Iterator[bool | None]:
        """Claim the whole store for a moment; False if others have a claim, None without locks."""
        free = self._lock(0, 0)
        try:
            yield free
        finally:
            if free:
                self._unlock(0, 0)

    def give_back(self, tile: int) -> None:
        """Release a claim."""
        self._unlock(1, tile)

    def close(self) -> None:
        """Release all claims."""
        if self._file is not None:
            self._file.close()
        with _guard:
            _in_use.discard(self._key or (0, 0))
        self._file = self._key = None

    def _lock(self, length: int, first: int) -> bool | None:
        """Lock `length` bytes, or all following ones if it is 0; None if there are no locks."""
        locks: Any = fcntl
        if locks is None or self._file is None:
            return None
        try:
            locks.lockf(self._file, locks.LOCK_EX | locks.LOCK_NB, length, first)
        except OSError as error:
            return False if error.errno in (errno.EACCES, errno.EAGAIN) else None
        return True

    def _unlock(self, length: int, first: int) -> None:
        locks: Any = fcntl
        if locks is not None and self._file is not None:
            with contextlib.suppress(OSError):
                locks.lockf(self._file, locks.LOCK_UN, length, first)
