"""A cluster that loses its scheduler or its workers: what is told, kept and computed."""

import re
import signal
from pathlib import Path

import pytest

from dask_processes import DIPOLETOP, SCHEDULER, Hold, Processes, until
from stored_files import files

MAP = ["map", "--level", "order-1", "--size", "64", "--quiet"]
TILES = 8


@pytest.mark.system
def test_a_map_goes_on_after_its_scheduler_was_lost(tmp_path):
    """Twice, in two ways; each time with a new scheduler at the same address, and a new worker."""
    store, port, old = tmp_path / "m-order-1.zarr", "0", []
    hold = Hold(tmp_path, store, kept=2)
    with Processes(tmp_path) as processes:
        for number in (signal.SIGTERM, signal.SIGKILL):
            scheduler, address = processes.scheduler([*SCHEDULER, "--port", port])
            port = address.rpartition(":")[2]
            old.append(processes.worker(address, preload=hold.code))
            command = [*DIPOLETOP, *MAP, "--output", tmp_path / "m", "--scheduler", address]
            lost = processes.start(command)
            until(lambda: len(hold.holding()) == len(old), lost, *old)
            kept = hold.kept()
            assert len(kept) == 2
            scheduler.popen.send_signal(number)
            assert lost.status() == 2
            said = [line for line in lost.said.splitlines() if line.startswith("Error: ")]
            assert len(said) == 1
            assert re.fullmatch(
                rf"Error: The Dask scheduler {address} was lost, or lost its tasks \(.*\); "
                rf"2 of the {TILES} tiles of {store} are finished and kept, and the same sweep "
                r"goes on from there\.",
                said[0],
            )
            assert "Traceback" not in lost.said
            assert hold.kept() == kept
            scheduler.status()
        processes.scheduler([*SCHEDULER, "--port", port])
        new = processes.worker(address, preload=hold.code)
        again = processes.start(command)
        hold.release()
        assert again.status() == 0, again.said
        for worker in old:
            worker.status()  # it ends by itself
        assert new.popen.poll() is None
        assert [hold.begun().count(tile) for tile in kept] == [1] * len(kept)
        alone = processes.start([*DIPOLETOP, *MAP, "--output", tmp_path / "alone"])
        assert alone.status() == 0, alone.said
    assert files(store) == files(tmp_path / "alone-order-1.zarr")


@pytest.mark.system
def test_a_tile_that_kills_its_workers_ends_the_map(tmp_path):
    """As often as the setting that the page names."""
    deadly = "import os\nfrom dipoletop._maps import sweep_plan\n"
    deadly += "sweep_plan.Plan.compute = lambda *_: os._exit(1)\n"
    with Processes(tmp_path) as processes:
        setting = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
        _, address = processes.scheduler(**setting)
        processes.worker(address, preload=deadly)
        where = "--output", tmp_path / "m", "--scheduler", address
        process = processes.start([*DIPOLETOP, *MAP, *where])
        assert process.status() == 2
        assert process.said.splitlines()[1:] == [
            f"Error: The workers died 2 times with the same tile; 0 of the {TILES} tiles of "
            f"{tmp_path}/m-order-1.zarr are finished and kept, and the same sweep goes on from "
            "there."
        ]
    page = Path(__file__).parents[2] / "notebooks/clusters.md"
    assert next(iter(setting)) in page.read_text(encoding="utf-8")
