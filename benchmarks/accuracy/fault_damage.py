"""Stores with a flipped bit or a truncated file: is the damage found, and is it repaired?"""

import random
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import dipoletop as dt
from benchmarks.accuracy import fault_sweep

HARMS = ("a flipped bit", "a lost end")
SMALL = 12  # tiles


def damaged(trials: int, rng: random.Random) -> list[dict[str, Any]]:
    """So many damages of each kind, of random files; one after the other, each of a good store."""
    with tempfile.TemporaryDirectory() as room:
        good, place = Path(room) / "good.zarr", Path(room) / "s.zarr"
        fault_sweep.swept(str(good), SMALL)
        expected, right = contents(good), dt.Basin.load(good)
        columns = {name: np.asarray(right.column(name)) for name in right.columns}
        rows = [{"harm": harm, "seen": 0, "wrong": 0, "other_bytes": 0} for harm in HARMS]
        for row in rows:
            row["trials"] = trials
            for _ in range(trials):
                shutil.copytree(good, place)
                file = place / rng.choice([f for f in sorted(expected) if expected[f]])
                data = bytearray(file.read_bytes())
                if row["harm"] == HARMS[0]:
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                else:
                    del data[rng.randrange(len(data)) :]
                file.write_bytes(data)
                try:  # a number that can be read must be what was written
                    found = dt.Basin.load(place)
                    for name, values in columns.items():
                        nan = values.dtype.kind == "f"
                        same = np.array_equal(found.column(name), values, equal_nan=nan)
                        row["wrong"] += not same
                except (dt.StoreDamaged, dt.StoreMismatch):
                    row["seen"] += 1
                fault_sweep.swept(str(place), SMALL, repair=True)
                row["other_bytes"] += contents(place) != expected
                shutil.rmtree(place)
    return rows


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of every file of a store, by its path."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
