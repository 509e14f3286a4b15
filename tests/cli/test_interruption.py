"""How `dipoletop map` ends when it is stopped, and that the command it prints goes on."""

import os
import shlex
import signal
import subprocess
import sys
import time

import pytest

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
MAP = ["map", "--level", "order-1", "--size", "48", "--quiet"]
TILES = 5


def started(*arguments, pause=0.0, patience=10.0, **settings):
    """A map in another process, whose tiles take some time."""
    script = SCRIPT.format(pause=pause, patience=patience)
    command = [sys.executable, "-c", script, *MAP, *(str(x) for x in arguments)]
    environment = {**os.environ, "DIPOLETOP_CACHE": "off", **settings}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, **pipes, text=True, errors="replace", env=environment)


def rest(process):
    """What a process prints until its end, to both streams."""
    out, err = process.stdout.read(), process.stderr.read()
    process.stdout.close()
    process.stderr.close()
    process.wait(timeout=60)
    return out, err


def files(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


@pytest.fixture(autouse=True)
def hangups_count():
    """Processes inherit what is ignored; the tests themselves may run under `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    process = started("--output", folder / "m")
    _, err = rest(process)
    assert process.returncode == 0, err
    return files(folder / "m-order-1.zarr")


@pytest.mark.system
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)],
)
def test_a_stopped_map_tells_how_to_go_on(tmp_path, undisturbed, number, status):
    process = started("--output", tmp_path / "m", pause=1.0)
    assert process.stderr.readline() == "computed\n"
    process.send_signal(number)
    out, err = rest(process)
    assert process.returncode == status
    assert "Picture" not in out
    *_, said, command = err.splitlines()
    assert said == "Stopped: finished tiles are kept, and this goes on from there:"
    name, *arguments = shlex.split(command)
    assert name == "dipoletop"
    assert arguments == [*MAP, "--output", str(tmp_path / "m")]
    kept = list((tmp_path / "m-order-1.zarr/dipoletop-tiles/done/c").iterdir())
    assert kept
    again = started(*arguments[len(MAP) :])
    out, err = rest(again)
    assert again.returncode == 0, err
    starts = sum(480 if int(k.name) < 4 else 384 for k in kept)
    assert f"{starts} starts found in the store" in out
    assert files(tmp_path / "m-order-1.zarr") == undisturbed


@pytest.mark.system
def test_a_tile_that_takes_too_long_is_not_waited_for(tmp_path):
    process = started("--output", tmp_path / "m", pause=600, patience=0.5)
    process.stderr.readline()
    process.terminate()
    began = time.monotonic()
    rest(process)
    assert process.returncode == 143
    assert time.monotonic() - began < 60


@pytest.mark.system
def test_a_map_stops_when_its_time_is_up(tmp_path, undisturbed):
    process = started("--output", tmp_path / "m", "--time-limit", "15s", pause=20)
    _, err = rest(process)
    assert process.returncode == 124
    assert "The time is up: finished tiles are kept, and this goes on from there:" in err
    rest(started("--output", tmp_path / "m"))
    assert files(tmp_path / "m-order-1.zarr") == undisturbed


@pytest.mark.system
def test_a_signal_that_is_ignored_stays_so(tmp_path):
    """As under `nohup`."""
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = started("--output", tmp_path / "m", pause=0.2)
    finally:
        signal.signal(signal.SIGHUP, ignored)
    process.stderr.readline()
    process.send_signal(signal.SIGHUP)
    out, _ = rest(process)
    assert process.returncode == 0
    assert "Picture: " in out


@pytest.mark.system
def test_a_closed_pipe_and_a_poor_terminal_stop_no_map(tmp_path):
    process = started("--output", tmp_path / "m", pause=0.2, PYTHONIOENCODING="latin-1")
    first = process.stdout.readline()
    process.stdout.close()
    err = process.stderr.read()
    process.wait(timeout=60)
    process.stderr.close()
    assert process.returncode == 0
    assert "starts: ? from 0 to ?" in first  # φ and π, which latin-1 lacks
    assert err == TILES * "computed\n"
    assert (tmp_path / "m.png").stat().st_size > 10_000
