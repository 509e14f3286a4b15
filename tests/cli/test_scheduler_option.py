"""`dipoletop map --scheduler`: what is wrong with a cluster is told in one sentence, and soon."""

import re
import socket

import pytest
from command_line import refusal

import dipoletop as dt
from dask_processes import DIPOLETOP, SCHEDULER, Processes
from dipoletop.cli import map_command

MAP = ["map", "--level", "order-1", "--size", "8", "--quiet"]
# Run by a worker before it starts.
WITHOUT_DIPOLETOP = """
import importlib.metadata as metadata
def version(name, version=metadata.version):
    if name == "dipoletop":
        raise metadata.PackageNotFoundError(name)
    return version(name)
metadata.version = version
"""
OTHER_PROGRAMS = """
import importlib.metadata
from dipoletop._maps import cluster, problems
cluster.versions_here = lambda here=cluster.versions_here(): (
    {**here, "dipoletop": "0.0.1"}
)
problems.BlockBuilder.program_digests = lambda blocks: {"problem": bytes(32)}
"""
OTHER_PYTHON = """
from types import SimpleNamespace
from dipoletop._maps import cluster
cluster.sys = SimpleNamespace(version_info=(3, 99, 0))
cluster.platform = SimpleNamespace(python_version=lambda: "3.99.0", node=lambda: "n1")
"""
OTHER_FOLDERS = """
from pathlib import Path
Path.is_dir = lambda path, is_dir=Path.is_dir: path.suffix != ".zarr" and is_dir(path)
"""


@pytest.fixture
def processes(tmp_path):
    with Processes(tmp_path) as processes:
        yield processes


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
    monkeypatch.setattr(map_command, "CONNECT", 0.5)
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
def test_a_scheduler_without_workers_is_waited_for_no_longer_than_told(
    tmp_path, monkeypatch, processes
):
    monkeypatch.setattr(map_command, "JOIN", 0.5)
    _, address = processes.scheduler()
    assert said(tmp_path, address) == (f"--scheduler {address}: no worker has answered in 0.5 s.")


def of_worker(tmp_path, processes, preload):
    """The sentence with which a map is refused, in a process without the type checks of tests."""
    _, address = processes.scheduler()
    processes.worker(address, preload=preload)
    where = "--output", tmp_path / "m", "--scheduler", address
    process = processes.start([*DIPOLETOP, *MAP, *where])
    assert process.status() == 2, process.said
    (line,) = [line for line in process.said.splitlines() if line.startswith("Error: ")]
    assert "Traceback" not in process.said
    return line.removeprefix("Error: ")


LACKS = "--scheduler must have a scheduler and workers with dipoletop, but the {} is without it."


@pytest.mark.system
def test_a_scheduler_without_dipoletop_is_refused(tmp_path, processes):
    (tmp_path / "without.py").write_text(WITHOUT_DIPOLETOP)
    command = [*SCHEDULER, "--port", "0", "--preload", tmp_path / "without.py"]
    _, address = processes.scheduler(command)
    assert said(tmp_path, address) == LACKS.format("scheduler")


@pytest.mark.system
def test_a_worker_without_dipoletop_is_refused(tmp_path, processes):
    line = of_worker(tmp_path, processes, WITHOUT_DIPOLETOP)
    assert line == LACKS.format("worker that has answered")


@pytest.mark.system
@pytest.mark.parametrize(
    ("preload", "pattern"),
    [
        (
            OTHER_PROGRAMS,
            r"--scheduler must have workers that compute this very sweep, but the one on \S+ does "
            rf"not \(it has dipoletop 0\.0\.1, not {re.escape(dt.__version__)}\): .*m-order-1.zarr "
            r"holds another sweep: the program of `problem` is .*\.",
        ),
        (
            OTHER_PYTHON,
            r"--scheduler must have workers with Python 3\.\d+\.\d+, as its process has, but the "
            r"one on \S+ has Python 3\.99\.0\.",
        ),
        (
            OTHER_FOLDERS,
            r"--output must be a path that all workers see, but is \S+m-order-1.zarr, where the "
            r"worker on \S+ finds nothing\.",
        ),
    ],
)
def test_a_worker_that_is_another_one_is_refused(tmp_path, processes, preload, pattern):
    line = of_worker(tmp_path, processes, preload)
    assert re.fullmatch(pattern, line), line
