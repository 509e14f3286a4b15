"""Sweeps that are killed repeatedly, damaged stores, a full disk, many tiles.

    python -m benchmarks.accuracy.faults --small     a look
    python -m benchmarks.accuracy.faults             all, about ten minutes on two cores
    python -m benchmarks.accuracy.faults --write     the same, kept: results/faults.md

Two processes sweep into one store. One or, mostly, both are killed at random moments, and two new
ones resume, until the sweep is finished. Its bytes are compared with an undisturbed sweep; then the
next store begins. The full disk is a small file system in memory, if one can be mounted. Damages
are flipped bits and lost ends of random files. On a Dask cluster, workers and schedulers are
killed.
"""

import argparse
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
from benchmarks.accuracy.fault_damage import contents, damaged
from benchmarks.reporting import measure, pages

Row = dict[str, Any]
KILLS = {"SIGKILL": 200, "SIGTERM": 20, "SIGINT": 20}
DAMAGES, CLUSTER = 200, {"worker": 20, "scheduler": 5}
TILES, SOAK = 100, 10_000


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

    def until_ready(self) -> None:
        """Wait until it begins to sweep."""
        while (line := self.output.readline()) and line != b"ready\n":
            pass

    def signal(self, number: int) -> bool:
        """Send a signal; False if the process has ended already."""
        pid, _ = os.waitpid(self.pid, os.WNOHANG)
        self._ended = pid != 0
        if not self._ended:
            os.kill(self.pid, number)
        return not self._ended

    def rest(self) -> tuple[list[int], bool, str]:
        """Return the tiles that it computed, whether it finished, and its errors."""
        words, errors = self.output.read().split(), self._errors.read().decode()
        if not self._ended:
            os.waitpid(self.pid, 0)
        self.output.close()
        self._errors.close()
        return [int(word) for word in words if word.isdigit()], b"done" in words, errors


def undisturbed(place: Path, tiles: int) -> tuple[dict[str, bytes], float]:
    """Return the bytes of an undisturbed sweep, and its duration in seconds."""
    sweeper = Sweeper(place, tiles)
    sweeper.until_ready()
    begun = time.perf_counter()
    sweeper.rest()
    return contents(place), time.perf_counter() - begun


def killed(name: str, kills: int, rng: random.Random, right: tuple[dict[str, bytes], float]) -> Row:
    """Kill processes at a store by a signal at random moments, and return the consequences."""
    number, (expected, length) = getattr(signal, name), right
    row: Row = {"signal": name, "kills": 0, "late": 0, "stores": 0, "other_bytes": 0}
    row |= {"computed": 0, "needed": 0, "left_behind": 0, "other_files": []}
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as room:
        place = Path(room) / "s.zarr"
        while row["kills"] < kills:
            pair = [Sweeper(place, TILES) for _ in range(2)]
            for sweeper in pair:
                sweeper.until_ready()
            victim, other = pair if rng.random() < 0.5 else pair[::-1]
            time.sleep(rng.uniform(0, 0.7 * length))
            row["kills" if victim.signal(number) else "late"] += 1
            # Mostly the other process is killed as well, so that the store is left unfinished.
            if rng.random() < 0.8:
                time.sleep(rng.uniform(0, 0.1 * length))
                row["kills" if other.signal(number) else "late"] += 1
            ends = [sweeper.rest() for sweeper in pair]
            row["computed"] += sum(len(tiles) for tiles, _, _ in ends)
            if any(finished for _, finished, _ in ends):
                row["stores"] += 1
                row["needed"] += TILES
                found = contents(place)
                row["other_bytes"] += found != expected
                differ = found.items() ^ expected.items()
                row["other_files"] += sorted({file for file, _ in differ})
                row["left_behind"] += len(list(Path(room).iterdir())) - 1
                shutil.rmtree(place)
    return row | {"seconds": time.perf_counter() - begun}


def full_disk(expected: dict[str, bytes]) -> Row:
    """Sweep into a file system that is too small, then resume in a larger one."""
    with tempfile.TemporaryDirectory() as room:
        mount = ["mount", "-t", "tmpfs", "-o"]
        tried = subprocess.run(
            [*mount, "size=400k", "tmpfs", room], capture_output=True, check=False
        )
        if tried.returncode:
            return {"mounted": False}
        try:
            place = Path(room) / "s.zarr"
            _, finished, errors = Sweeper(place, TILES).rest()
            said = errors.strip().splitlines()[-1].replace(room, "")
            kept = len(list((place / "dipoletop-tiles/done/c").iterdir()))
            larger = [*mount, "remount,size=50m", "tmpfs", room]
            subprocess.run(larger, check=True, capture_output=True)
            tiles, done, _ = Sweeper(place, TILES).rest()
            same = contents(place) == expected
        finally:
            subprocess.run(["umount", room], check=False, capture_output=True)
    again = len(tiles) - (TILES - kept)
    row = {"mounted": True, "stopped": not finished, "said": said, "kept": kept}
    return row | {"went_on": done, "same_bytes": same, "computed_again": again}


def soak(tiles: int) -> Row:
    """Measure memory and open files of a process while it computes many tiles."""
    with tempfile.TemporaryDirectory() as room:
        sweeper = Sweeper(Path(room) / "s.zarr", tiles)
        sweeper.until_ready()
        begun, seen = time.perf_counter(), []
        for count, _ in enumerate(sweeper.output, 1):
            if count % (tiles // 10) == 0:
                status = Path(f"/proc/{sweeper.pid}/statm").read_text().split()
                memory = int(status[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
                files = len(list(Path(f"/proc/{sweeper.pid}/fd").iterdir()))
                seen.append({"tiles": count, "megabytes": memory, "files": files})
        sweeper.rest()
    return {"tiles": tiles, "seen": seen, "seconds": time.perf_counter() - begun}


def _faults(results: Row) -> list[str]:
    """Return all deviations from the results and messages of an undisturbed sweep."""
    faults, disk = [], results["full_disk"]
    for part, name in (("killed", "signal"), ("damaged", "harm"), ("cluster", "killed")):
        for row in results[part]:
            for key in ("other_bytes", "left_behind", "wrong", "other_errors"):
                if found := row.get(key):
                    faults.append(f"{part}, {row[name]}: {key} = {found}")
    if not disk.get("same_bytes", True):
        faults.append(f"full disk: {disk}")
    return faults


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="few kills: does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")
    with tempfile.TemporaryDirectory() as room:
        right = undisturbed(Path(room) / "s.zarr", TILES)
    rng = random.Random(args.seed)
    results: Row = {
        "command": measure.command(),
        "seed": args.seed,
        "tiles": TILES,
        "killed": [
            killed(name, 4 if args.small else kills, rng, right) for name, kills in KILLS.items()
        ],
        "full_disk": full_disk(right[0]),
        "soak": soak(500 if args.small else SOAK),
    }
    # From here on JAX runs in this process, so it is not forked any more.
    with tempfile.TemporaryDirectory() as room:
        trials = 5 if args.small else DAMAGES
        results["damaged"] = damaged(trials, rng, Path(room))
    results["cluster"] = []
    for kind, kills in CLUSTER.items():
        with tempfile.TemporaryDirectory() as room:
            found = fault_cluster.killed(kind, 1 if args.small else kills, rng, Path(room))
            results["cluster"].append(found)
    results |= measure.machine()
    pages.show("faults", results, keep=args.write)
    if faults := _faults(results):
        raise SystemExit("Stores or errors were not as they must be: " + "; ".join(faults))


if __name__ == "__main__":
    main()
