"""Sweeps that are killed repeatedly, a full disk, many tiles.

    python -m benchmarks.accuracy.faults --small     a look
    python -m benchmarks.accuracy.faults             all, about ten minutes on two cores
    python -m benchmarks.accuracy.faults --write     the same, kept: results/faults.md

Two processes sweep into one store. One or, mostly, both are killed at random moments, and two new
ones resume, until the sweep is finished. Its bytes are compared with an undisturbed sweep; then the
next store begins. The full disk is a small file system in memory, if one can be mounted. On a Dask
cluster, workers and schedulers are killed.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from benchmarks.accuracy import fault_cluster, fault_sweep
from benchmarks.accuracy.fault_sweep import contents
from benchmarks.reporting import measure, pages

Row = dict[str, Any]
KILLS = {"SIGKILL": 200, "SIGTERM": 20, "SIGINT": 20}
CLUSTER = {"worker": 20, "scheduler": 5}
TILES = 100


class Sweeper:
    """A process that sweeps, with its output.

    It is a fork of this process, which has imported everything but has not started JAX, so that the
    sweep begins at once.
    """

    def __init__(self, folder: Path, tiles: int) -> None:
        (output, into_output), (errors, into_errors) = os.pipe(), os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.dup2(into_output, 1)
            os.dup2(into_errors, 2)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            try:
                fault_sweep.run(str(folder), tiles)
            except BaseException:
                traceback.print_exc()
                sys.stderr.flush()
                os._exit(1)
            os._exit(0)
        os.close(into_output)
        os.close(into_errors)
        self.output, self._errors = os.fdopen(output, "rb"), os.fdopen(errors, "rb")
        self._ended = False
        while (line := self.output.readline()) and line != b"ready\n":  # to sweep
            pass

    def signal(self, number: int) -> bool:
        """Send a signal; False if the process has ended already."""
        pid, _ = os.waitpid(self.pid, os.WNOHANG)
        self._ended = pid != 0
        if not self._ended:
            os.kill(self.pid, number)
        return not self._ended

    def rest(self) -> tuple[list[int], bool, str]:
        """The tiles that it computed, whether it came to its end, and its errors."""
        with self.output, self._errors:
            words, errors = self.output.read().split(), self._errors.read().decode()
        if not self._ended:
            os.waitpid(self.pid, 0)
        return [int(word) for word in words if word.isdigit()], b"done" in words, errors


def killed(name: str, kills: int, rng: random.Random, expected: Any, length: float) -> Row:
    """So many kills by a signal, at random moments, of processes at a store; at least one store."""
    number = getattr(signal, name)
    row: Row = {"signal": name, "kills": 0, "late": 0, "stores": 0, "other_bytes": 0}
    row |= {"computed": 0, "needed": 0, "left_behind": 0, "other_files": []}
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as room:
        place = Path(room) / "s.zarr"
        while row["kills"] < kills or not row["stores"]:
            pair = [Sweeper(place, TILES) for _ in range(2)]
            rng.shuffle(pair)
            for sweeper, share in zip(pair, (0.7, 0.1), strict=True):
                time.sleep(rng.uniform(0, share * length))
                row["kills" if sweeper.signal(number) else "late"] += 1
                # Mostly the other one is killed as well, so that the store is left unfinished.
                if rng.random() > 0.8:
                    break
            ends = [sweeper.rest() for sweeper in pair]
            row["computed"] += sum(len(tiles) for tiles, _, _ in ends)
            if any(finished for _, finished, _ in ends):
                found = contents(place)
                row["stores"] += 1
                row["needed"] += TILES
                row["other_bytes"] += found != expected
                row["other_files"] += sorted({file for file, _ in found.items() ^ expected.items()})
                row["left_behind"] += len(list(Path(room).iterdir())) - 1
                shutil.rmtree(place)
    return row | {"seconds": time.perf_counter() - begun}


def full_disk(expected: dict[str, bytes]) -> Row:
    """Sweep into a file system that is too small, then resume in a larger one."""
    with tempfile.TemporaryDirectory() as room:
        mount: Any = ["mount", "-t", "tmpfs", "tmpfs", room, "-o"]
        if subprocess.run([*mount, "size=400k"], capture_output=True, check=False).returncode:
            return {"mounted": False}
        try:
            place = Path(room) / "s.zarr"
            _, _, errors = Sweeper(place, TILES).rest()
            said = errors.strip().splitlines()[-1].replace(room, "")
            kept = len(list((place / "dipoletop-tiles/done/c").iterdir()))
            subprocess.run([*mount, "remount,size=50m"], check=True, capture_output=True)
            tiles, _, _ = Sweeper(place, TILES).rest()
            same = contents(place) == expected
        finally:
            subprocess.run(["umount", room], check=False, capture_output=True)
    row = {"mounted": True, "said": said, "kept": kept, "same_bytes": same}
    return row | {"computed_again": len(tiles) - (TILES - kept)}


def soak(tiles: int) -> Row:
    """Measure memory and open files of a process while it computes many tiles."""
    with tempfile.TemporaryDirectory() as room:
        sweeper = Sweeper(Path(room) / "s.zarr", tiles)
        begun, seen, about = time.perf_counter(), [], Path(f"/proc/{sweeper.pid}")
        for count, _ in enumerate(sweeper.output, 1):
            if count % (tiles // 10) == 0:
                pages_used = int((about / "statm").read_text().split()[1])
                memory = pages_used * os.sysconf("SC_PAGE_SIZE") / 1e6
                files = len(list((about / "fd").iterdir()))
                seen.append({"tiles": count, "megabytes": memory, "files": files})
        sweeper.rest()
    return {"tiles": tiles, "seen": seen, "seconds": time.perf_counter() - begun}


def check(results: Row) -> None:
    """Fail if anything differs from what an undisturbed sweep leaves and says."""
    faults = [] if results["full_disk"].get("same_bytes", True) else ["full disk"]
    for part in ("killed", "cluster"):
        for row in results[part]:
            for key in ("other_bytes", "left_behind", "other_errors"):
                faults += [f"{part}: {row}"] if row.get(key) else []
    if faults:
        raise SystemExit("Stores or errors were not as they must be: " + "; ".join(faults))


def measured(small: bool) -> Row:
    """All of it; whatever forks this process is done before JAX runs in it."""
    rng, results = random.Random(0), {"tiles": TILES}
    with tempfile.TemporaryDirectory() as room:
        place = Path(room) / "s.zarr"
        _, clocks = measure.timed(lambda: Sweeper(place, TILES).rest())
        expected, length = contents(place), clocks["seconds"]
    results["killed"] = [
        killed(name, 1 if small else kills, rng, expected, length) for name, kills in KILLS.items()
    ]
    results |= {"full_disk": full_disk(expected), "soak": soak(100 if small else 10_000)}
    results["cluster"] = [
        fault_cluster.killed(kind, 1 if small else kills, rng) for kind, kills in CLUSTER.items()
    ]
    return results


if __name__ == "__main__":
    pages.command("faults", measured, check=check)
