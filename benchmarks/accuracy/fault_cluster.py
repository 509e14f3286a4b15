"""Sweeps on a Dask cluster whose workers and schedulers are killed during the sweeps."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

import dipoletop as dt
from benchmarks.accuracy import fault_sweep
from benchmarks.accuracy.fault_sweep import contents
from benchmarks.reporting import measure
from dipoletop._maps.tiling import TILE

Row = dict[str, Any]
WORKERS, TILES, LONGEST = 3, 100, 120.0


class Cluster:
    """A scheduler and workers, a process each."""

    def __init__(self, room: Path) -> None:
        self.room, self.place = room, room / "scheduler.json"
        self.processes: dict[str, list[subprocess.Popen]] = {"scheduler": [], "worker": []}
        self.start()

    def start(self) -> None:
        """A scheduler, once it answers, and its workers."""
        self.place.unlink(missing_ok=True)
        self._run("scheduler", "--host", "127.0.0.1", "--port", "0")
        while not (self.place.exists() and self.place.read_text().strip().endswith("}")):
            time.sleep(0.05)
        for _ in range(WORKERS):
            self.worker()

    def worker(self) -> None:
        """One more worker."""
        scratch = str(self.room / "scratch")
        self._run("worker", "--nworkers", "1", "--nthreads", "1", "--local-directory", scratch)

    def _run(self, kind: str, *options: str) -> None:
        line = [sys.executable, "-m", "dask", kind, "--no-dashboard", *options]
        line += ["--scheduler-file", str(self.place)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        # A new session, since `kill` must also end the process that would restart a worker.
        run = subprocess.Popen(line, cwd=measure.ROOT, start_new_session=True, **quiet)
        self.processes[kind].append(run)

    def kill(self, kind: str, victim: int) -> None:
        """Send SIGKILL to a process and all its children."""
        process = self.processes[kind].pop(victim)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """Kill the remaining processes."""
        for kind, processes in self.processes.items():
            while processes:
                self.kill(kind, 0)


def killed(kind: str, kills: int, rng: random.Random) -> Row:
    """So many kills of workers, or of schedulers, at random moments of sweeps."""
    row: Row = {"killed": kind, "kills": 0, "stores": 0, "other_bytes": 0, "other_errors": []}
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder)
        place, alone = room / "s.zarr", room / "alone.zarr"
        _, clocks = measure.timed(_swept, alone)
        expected, length = contents(alone), clocks["seconds"]
        begun, cluster = time.perf_counter() - length, Cluster(room)
        try:
            said: list[str] = []
            while row["kills"] < kills or said != ["done"]:
                said = []
                sweep = threading.Thread(target=_sweep, args=(cluster.place, place, said))
                sweep.start()
                while sweep.is_alive() and row["kills"] < kills and not said:
                    sweep.join(rng.uniform(0.1, 1.0) * length)
                    if sweep.is_alive() and any(place.glob("dipoletop-tiles/done/c/*")):
                        row["kills"] += 1
                        if kind == "scheduler":
                            cluster.close()
                            break
                        cluster.kill(kind, rng.randrange(WORKERS))
                        cluster.worker()
                sweep.join(LONGEST)
                if not cluster.processes["scheduler"]:
                    cluster.start()
                if said == ["done"]:
                    row["stores"] += 1
                    row["other_bytes"] += contents(place) != expected
                    shutil.rmtree(place)
                elif kind == "worker" or not said or not said[0].startswith("ConnectionError"):
                    row["other_errors"] += said or ["the sweep hangs"]
                    break
        finally:
            cluster.close()
    return row | {"seconds": time.perf_counter() - begun}


def _swept(place: Path, **settings: Any) -> None:
    """A sweep of tiles of the usual size, which workers have, too."""
    grid = dt.Grid(w3=np.linspace(0, 0.5, TILES), phi=np.arange(TILE) * np.pi / TILE)
    dt.sweep(fault_sweep.problem, grid, store=place, progress=False, **settings)


def _sweep(scheduler: Path, place: Path, said: list[str]) -> None:
    """A sweep by the cluster, and how it ended."""
    from distributed import Client  # none of it shall be in the forks of `faults`

    client = Client(scheduler_file=str(scheduler))
    try:
        _swept(place, client=client)
        said.append("done")
    except Exception as error:  # its text is a result
        said.append(f"{type(error).__name__}: {error}")
    finally:
        with contextlib.suppress(Exception):  # a client may not close without its scheduler
            client.close()
