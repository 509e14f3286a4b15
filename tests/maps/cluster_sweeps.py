"""A script for `test_cluster`: sweeps on a scheduler with two worker processes on this machine.

Workers are started anew, not forked, so a script is run that they can import.
"""

import functools
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from unittest import mock

import jax
import numpy as np

import dipoletop as dt
from dipoletop._maps import cluster

GRID = dt.Grid(w3=np.linspace(0.0, 0.45, 40), phi=np.linspace(0.0, 3.0, 64))
POINTS = dt.Points(w3=np.linspace(0.0, 0.45, 90_000), phi=np.linspace(0.0, 3.0, 90_000))


def slow_tiles(seconds):
    """Run on a worker."""
    from dipoletop._maps import sweep_plan

    compute = sweep_plan.Plan.compute

    def slowly(plan, tiles, device):
        time.sleep(seconds)
        return compute(plan, tiles, device)

    sweep_plan.Plan.compute = slowly


def submitted_as_workers_join(problem, store, client):
    """How many tasks there are at each count of the workers, of which there are none at first."""
    submit, counts, count = client.submit, [], [0]

    def counting(*arguments, **settings):
        count[0] += arguments[0] is cluster.compute_tile
        return submit(*arguments, **settings)

    def nthreads():
        counts.append(count[0])
        return {"one": 100} if counts[1:] else {}

    with (
        mock.patch.object(cluster, "LOOK", 0.0),
        mock.patch.object(client, "submit", counting),
        mock.patch.object(client, "nthreads", nthreads),
    ):
        dt.sweep(problem, POINTS, store=store, client=client)
    return counts[:3]


def keep_working(local, client, done):
    """Start further workers if there have been none for 20 s.

    A nanny gives up a worker that starts too slowly, as on a busy machine.
    """
    empty = 0
    while not done.wait(1.0):
        empty = 0 if client.nthreads() else empty + 1
        if empty == 20:
            local.scale(4)


def main(folder):
    from distributed import Client, LocalCluster

    jax.config.update("jax_enable_x64", True)
    shape = -0.2

    def problem(w3, phi):
        return dt.TransverseReduced(shape), dt.cylindrical(0.2, w3, phi)

    def kill_both(client, store):
        """One at once, one gently, when the first tile is there."""
        first, second = client.run(os.getpid).values()
        while not list((store / "dipoletop-tiles/done").glob("c/*")):
            time.sleep(0.02)
        os.kill(first, signal.SIGKILL)
        time.sleep(0.3)
        os.kill(second, signal.SIGTERM)

    def refusal(**settings):
        try:
            dt.sweep(problem, GRID, client=client, **settings)
        except ValueError as error:
            return str(error)

    said = {}
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local,
        Client(local) as client,
    ):
        large = dt.sweep(problem, POINTS, store=folder / "large.zarr", client=client)
        said["large"] = large == dt.sweep(problem, POINTS)
        # The same sweep, written anew and not finished: workers have the store open already.
        for record in (folder / "large.zarr/dipoletop-tiles/done/c").glob("*/0"):
            record.unlink()
        again = functools.partial(problem)
        said["again"] = large == dt.sweep(again, POINTS, store=folder / "large.zarr", client=client)
        bins = {"histograms": {"time": np.geomspace(1.0, 100.0, 9)}}
        counts = dt.tally(problem, POINTS, store=folder / "counts.zarr", client=client, **bins)
        said["counts"] = counts == dt.tally(problem, POINTS, **bins)
        said["joined"] = submitted_as_workers_join(problem, folder / "joined.zarr", client)
        client.run(slow_tiles, 0.2)
        store = folder / "killed.zarr"
        done = threading.Event()
        killer = threading.Thread(target=kill_both, args=(client, store))
        keeper = threading.Thread(target=keep_working, args=(local, client, done))
        killer.start()
        keeper.start()
        killed = dt.sweep(problem, GRID, store=store, client=client)
        done.set()
        killer.join()
        keeper.join()
        said["killed"] = killed == dt.sweep(problem, GRID)
        alone = folder / "alone.zarr"
        dt.sweep(problem, GRID, store=alone)
        said["another"] = refusal(store=alone, rtol=1e-9)
        said["no store"] = refusal()
    said["closed"] = refusal(store=alone)
    print(json.dumps(said))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
