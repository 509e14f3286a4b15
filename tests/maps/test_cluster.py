"""Sweeps on a Dask cluster of two processes, which are killed: the bytes of a sweep alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import dipoletop as dt
from stored_files import files


@pytest.mark.system
def test_a_cluster_computes_what_one_process_does(tmp_path):
    script = Path(__file__).with_name("cluster_sweeps.py")
    # On a busy machine a tile may see more workers close than Dask allows.
    patient = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "20"}
    settings = {**os.environ, "DIPOLETOP_CACHE": "off", **patient}
    run = subprocess.run(
        [sys.executable, str(script), str(tmp_path)],
        capture_output=True,
        text=True,
        env=settings,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout.splitlines()[-1])
    assert [said[name] for name in ("large", "again", "counts", "killed")] == [True] * 4
    assert files(tmp_path / "killed.zarr") == files(tmp_path / "alone.zarr")
    assert "rtol is 1e-08 there and 1e-09 here" in said["another"]
    assert said["joined"] == [0, 4, 6]  # as for one thread, then all tiles
    assert said["closed"] == "Argument `client` must be connected to a scheduler, but is closed."
    assert said["no store"] == (
        "Argument `store` must be a path that all workers see, with a `client`, but is None."
    )


def test_what_is_no_client_is_refused():
    with pytest.raises(ValueError, match=r"`client` must be a distributed.Client, or None, but is"):
        dt.sweep(
            lambda w3: (dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, 0.1)),
            dt.Grid(w3=[0.1]),
            client="tcp://localhost:8786",
        )
