"""How `dipoletop map` ends when it is stopped, and that the command it prints goes on."""

import os
import shlex
import signal
import subprocess
import sys

import pytest

from stored_files import files

SCRIPT = """
import os, sys, time
from dipoletop._maps import sweep_plan, sweep_stores
from dipoletop.cli import main
compute = sweep_plan.Plan.compute
def slowly(plan, tiles, device):
    found = compute(plan, tiles, device)
    os.write(2, b"computed\\n")
    time.sleep({pause})
    return found
sweep_plan.Plan.compute = slowly
sweep_stores.ZarrStore.patience = {patience}
main()
"""
MAP = ["map", "--level", "order-1", "--size", "64", "--quiet"]
TILES, STARTS = 8, 512  # of a map, of a tile
KEEPS_NONE = {"pause": 600.0, "patience": 0.5}  # a tile that takes too long is not waited for
STOPS = [
    (signal.SIGTERM, 143, KEEPS_NONE),
    (signal.SIGHUP, 129, {"pause": 1.0}),
    (signal.SIGINT, 130, {"pause": 1.0}),
]
GOES_ON = "finished tiles are kept, and this goes on from there:"


def started(folder, *options, pause=0.0, patience=10.0, **settings):
    """A map in another process, whose tiles take some time."""
    script = SCRIPT.format(pause=pause, patience=patience)
    command = [sys.executable, "-c", script, *MAP, "--output", str(folder / "m"), *options]
    environment = {**os.environ, "DIPOLETOP_CACHE": "off", **settings}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, **pipes, text=True, errors="replace", env=environment)


def rest(process):
    """What a process prints until its end, to both streams."""
    with process.stdout, process.stderr:
        out, err = process.stdout.read(), process.stderr.read()
    process.wait(timeout=180)
    return out, err


@pytest.fixture(scope="module", autouse=True)
def hangups_count():
    """Processes inherit what is ignored; the tests themselves may run under `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(scope="module")
def unstopped(tmp_path_factory):
    """The folder of a whole map, whose first line was read; what it printed; its exit status."""
    folder = tmp_path_factory.mktemp("map")
    listened = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = started(folder, pause=0.2, PYTHONIOENCODING="latin-1")
    finally:
        signal.signal(signal.SIGHUP, listened)
    first = process.stdout.readline()
    process.stdout.close()
    err = process.stderr.readline()
    process.send_signal(signal.SIGHUP)
    with process.stderr:
        err += process.stderr.read()
    return folder, first, err, process.wait(timeout=180)


@pytest.mark.system
def test_an_ignored_signal_a_closed_pipe_and_a_poor_terminal_stop_no_map(unstopped):
    """A signal is ignored under `nohup`."""
    folder, first, err, status = unstopped
    assert status == 0
    assert "starts: ? from 0 to ?" in first  # φ and π, which latin-1 lacks
    assert err == TILES * "computed\n"
    assert (folder / "m.png").stat().st_size > 10_000


@pytest.mark.system
def test_a_stopped_map_tells_how_to_go_on(tmp_path, unstopped):
    """By three signals, by its time limit; in the end it is that which was not stopped."""
    records, kept = tmp_path / "m-order-1.zarr/dipoletop-tiles/done/c", set()
    for number, status, slow in STOPS:
        process = started(tmp_path, **slow)
        assert process.stderr.readline() == "computed\n"
        process.send_signal(number)
        out, err = rest(process)
        assert process.returncode == status
        assert "Picture" not in out
        *_, said, command = err.splitlines()
        assert said == f"Stopped: {GOES_ON}"
        assert shlex.split(command) == ["dipoletop", *MAP, "--output", str(tmp_path / "m")]
        before, kept = kept, {record.name for record in records.glob("*")}
        assert kept == before if slow is KEEPS_NONE else kept > before
    process = started(tmp_path, "--time-limit", "6s", pause=60, patience=0.5)
    _, err = rest(process)
    assert process.returncode == 124
    assert f"The time is up: {GOES_ON}" in err
    process = started(tmp_path)
    out, err = rest(process)
    assert process.returncode == 0, err
    assert f"{STARTS * len(kept)} starts found in the store" in out
    assert files(tmp_path / "m-order-1.zarr") == files(unstopped[0] / "m-order-1.zarr")
