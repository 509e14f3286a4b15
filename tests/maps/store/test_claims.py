"""Several processes at one store: each tile is computed once, whoever is killed or waits."""

import errno
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from store_helpers import GRID, RECORDS, numbers, reduced

import dipoletop as dt
from dipoletop._maps import unfinished_tiles
from dipoletop._maps.store.claims import Claims
from dipoletop._maps.store.folders import LOCK
from dipoletop._maps.store.tiles import Tiles
from stored_files import files

HERE = Path(__file__).parent
SCRIPT = """
import jax, os, sys
import time
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, {here!r})
import dipoletop as dt
from dipoletop._maps import tiling, sweep_plan
from store_helpers import reduced
import numpy as np
tiling.TILE = 128
compute = sweep_plan.Plan.compute
def slowly(plan, tiles, device):
    found = compute(plan, tiles, device)
    os.write(1, f"{{tiles[0]}}\\n".encode())
    time.sleep({pause})
    while os.path.exists({wait!r}):
        time.sleep(0.02)
    return found
sweep_plan.Plan.compute = slowly
grid = dt.Grid(w3=np.linspace(0.0, 0.45, 40), phi=np.linspace(0.0, 3.0, 64))
dt.sweep(reduced, grid, store={place!r})
os.write(1, b"done")
"""
TILES = 20  # two rows each


def process(place, pause=0.1, wait=""):
    """A process that sweeps into a store, and prints the tiles that it has computed.

    It keeps each tile in hand for `pause` seconds, and as long as the file `wait` exists.
    """
    script = SCRIPT.format(here=str(HERE), place=str(place), pause=pause, wait=str(wait))
    settings = {**os.environ, "DIPOLETOP_CACHE": "off"}
    command = [sys.executable, "-c", script]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=settings)


def rest(one):
    """The lines that a process prints until its end; `communicate` loses what is read ahead."""
    lines = one.stdout.read().splitlines()
    one.stdout.close()
    one.wait(timeout=300)
    return lines


def computed(output):
    return [int(word) for line in output for word in line.split() if word.isdigit()]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    place = tmp_path_factory.mktemp("undisturbed") / "s.zarr"
    assert sorted(computed(rest(process(place, pause=0)))) == list(range(TILES))
    return files(place)


@pytest.mark.system
def test_two_processes_share_the_tiles_of_a_store(tmp_path, undisturbed):
    """Each has a tile in hand before the other goes on; each tile is computed by one of them."""
    place, wait = tmp_path / "s.zarr", tmp_path / "wait"
    wait.touch()
    both = [process(place, wait=wait) for _ in range(2)]
    begun = [one.stdout.readline() for one in both]
    wait.unlink()
    outputs = [rest(one) for one in both]
    assert all(output[-1] == "done" for output in outputs)
    assert sorted(n for output in [begun, *outputs] for n in computed(output)) == list(range(TILES))
    assert files(place) == undisturbed


@pytest.mark.system
def test_the_tiles_of_a_killed_process_are_computed_by_the_other(tmp_path, undisturbed):
    place = tmp_path / "s.zarr"
    doomed = process(place, pause=60)
    assert doomed.stdout.readline()  # its first tile, which it has not written yet
    other = process(place, pause=0.3)
    other.stdout.readline()
    doomed.kill()
    rest(doomed)
    partial = place / "dipoletop-tiles/partial"
    partial.mkdir(exist_ok=True)
    (partial / ".0.12.partial").write_bytes(b"what it was writing")
    assert rest(other)[-1] == "done"
    assert files(place) == undisturbed
    assert [path.name for path in tmp_path.iterdir()] == ["s.zarr"]


def test_a_hidden_folder_of_a_dead_process_is_removed(tmp_path):
    """Of one that was making a store. The number of a process says nothing of another container."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    hidden = tmp_path / f".dipoletop-{os.uname().nodename[:60]}-{gone.pid}-abc"
    alive = hidden.with_name(hidden.name + "d")
    for folder in (hidden, alive):
        folder.mkdir()
        (folder / LOCK).touch()
    code = f"import fcntl; f = open({str(alive / LOCK)!r}, 'r+b'); fcntl.flock(f, fcntl.LOCK_EX)"
    locked = [sys.executable, "-c", f"{code}; print('ready', flush=True); input()"]
    with subprocess.Popen(locked, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=tmp_path / "another.zarr")
        assert alive.exists()
        assert not hidden.exists()
        other.communicate(b"\n")
    dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=tmp_path / "another.zarr")
    assert not alive.exists()  # a sweep that finds its store looks as well


def test_tiles_that_others_keep_for_long_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(unfinished_tiles, "PATIENCE", 0.1)
    place, claim = tmp_path / "s.zarr", Claims.take
    refused = iter([False] * 5)
    monkeypatch.setattr(Claims, "take", lambda *args: next(refused, True) and claim(*args))
    with pytest.warns(UserWarning, match=f"Waiting for tiles 0, 1 of {place}, which another"):
        dt.sweep(reduced, GRID, store=place)


@pytest.mark.system
def test_an_interrupted_sweep_keeps_the_tiles_in_hand(tmp_path, undisturbed):
    """Ctrl-C comes while a worker has a tile: it is written before the process ends."""
    place = tmp_path / "s.zarr"
    one = process(place, pause=0.5)
    in_hand = int(one.stdout.readline().split()[0])
    time.sleep(0.1)
    one.send_signal(signal.SIGINT)
    begun = {in_hand, *computed(rest(one))}
    kept = {int(path.name) for path in (place / RECORDS / "c").iterdir()}
    assert kept == begun
    assert len(kept) < TILES
    partial = place / "dipoletop-tiles/partial"
    partial.mkdir(exist_ok=True)
    (partial / ".0.12.partial").write_bytes(b"torn")  # as a killed process would leave it
    assert sorted([*computed(rest(process(place, pause=0))), *kept]) == list(range(TILES))
    assert files(place) == undisturbed


def test_a_second_sweep_of_this_process_is_refused(tmp_path):
    place = tmp_path / "s.zarr"
    dt.sweep(reduced, GRID, store=place)
    claims = Claims(place, place / "dipoletop-tiles/claims")
    with pytest.raises(dt.StoreMismatch, match="`store` must be used by one sweep of a process at"):
        dt.sweep(reduced, GRID, store=place)
    claims.close()
    dt.sweep(reduced, GRID, store=place)


@pytest.mark.system
def test_claims_of_one_process_are_seen_by_another(tmp_path):
    file = tmp_path / "claims"
    claims = Claims(tmp_path, file)
    assert claims.take(3)
    script = (
        "import sys; from pathlib import Path; from dipoletop._maps.store.claims import Claims\n"
        "claims = Claims(Path(), Path(sys.argv[1]))\n"
        "with claims.everything() as alone: print(alone, claims.take(2), claims.take(3))\n"
    )
    command = [sys.executable, "-c", script, str(file)]
    seen = subprocess.run(command, capture_output=True, text=True, check=True)
    assert seen.stdout.split() == ["False", "True", "False"]
    claims.give_back(3)
    seen = subprocess.run(command, capture_output=True, text=True, check=True)
    assert seen.stdout.split() == ["True", "True", "True"]
    claims.close()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_finished_store_that_may_only_be_read_is_read(tmp_path):
    place = tmp_path / "s.zarr"
    basin = dt.sweep(reduced, GRID, store=place)
    for path in sorted(place.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    assert numbers(dt.sweep(reduced, GRID, store=place)) == numbers(basin)


def test_a_full_disk_is_told_with_what_is_kept(tmp_path, monkeypatch):
    place, write = tmp_path / "s.zarr", Tiles.write

    def full(tiles, tile, *computed):
        if tile == 0:
            return write(tiles, tile, *computed)
        while not tiles.is_finished(0):
            time.sleep(0.01)
        raise OSError(28, "No space left on device", str(place))

    monkeypatch.setattr(Tiles, "write", full)
    said = r"s.zarr cannot be written \(No space left on device\); 1 of its 2 tiles are finished"
    with pytest.raises(dt.StoreNotWritable, match=said):
        dt.sweep(reduced, GRID, store=place)
    monkeypatch.undo()
    assert numbers(dt.sweep(reduced, GRID, store=place)) == numbers(dt.sweep(reduced, GRID))


def test_what_is_told_of_a_full_disk_survives_the_way_to_another_process():
    error = dt.StoreNotWritable(Path("s.zarr"), 1, 2, "No space left on device")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.path, again.tiles) == (str(error), error.path, 2)


@pytest.mark.parametrize(
    ("number", "granted"), [(errno.EACCES, False), (errno.EAGAIN, False), (errno.ENOLCK, True)]
)
def test_only_what_another_process_holds_is_not_granted(tmp_path, monkeypatch, number, granted):
    """Systems say so by one of two numbers; some network file systems have no locks.

    Without locks every claim is granted, and no partial file is taken for left behind.
    """

    def refused(*_):
        raise OSError(number, os.strerror(number))

    claims = Claims(tmp_path, tmp_path / "claims")
    monkeypatch.setattr("dipoletop._maps.store.claims.fcntl.lockf", refused)
    assert claims.take(3) == granted
    with claims.everything() as alone:
        assert not alone
    claims.close()
