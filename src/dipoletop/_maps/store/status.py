"""Progress, speed and subject of the sweep of a store."""

from pathlib import Path
from typing import Any, NamedTuple

from .layout import tiling_of_starts
from .tiles import Tiles, open_store

RECENT = 100  # tiles from which the rate is found


class Status(NamedTuple):
    """The progress of the sweep of a store."""

    folder: Path
    header: dict[str, Any]
    tiles: int
    finished: int
    """Number of finished tiles."""
    starts: int
    starts_done: int
    bytes: int
    """Size on disk."""
    rate: float | None
    """Starts per second, from the last tiles; None if there are too few."""
    at_work: bool
    """Whether a process is computing tiles, as far as file locks show."""

    @property
    def seconds_left(self) -> float | None:
        """Time to the end at this rate, in seconds."""
        return (self.starts - self.starts_done) / self.rate if self.rate else None


def status(path: Any) -> Status:
    """Return the progress of the sweep of the store at a path.

    Raises:
        StoreMismatch: there is no store.
        StoreDamaged: its metadata are damaged.
    """
    store = open_store(path)
    tiling, left = tiling_of_starts(store.header), store.unfinished()
    finished = tiling.others(left)
    done = sum(tiling.length(tile) for tile in finished)
    size = sum(file.stat().st_size for file in _files(store.folder))
    rate, at_work = _rate(store, finished), store.is_claimed()
    return Status(
        store.folder,
        store.header,
        tiling.count,
        len(finished),
        tiling.size,
        done,
        size,
        rate,
        at_work,
    )


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def _rate(store: Tiles, finished: list[int]) -> float | None:
    """Return the starts per second between the records of the last tiles."""
    times = sorted((store.written_at(tile), tile) for tile in finished)[-RECENT:]
    if len(times) < 2 or times[-1][0] <= times[0][0]:
        return None
    tiling = tiling_of_starts(store.header)
    starts = sum(tiling.length(tile) for _, tile in times[1:])
    return starts / (times[-1][0] - times[0][0])
