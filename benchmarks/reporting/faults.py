"""Sweeps that are disturbed: killed, out of disk, with very many tiles.

Numbers: [faults.json](faults.json). Command, about ten minutes on two cores:

    python -m benchmarks.accuracy.faults --small     a look
    python -m benchmarks.accuracy.faults --write     all, kept here

Two processes sweep into one store. One of them, mostly both, get a signal at a random moment, and two
new ones go on, until the sweep is finished; then the next store.

- **late**: signals that came after the end of a process; they are not counted as kills.
- **tiles**: how many were computed for how many that the finished stores needed. The rest were in
  hand when their process was killed, or belong to the last store, which is not finished.
- **other bytes**: finished stores in which any file differs from an undisturbed sweep's.
- **left behind**: files or folders beside the finished stores.

Damage is done to one random file of a finished store at a time. **Seen**: `Basin.load`, or the reading of
a column, raised `StoreDamaged` or `StoreMismatch`. **Wrong**: a number was read that is not what was
written. What is not seen is in data that a basin does not use, such as a summary for other programs; repair
finds it. **Other bytes** after `sweep(…, repair=True)`.

On a cluster of Dask, three workers, SIGKILL comes at random moments. A worker is replaced, and the
sweep goes on; a lost scheduler ends the sweep with a `ConnectionError`, and the next one goes on with the store.
"""

from typing import Any

from benchmarks.reporting.tables import bullets, layout, number


def body(results: dict[str, Any]) -> str:
    """The kills, the full disk, the many tiles."""
    disk, soak = results["full_disk"], results["soak"]
    cores = f"{results['cores']} core" + "s" * (results["cores"] > 1)
    return "\n\n".join(
        [
            _killed(results["killed"]),
            _damaged(results["damaged"]),
            _cluster(results["cluster"]),
            _full_disk(disk, results["tiles"]),
            f"A sweep of {soak['tiles']} tiles, {number(soak['seconds'])} s:",
            _soak(soak["seen"]),
            bullets([f"`{results['command']}`, {results['date']}, {cores}"]),
        ]
    )


def _killed(rows: list[dict[str, Any]]) -> str:
    lines = [
        [
            "signal",
            "kills",
            "late",
            "finished stores",
            "other bytes",
            "left behind",
            "tiles",
            "seconds",
        ]
    ]
    for row in rows:
        counts = [
            str(row[name]) for name in ("kills", "late", "stores", "other_bytes", "left_behind")
        ]
        tiles = f"{row['computed']} for {row['needed']}"
        lines.append([row["signal"], *counts, tiles, f"{row['seconds']:.0f}"])
    return layout(lines)


def _damaged(rows: list[dict[str, Any]]) -> str:
    names = ("trials", "seen", "wrong", "other_bytes")
    lines = [["damage", *(name.replace("_", " ") for name in names)]]
    lines += [[row["harm"], *(str(row[name]) for name in names)] for row in rows]
    return layout(lines)


def _cluster(rows: list[dict[str, Any]]) -> str:
    names = ("kills", "stores", "other_bytes")
    lines = [["killed", "kills", "finished stores", "other bytes", "other errors", "seconds"]]
    for row in rows:
        counts = [str(row[name]) for name in names]
        errors = str(len(row["other_errors"]))
        lines.append([f"{row['killed']}s", *counts, errors, f"{row['seconds']:.0f}"])
    return layout(lines)


def _full_disk(disk: dict[str, Any], tiles: int) -> str:
    if not disk["mounted"]:
        return "No small file system could be mounted here."
    bytes_are = "the same bytes as" if disk["same_bytes"] else "OTHER BYTES than"
    return (
        f"Full disk: the sweep said `{disk['said']}`; {disk['kept']} of {tiles} tiles were there. "
        f"With more room it went on, computed {disk['computed_again']} of them again, and left "
        f"{bytes_are} an undisturbed one."
    )


def _soak(seen: list[dict[str, Any]]) -> str:
    lines = [["tiles", "resident memory, MB", "open files"]]
    lines += [[str(x["tiles"]), f"{x['megabytes']:.0f}", str(x["files"])] for x in seen]
    return layout(lines)
