"""Errors of stores: damaged ones, those that cannot be written, and paths that lead to no such."""

from pathlib import Path
from typing import Any

from ..._base.checks import one_line, refusal


class StoreDamaged(ValueError):
    """A store on disk is not as it was written.

    Attributes:
        path: the store.
        tiles: the numbers of its damaged tiles; none if its metadata are damaged.
        reason: what is wrong.
    """

    def __init__(self, path: Path, tiles: tuple[int, ...], reason: str) -> None:
        super().__init__(path, tiles, reason)
        self.path, self.tiles, self.reason = path, tiles, reason

    def __str__(self) -> str:
        shown = ", ".join(str(tile) for tile in self.tiles[:8])
        shown += f" and {len(self.tiles) - 8} more" if len(self.tiles) > 8 else ""
        what = f"tile{'s' * (len(self.tiles) > 1)} {shown}" if self.tiles else "metadata"
        return f"The store {self.path} is damaged, {what}: {self.reason}."


class StoreMismatch(ValueError):
    """A path does not lead to the store that was asked for.

    It holds another sweep, or something that is no store, or no folder can be made there.

    Attributes:
        argument: the name of the argument that gave the path.
        path: where it leads.
        must: what is expected there.
        reason: what is there instead.
    """

    def __init__(self, argument: str, path: Path, must: str, reason: str) -> None:
        super().__init__(argument, path, must, reason)
        self.argument, self.path, self.must = argument, path, must
        self.reason = one_line(reason)

    def __str__(self) -> str:
        return refusal(self.argument, self.must, self.reason)


class StoreNotWritable(OSError):
    """A store on disk cannot be written any more; what is there is kept.

    Attributes:
        path: the store.
        finished: the number of its finished tiles.
        tiles: the number of all its tiles.
        reason: what the operating system says.
    """

    def __init__(self, path: Path, finished: int, tiles: int, reason: str) -> None:
        super().__init__(path, finished, tiles, reason)
        self.path, self.finished, self.tiles, self.reason = path, finished, tiles, reason

    def __reduce__(self) -> Any:
        # OSError would keep two arguments only, when a worker sends it to another process.
        return type(self), (self.path, self.finished, self.tiles, self.reason)

    def __str__(self) -> str:
        return (
            f"The store {self.path} cannot be written ({self.reason}); {self.finished} of its "
            f"{self.tiles} tiles are finished and kept, and the same sweep goes on from there."
        )
