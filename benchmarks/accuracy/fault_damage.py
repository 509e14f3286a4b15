"""Stores with a flipped bit or a truncated file: is the damage found, and is it repaired?"""

import random
import shutil
from pathlib import Path
from typing import Any

from benchmarks.accuracy import fault_sweep

Row = dict[str, Any]
HARMS = ("a flipped bit", "a lost end")
SMALL = 12  # tiles


def damaged(trials: int, rng: random.Random, room: Path) -> list[Row]:
    """Damage a random file of an intact store many times in each way; return the consequences."""
    import numpy as np

    import dipoletop as dt

    good, place = room / "good.zarr", room / "s.zarr"
    fault_sweep.swept(str(good), SMALL)
    expected, right = contents(good), dt.Basin.load(good)
    columns = {name: np.asarray(right.column(name)) for name in right.columns}

    def wrong() -> bool:
        """Return whether a number that can be read differs from what was written."""
        found = dt.Basin.load(place)
        return any(
            not np.array_equal(found.column(name), values, equal_nan=values.dtype.kind == "f")
            for name, values in columns.items()
        )

    rows = []
    for harm in HARMS:
        row: Row = {"harm": harm, "trials": 0, "seen": 0, "wrong": 0, "other_bytes": 0}
        while row["trials"] < trials:
            shutil.copytree(good, place)
            _damage(rng.choice([f for f in sorted(expected) if expected[f]]), place, harm, rng)
            row["trials"] += 1
            try:
                row["wrong"] += wrong()
            except (dt.StoreDamaged, dt.StoreMismatch):
                row["seen"] += 1
            fault_sweep.swept(str(place), SMALL, repair=True)
            row["other_bytes"] += contents(place) != expected
            shutil.rmtree(place)
        rows.append(row)
    return rows


def _damage(file: str, place: Path, harm: str, rng: random.Random) -> None:
    data = bytearray((place / file).read_bytes())
    if harm == HARMS[0]:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    else:
        del data[rng.randrange(len(data)) :]
    (place / file).write_bytes(data)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of every file of a store, by its path."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
