"""Surveys: what limits 1e9 starts and more.

Numbers: [surveys.json](surveys.json). Command, some minutes on two cores:

    python -m benchmarks.speed.surveys --small     a look
    python -m benchmarks.speed.surveys --write     all, kept here

The default map (order 1, δ = −0.2, ω⊥ = 0.2), native engine. A **sweep** keeps every start, with ω∞ and
the estimate of its error; a **tally** counts outcomes.

- **Rate**: in memory, in a process that may use one core, and in one that may use all.
- **Tile**: a small one of 128 starts, in memory and in a store; the difference is what a store costs
  for each tile, nearly all of it the creation of files. On network file systems it is more.
- **Task**: the same by a Dask cluster on this machine, one process for each core.
- **Files**: of a tile of 16 384 starts.
"""

from typing import Any

from benchmarks.reporting.tables import bullets, layout, number

STARTS = 1e9, 1e12
TILE, LARGEST, MANY = 16_384, 1 << 20, 65_536  # see `Tiling.of_sweep`
MACHINES = {"a node of 64 cores": 64, "100 nodes of 64 cores": 6400}


def body(results: dict[str, Any]) -> str:
    """Rates, overheads, and what follows from them."""
    return "\n\n".join(
        [
            _rates(results["rates"]),
            _overheads(results["overhead"]),
            "## What follows\n",
            _costs(results),
            _remarks(results),
            bullets([f"`{results['command']}`, {results['date']}, {results['processor']}"]),
        ]
    )


def _rates(rates: list[dict[str, Any]]) -> str:
    lines = [["cores", *(f"{way}: starts per second" for way in ("sweep", "tally")), "efficiency"]]
    one = rates[0]
    for row in rates:
        speeds = [per_second(row[way]) for way in ("sweep", "tally")]
        shares = [
            per_second(row[way]) / per_second(one[way]) / row["cores"] for way in ("sweep", "tally")
        ]
        efficiency = " / ".join(f"{share:.0%}" for share in shares)
        lines.append([str(row["cores"]), *(f"{speed:.2e}" for speed in speeds), efficiency])
    return layout(lines)


def per_second(row: dict[str, Any]) -> float:
    """Starts per second."""
    return row["starts"] / row["seconds"]["min"]


def per_tile(overhead: dict[str, Any], way: str, place: str) -> float:
    """Seconds of a tile that a place adds to those in memory."""
    more = overhead[f"{way}, {place}"]["seconds"] - overhead[f"{way}, in memory"]["seconds"]
    return max(more, 0.0) / overhead["tiles"]


def _overheads(overhead: dict[str, Any]) -> str:
    head = ["in memory, ms a tile", "a store adds", "a task adds", "files a tile", "bytes a start"]
    lines = [["", *head]]
    for way in ("sweep", "tally"):
        whole = overhead[f"{way}, in memory"]["seconds"] / overhead["tiles"]
        adds = [per_tile(overhead, way, place) for place in ("in a store", "tasks")]
        files = overhead[f"{way}, files"]
        lines.append(
            [
                way,
                *(number(1e3 * seconds) for seconds in (whole, *adds)),
                f"{files['number']:.0f}",
                number(files["bytes"] / TILE),
            ]
        )
    return layout(lines)


def tile_of(starts: float) -> int:
    """Starts of a tile in a sweep of so many."""
    least = starts / MANY
    power = 1
    while power < least:
        power *= 2
    return max(TILE, min(power, LARGEST))


def _costs(results: dict[str, Any]) -> str:
    """Hours of computation and of writing, and bytes, for surveys of several sizes."""
    all_cores = results["rates"][-1]
    head = [
        "way",
        "starts",
        "tiles",
        f"these {all_cores['cores']} cores",
        *MACHINES,
        "writing",
        "size",
    ]
    lines = [head]
    for way in ("sweep", "tally"):
        rate = per_second(all_cores[way])
        files = results["overhead"][f"{way}, files"]
        for starts in STARTS:
            tile = tile_of(starts)
            tiles = starts / tile
            seconds = starts / rate
            others = [seconds * all_cores["cores"] / cores for cores in MACHINES.values()]
            writing = tiles * per_tile(results["overhead"], way, "in a store")
            size = files["bytes"] / TILE * starts if way == "sweep" else files["bytes"] * tiles
            times = [duration(x) for x in (seconds, *others, writing)]
            lines.append([way, f"{starts:.0e}", f"{tiles:.0f}", *times, volume(size)])
    return layout(lines)


def _remarks(results: dict[str, Any]) -> str:
    cores, overhead = results["cores"], results["overhead"]
    limits = []
    for way in ("sweep", "tally"):
        seconds = TILE / per_second(results["rates"][-1][way])
        limits.append(cores * seconds / per_tile(overhead, way, "in a store"))
    whole = {way: overhead[f"{way}, in memory"]["seconds"] for way in ("sweep", "tally")}
    shares = [
        whole[way] / overhead["tiles"] / (TILE / per_second(results["rates"][-1][way]))
        for way in ("sweep", "tally")
    ]
    return f"""\
Measured are the rates of {cores} cores, the costs of tiles and tasks, and the bytes. All else is
extrapolated: other machines by their number of cores, at the efficiency measured here; **writing** is
the time in which one process creates the files of all tiles. Not measured: a GPU, a network file
system, more than {cores} cores.

What limits: the computation up to about {limits[0]:.0f} cores (sweep) and {limits[1]:.0f} (tally), where
one process creates files as long as the cores compute; beyond, several processes at the store, or larger
tiles. At 1e12 starts the size of a sweep. And what is done once for each tile, in memory: it takes
{shares[0]:.0%} and {shares[1]:.0%} of the time of a tile of {TILE} starts, and holds the lock of Python's
interpreter, so that threads wait for each other; several processes do not."""


def duration(seconds: float) -> str:
    """A time in units that fit."""
    for unit, size in (("days", 86_400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{number(seconds / size)} {unit}"
    return f"{number(seconds)} s"


def volume(size: float) -> str:
    """A size in units that fit."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if size >= scale:
            return f"{number(size / scale)} {unit}"
    return f"{number(size / 1e6)} MB"
