"""Errors of stores: damaged, not writable, or not the one asked for."""

from pathlib import Path
from typing import Any

from ..._base.refusals import one_line, printable, refusal


class StoreDamaged(ValueError):
    """A store on disk differs from what was written.

    Attributes:
        path: the store.
        tiles: the numbers of its damaged tiles; () if its metadata are damaged.
        reason: description of the damage.
    """

    def __init__(self, path: Path, tiles: tuple[int, ...], reason: str) -> None:
        super().__init__(path, tiles, reason)
        self.path, self.tiles, self.reason = path, tiles, printable(reason)

    def __str__(self) -> str:
        shown = ", ".join(str(tile) for tile in self.tiles[:8])
        shown += f" and {len(self.tiles) - 8} more" if len(self.tiles) > 8 else ""
        what = f"tile{'s' * (len(self.tiles) > 1)} {shown}" if self.tiles else "metadata"
        return f"The store {self.path} is damaged, {what}: {self.reason}."


class StoreMismatch(ValueError):
    """A path does not lead to the store that was asked for.

    It leads to another sweep or to something else, or no folder can be made there.

    Attributes:
        argument: the name of the argument with the path.
        path: the path.
        must: the requirement on the path.
        reason: why it is not met.
    """

    def __init__(self, argument: str, path: Path, must: str, reason: str) -> None:
        super().__init__(argument, path, must, reason)
        self.argument, self.path, self.must = argument, path, must
        self.reason = one_line(reason)

    def __str__(self) -> str:
        return refusal(self.argument, self.must, self.reason)


class StoreNotWritable(OSError):
    """A store on disk cannot be written any more; its finished tiles are kept.

    Attributes:
        path: the store.
        finished: the number of its finished tiles.
        tiles: the number of all its tiles.
        reason: the message of the operating system.
    """

    def __init__(self, path: Path, finished: int, tiles: int, reason: str) -> None:
        super().__init__(path, finished, tiles, reason)
        self.path, self.finished, self.tiles, self.reason = path, finished, tiles, reason

    def __reduce__(self) -> Any:
        # By default a pickled OSError keeps only two arguments.
        return type(self), (self.path, self.finished, self.tiles, self.reason)

    def __str__(self) -> str:
        return (
            f"The store {self.path} cannot be written ({self.reason}); {self.finished} of its "
            f"{self.tiles} tiles are finished and kept, and the same sweep goes on from there."
        )
