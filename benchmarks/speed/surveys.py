"""Surveys: limits of sweeps of 1e9 starts and more, from the costs of a tile, a file and a task.

    python -m benchmarks.speed.surveys --small     a look
    python -m benchmarks.speed.surveys             all, some minutes on two cores
    python -m benchmarks.speed.surveys --write     the same, kept: results/surveys.md

Each case is a fresh process.
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster

import dipoletop as dt
from benchmarks.reporting import measure, pages
from dipoletop._maps import tiling

ROW = 128  # starts of a small tile
WAYS: dict[str, Any] = {"sweep": dt.sweep, "tally": dt.tally}


def problem(w3: Any, phi: Any) -> Any:
    return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)


def done(way: str, starts: int, columns: int, place: Path | None = None, **settings: Any) -> Any:
    """A sweep or a tally of so many starts; its time. A store is removed again."""
    axes = np.linspace(0.0, 0.5, starts // columns), np.arange(columns) * np.pi / columns
    over = dt.Grid(w3=axes[0], phi=axes[1])
    settings |= {"store": place, "progress": False}
    clocks = measure.timed(WAYS[way], problem, over, **settings)[1]
    if place is not None:
        clocks["files"] = files(place)
        shutil.rmtree(place)
    return clocks


def rate(starts: int) -> measure.Record:
    """Time of a sweep and of a tally in memory, on the cores that this process may use."""
    found: measure.Record = {"cores": measure.cores()}
    for way in WAYS:
        done(way, ROW, ROW)
        runs = [done(way, starts, 1024) for _ in range(3)]
        found[way] = measure.summary(runs) | {"starts": starts}
    return found


def overhead(tiles: int) -> measure.Record:
    """Time of a small tile in memory, in a store, and as a task; the files of a tile as usual."""
    found: measure.Record = {"tiles": tiles}
    with tempfile.TemporaryDirectory() as room, cluster() as client:
        place = Path(room) / "store"
        for way in WAYS:
            found[f"{way}, files"] = done(way, 8 * tiling.TILE, tiling.TILE, place)["files"]
        small_tiles()
        client.run(small_tiles)
        ways: dict[str, Any] = {"in memory": {}, "in a store": {"place": place}}
        ways["tasks"] = {"place": place, "client": client}
        for way in WAYS:
            for name, settings in ways.items():
                done(way, 4 * ROW, ROW, **settings)
                found[f"{way}, {name}"] = done(way, tiles * ROW, ROW, **settings)
    return found


def small_tiles() -> None:
    """Here, or on a worker."""
    tiling.TILE = ROW


@contextlib.contextmanager
def cluster() -> Iterator[Any]:
    """A Dask cluster on this machine, a process for each core."""
    settings = {"n_workers": measure.cores(), "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**settings) as local, Client(local) as client:
        yield client


def files(store: Path) -> measure.Record:
    """Files and bytes of each tile, not counting those that a store has once."""
    tiles = len(list((store / "dipoletop-tiles/done/c").iterdir()))
    every = [file for file in store.rglob("*") if file.is_file() and "c" in file.parts]
    of_tiles = [file for file in every if file.relative_to(store).parts[0] not in ("w3", "phi")]
    size = sum(file.stat().st_size for file in of_tiles)
    return {"number": len(of_tiles) / tiles, "bytes": size / tiles}


def measured(small: bool) -> measure.Record:
    """All cases, each in a process of its own."""
    rates = []
    for cores in dict.fromkeys((1, measure.cores())):
        with measure.confined(cores):
            rates.append(measure.in_fresh_process(rate, 1 << (15 if small else 22)))
    return {"rates": rates, "overhead": measure.in_fresh_process(overhead, 24 if small else 500)}


if __name__ == "__main__":
    pages.command("surveys", measured)
