"""`dipoletop map --scheduler`: what is wrong with a cluster is told in one sentence, and soon."""

import re
import socket

import pytest

import dipoletop as dt
from command_line import refusal
from dask_processes import DIPOLETOP, SCHEDULER, Processes
from dipoletop.cli import map_run

MAP = ["map", "--level", "order-1", "--size", "8", "--quiet"]
# Run by a scheduler or a worker before it starts: what is wrong with it is in a file.
WITHOUT_DIPOLETOP = """
import importlib.metadata
from pathlib import Path
def wrong(*names):
    return Path({file!r}).read_text() in names
def version(name, version=importlib.metadata.version):
    if name == "dipoletop" and wrong({me!r}):
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
version.__module__ = "importlib.metadata"  # where a process that is sent it finds its own
importlib.metadata.version = version
"""
ANOTHER_WORKER = """
from dipoletop._maps import cluster, problems
class Other:
    def __init__(self, module, **others):
        self.module, self.others = module, others
    def __getattr__(self, name):
        others = self.others if wrong("Python") else {}
        return others[name] if name in others else getattr(self.module, name)
cluster.sys = Other(cluster.sys, version_info=(3, 99, 0))
cluster.platform = Other(cluster.platform, python_version=lambda: "3.99.0")
cluster.versions_here = lambda here=cluster.versions_here: (
    here() | ({"dipoletop": "0.0.1"} if wrong("programs") else {})
)
problems.BlockBuilder.program_digests = (
    lambda blocks, digests=problems.BlockBuilder.program_digests: (
        {"problem": bytes(32)} if wrong("programs") else digests(blocks)
    )
)
Path.is_dir = lambda path, is_dir=Path.is_dir: (
    not (wrong("folders") and path.suffix == ".zarr") and is_dir(path)
)
"""
WRONG = {
    "programs": r"--scheduler must have workers that compute this very sweep, but the one on \S+ "
    rf"does not \(it has dipoletop 0\.0\.1, not {re.escape(dt.__version__)}\): .*m-order-1.zarr "
    r"holds another sweep: the program of `problem` is .*\.",
    "Python": r"--scheduler must have workers with Python 3\.\d+\.\d+, as its process has, but the "
    r"one on \S+ has Python 3\.99\.0\.",
    "folders": r"--output must be a path that all workers see, but is \S+m-order-1.zarr, where the "
    r"worker on \S+ finds nothing\.",
}
"""Refusals by what is wrong with a worker."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with a worker, and the file that tells what is wrong with them."""
    folder = tmp_path_factory.mktemp("cluster")
    file, preload = folder / "wrong", folder / "scheduler.py"
    file.touch()
    preload.write_text(WITHOUT_DIPOLETOP.format(file=str(file), me="scheduler"))
    code = WITHOUT_DIPOLETOP.format(file=str(file), me="worker") + ANOTHER_WORKER
    with Processes(folder) as processes:
        _, address = processes.scheduler([*SCHEDULER, "--port", "0", "--preload", preload])
        processes.worker(address, preload=code)
        yield address, file


def said(tmp_path, address, *options):
    """The sentence with which the map is refused."""
    line = refusal(*MAP, "--output", tmp_path / "m", "--scheduler", address, *options)
    assert line.endswith(".")
    return line


@pytest.mark.parametrize(
    "address", ["localhost", "foo://localhost:8786", "tcp://localhost:port", "a:b:c"]
)
def test_what_is_no_address_is_refused(tmp_path, address):
    line = said(tmp_path, address)
    assert line.startswith(f"--scheduler {address}: it is no address such as tcp://host:8786 (")


def test_a_scheduler_that_does_not_answer_is_waited_for_no_longer_than_told(tmp_path, monkeypatch):
    """One port that is closed, one of a server that is silent, and a host that is unknown."""
    monkeypatch.setattr(map_run, "CONNECT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        for address in (f"tcp://127.0.0.1:{port}", "tcp://no-such-host.invalid:8786"):
            line = said(tmp_path, address)
            assert line == f"--scheduler {address}: no Dask scheduler answers there within 0.5 s."
    assert "no Dask scheduler answers" in said(tmp_path, f"tcp://127.0.0.1:{port}")


def test_a_map_without_a_store_is_refused_before_anything_is_asked(tmp_path):
    line = said(tmp_path, "tcp://127.0.0.1:1", "--no-store")
    assert line == "--scheduler needs a store, which its workers write: leave --no-store out."


@pytest.mark.system
def test_a_scheduler_without_workers_is_waited_for_no_longer_than_told(tmp_path, monkeypatch):
    monkeypatch.setattr(map_run, "JOIN", 0.5)
    with Processes(tmp_path) as processes:
        _, address = processes.scheduler()
        assert said(tmp_path, address) == f"--scheduler {address}: no worker has answered in 0.5 s."


@pytest.mark.system
@pytest.mark.parametrize("what", ["scheduler", "worker"])
def test_a_cluster_without_dipoletop_is_refused(tmp_path, cluster, what):
    address, file = cluster
    file.write_text(what)
    who = {"scheduler": "scheduler", "worker": "worker that has answered"}[what]
    assert said(tmp_path, address) == (
        "--scheduler must have a scheduler and workers with dipoletop, but the "
        f"{who} is without it."
    )


@pytest.mark.system
@pytest.mark.parametrize("what", WRONG)
def test_a_worker_that_is_another_one_is_refused(tmp_path, cluster, what):
    """In a process without the type checks of tests."""
    address, file = cluster
    file.write_text(what)
    with Processes(tmp_path) as processes:
        where = "--output", tmp_path / "m", "--scheduler", address
        process = processes.start([*DIPOLETOP, *MAP, *where])
        assert process.status() == 2, process.said
    (line,) = [line for line in process.said.splitlines() if line.startswith("Error: ")]
    assert "Traceback" not in process.said
    assert re.fullmatch(f"Error: {WRONG[what]}", line), line
