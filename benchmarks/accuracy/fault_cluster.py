"""Sweeps on a Dask cluster whose workers and schedulers are killed during the sweeps."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks.accuracy import fault_sweep
from benchmarks.accuracy.fault_damage import contents
from benchmarks.reporting import measure

Row = dict[str, Any]
WORKERS, TILES, LONGEST = 3, 100, 120.0


class Cluster:
    """A scheduler and workers, a process each; `killed` replaces killed ones."""

    def __init__(self, room: Path) -> None:
        self.room, self.address = room, ""
        self.processes: dict[str, list[subprocess.Popen]] = {"scheduler": [], "worker": []}
        self.start()

    def start(self) -> None:
        """Start a scheduler and, once it answers, its workers."""
        place = self.room / "scheduler.json"
        place.unlink(missing_ok=True)
        self._run("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", place)
        while not (place.exists() and place.read_text().strip().endswith("}")):
            time.sleep(0.05)
        for _ in range(WORKERS):
            self.worker()

    def worker(self) -> None:
        """Start another worker."""
        scratch = ["--local-directory", self.room / "scratch"]
        options = ["--nworkers", "1", "--nthreads", "1", *scratch]
        self._run("worker", "--scheduler-file", self.room / "scheduler.json", *options)

    def _run(self, kind: str, *options: Any) -> None:
        line = [sys.executable, "-m", "dask", kind, "--no-dashboard", *map(str, options)]
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
            for _ in range(len(processes)):
                self.kill(kind, 0)


def killed(kind: str, kills: int, rng: random.Random, room: Path) -> Row:
    """Kill workers or schedulers at random moments of sweeps, and return the consequences."""
    place, alone = room / "s.zarr", room / "alone.zarr"
    begun = time.perf_counter()
    _swept(alone)
    expected, length = contents(alone), time.perf_counter() - begun
    shutil.rmtree(alone)
    row: Row = {"killed": kind, "kills": 0, "stores": 0, "other_bytes": 0, "other_errors": []}
    cluster = Cluster(room)
    try:
        said: list[str] = []
        while row["kills"] < kills or said != ["done"]:
            said = []
            sweep = threading.Thread(target=_sweep, args=(room, place, said))
            sweep.start()
            while sweep.is_alive() and row["kills"] < kills and not said:
                sweep.join(rng.uniform(0.5, 1.5) * length)
                if sweep.is_alive() and any(place.glob("dipoletop-tiles/done/c/*")):
                    row["kills"] += 1
                    if kind == "worker":
                        cluster.kill(kind, rng.randrange(WORKERS))
                        cluster.worker()
                    else:
                        cluster.close()
                        break
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
    """Sweep tiles of the usual size, which workers have, too."""
    import jax
    import numpy as np

    import dipoletop as dt
    from dipoletop._maps.tiling import TILE

    jax.config.update("jax_enable_x64", True)
    grid = dt.Grid(w3=np.linspace(0, 0.5, TILES), phi=np.arange(TILE) * np.pi / TILE)
    dt.sweep(fault_sweep.problem, grid, store=place, progress=False, **settings)


def _sweep(room: Path, place: Path, said: list[str]) -> None:
    """Sweep on the cluster, and add to `said` how it ended."""
    from distributed import Client

    client = Client(scheduler_file=str(room / "scheduler.json"))
    try:
        _swept(place, client=client)
        said.append("done")
    except Exception as error:  # its text is a result
        said.append(f"{type(error).__name__}: {error}")
    finally:
        with contextlib.suppress(Exception):  # a client may not close without its scheduler
            client.close()
