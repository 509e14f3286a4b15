"""Output to terminals and pipes that cannot take all of it: no command fails for that."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def forgiving_output() -> Iterator[None]:
    """Write "?" for characters that a terminal lacks, and nothing to a pipe that nobody reads."""
    before = sys.stdout
    if isinstance(before, io.TextIOWrapper):
        before.reconfigure(errors="replace")
    sys.stdout = _Forgiving(before)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        sys.stdout = before
        with contextlib.suppress(OSError, ValueError):
            _flush(before)


def _flush(stream: Any) -> None:
    """Flush. What is left for a closed pipe goes nowhere, or Python would complain at its end."""
    try:
        stream.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Forgiving:
    """A stream that takes what is written to a closed pipe for written."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: Any) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            return len(text)

    def flush(self) -> None:
        _flush(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
