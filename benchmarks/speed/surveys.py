"""Surveys: limits of sweeps of 1e9 starts and more, from the costs of a tile, a file and a task.

    python -m benchmarks.speed.surveys --small     a look
    python -m benchmarks.speed.surveys             all, some minutes on two cores
    python -m benchmarks.speed.surveys --write     the same, kept: results/surveys.md

Each case is a fresh process that runs `python -m benchmarks.speed.surveys CASE SIZE`.
"""

import argparse
import contextlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Workers of the cluster import this file again, so slow imports are in the functions.

FULL = {"starts": 1 << 22, "tiles": 500}
FEW = {"starts": 1 << 15, "tiles": 24}
ROW = 128  # starts of a small tile
Record = dict[str, Any]


def problem(w3: Any, phi: Any) -> Any:
    import dipoletop as dt

    return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)


def grid(starts: int, columns: int) -> Any:
    import numpy as np

    import dipoletop as dt

    axes = np.linspace(0.0, 0.5, starts // columns), np.arange(columns) * np.pi / columns
    return dt.Grid(w3=axes[0], phi=axes[1])


def kept(over: Any, **settings: Any) -> None:
    """Sweep, keeping every start with its ω∞."""
    import dipoletop as dt

    dt.sweep(problem, over, progress=False, **settings)


def counted(over: Any, **settings: Any) -> None:
    """Count the outcomes."""
    import dipoletop as dt

    dt.tally(problem, over, progress=False, **settings)


WAYS: dict[str, Callable[..., None]] = {"sweep": kept, "tally": counted}


def rate(starts: int) -> Record:
    """Measure the time of a sweep and a tally in memory, on the cores of this process."""
    from benchmarks.reporting import measure

    over, few, found = grid(starts, 1024), grid(ROW, ROW), {}
    for name, way in WAYS.items():
        way(few)
        runs = [measure.timed(lambda way=way: way(over))[1] for _ in range(3)]
        found[name] = measure.summary(runs) | {"starts": starts}
    return {"cores": measure.cores(), **found}


def overhead(tiles: int) -> Record:
    """Measure the time of a small tile in memory, in a store and as a task, and a tile's files."""
    from benchmarks.reporting import measure
    from dipoletop._maps import tiling

    found: Record = {"tiles": tiles}
    usual = tiling.TILE
    with tempfile.TemporaryDirectory() as room, cluster() as client:
        for name, way in WAYS.items():
            place = Path(room) / name
            way(grid(8 * usual, usual), store=place)
            found[f"{name}, files"] = files(place)
            shutil.rmtree(place)
        tiling.TILE = ROW
        over = grid(tiles * ROW, ROW)
        for name, way in WAYS.items():
            place = Path(room) / name
            way(grid(ROW, ROW), store=place)
            shutil.rmtree(place)
            found[f"{name}, in memory"] = measure.timed(lambda way=way: way(over))[1]
            stored = measure.timed(lambda way=way, place=place: way(over, store=place))
            found[f"{name}, in a store"] = stored[1]
            shutil.rmtree(place)
            client.run(small_tiles)
            way(grid(4 * ROW, ROW), store=place, client=client)
            shutil.rmtree(place)
            tasks = {"store": place, "client": client}
            found[f"{name}, tasks"] = measure.timed(
                lambda way=way, tasks=tasks: way(over, **tasks)
            )[1]
            shutil.rmtree(place)
    return found


def small_tiles() -> None:
    """Make the tiles small, on a worker."""
    from dipoletop._maps import tiling

    tiling.TILE = ROW


@contextlib.contextmanager
def cluster() -> Iterator[Any]:
    """Start a Dask cluster on this machine, with a process for each core."""
    from distributed import Client, LocalCluster

    from benchmarks.reporting import measure

    settings = {"n_workers": measure.cores(), "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**settings) as local, Client(local) as client:
        yield client


def files(store: Path) -> Record:
    """Return files and bytes for each tile, without files that a store has once."""
    tiles = len(list((store / "dipoletop-tiles/done/c").iterdir()))
    every = [file for file in store.rglob("*") if file.is_file() and "c" in file.parts]
    of_tiles = [file for file in every if file.relative_to(store).parts[0] not in ("w3", "phi")]
    size = sum(file.stat().st_size for file in of_tiles)
    return {"number": len(of_tiles) / tiles, "bytes": size / tiles}


def measured(sizes: dict[str, int]) -> Record:
    """Measure all cases, each in its own process."""
    from benchmarks.reporting import measure

    rates = []
    for cores in dict.fromkeys((1, measure.cores())):
        with measure.confined(cores):
            rates.append(measure.in_fresh_process(__spec__.name, "rate", sizes["starts"]))
    costs = measure.in_fresh_process(__spec__.name, "overhead", sizes["tiles"])
    return {"rates": rates, "overhead": costs, "command": measure.command(), **measure.machine()}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("case", nargs="?", choices=("rate", "overhead"), help="one case: JSON")
    parser.add_argument("size", nargs="?", type=int, help="its starts, or tiles")
    parser.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")

    import jax

    jax.config.update("jax_enable_x64", True)
    if args.case:
        print(json.dumps({"rate": rate, "overhead": overhead}[args.case](args.size)))
        return
    from benchmarks.reporting import pages

    pages.show("surveys", measured(FEW if args.small else FULL), keep=args.write)


if __name__ == "__main__":
    main()
