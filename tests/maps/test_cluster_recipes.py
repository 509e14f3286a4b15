"""The page `notebooks/clusters.md`: its scripts and manifests do what it says of them.

Slurm is played by shell scripts of the same names, Kubernetes by processes of this machine.
"""

import ast
import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from dask_processes import DASK, DIPOLETOP, Hold, Processes, until
from dipoletop.cli import main
from dipoletop.cli.options import DURATION
from stored_files import files

PAGE = Path(__file__).parents[2] / "notebooks/clusters.md"
TEXT = PAGE.read_text(encoding="utf-8")
SMALL = "32"  # starts on each axis, in place of the many of the page


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


TWO_PROCESSES, ARRAY = blocks("bash")
TALLY, SLURM = blocks("python")
MANIFEST = list(yaml.safe_load_all(blocks("yaml")[0]))


def executable(file, *lines):
    """A shell script in place of a program that is not here."""
    file.write_text("\n".join(["#!/bin/bash", *lines, ""]), encoding="utf-8")
    file.chmod(0o755)


def replaced(text, **others):
    """A text with other words, each of which it has."""
    for old, new in others.items():
        assert old in text
        text = text.replace(old, str(new))
    return text


def path_with(folder):
    """Settings with which the programs in a folder are found first."""
    return {"PATH": f"{folder}:{os.environ['PATH']}"}


def seconds(text):
    return DURATION.convert(text, None, None)


def parsed(arguments):
    """The options of `dipoletop map`, as the command line reads them."""
    name, *rest = arguments
    command = main.commands[name]
    return command.make_context(name, rest).params


def test_links_inside_the_page_lead_to_its_headings():
    headings = re.findall(r"^#+ (.*)$", TEXT, re.MULTILINE)
    anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings}
    assert set(re.findall(r"\]\(#([^)]+)\)", TEXT)) <= anchors


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The files of the map that one process makes."""
    folder = tmp_path_factory.mktemp("alone")
    with Processes(folder) as processes:
        words = "map", "--level", "semi", "--size", SMALL, "--output", folder / "map"
        process = processes.start([*DIPOLETOP, *words])
        assert process.status() == 0, process.said
    return files(folder / "map-semi.zarr")


# Processes at one store


@pytest.mark.parametrize("script", [TWO_PROCESSES, ARRAY])
def test_shell_scripts_are_valid(script):
    done = subprocess.run(["bash", "-n"], input=script, text=True, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("status", [0, 2, 124, 143])
def test_an_array_job_goes_back_to_the_queue_until_the_map_is_complete(tmp_path, status):
    """Programs that tell of their calls stand for Slurm, and for a map that ends with a status."""
    calls = tmp_path / "calls"
    executable(tmp_path / "srun", 'exec "$@"')
    executable(tmp_path / "scontrol", f'echo scontrol "$@" >> {calls}')
    executable(tmp_path / "dipoletop", f'echo dipoletop "$@" >> {calls}', f"exit {status}")
    environment = {**os.environ, **path_with(tmp_path), "SLURM_JOB_ID": "4711"}
    done = subprocess.run(["bash"], input=ARRAY, text=True, env=environment, check=False)
    assert done.returncode == status
    map_call, *others = (line.split() for line in calls.read_text().splitlines())
    again = [["scontrol", "requeue", "4711"]]
    assert others == (again if status in (124, 143) else [])
    options = parsed(map_call[1:])
    assert options["store"]
    (walltime,) = re.findall(r"^#SBATCH --time=(.*)$", ARRAY, re.MULTILINE)
    assert 60 <= seconds(walltime) - options["time_limit"] <= 900
    assert "#SBATCH --requeue\n" in ARRAY


@pytest.mark.system
def test_processes_at_one_store_make_the_map_of_one(tmp_path, alone):
    executable(tmp_path / "dipoletop", f'exec {DIPOLETOP[0]} -c "{DIPOLETOP[2]}" "$@"')
    script = replaced(TWO_PROCESSES, **{"/shared/map": tmp_path / "map", "2048": SMALL})
    with Processes(tmp_path) as processes:
        process = processes.start(["bash", "-c", script], **path_with(tmp_path))
        assert process.status() == 0, process.said
        assert "Traceback" not in process.said
    assert files(tmp_path / "map-semi.zarr") == alone


# Slurm


def slurm_arguments():
    """The arguments of `SLURMCluster` in the script; names stand for constants of the script."""
    tree = ast.parse(SLURM)
    constants = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
    }
    (call,) = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "SLURMCluster"
    )
    return {
        word.arg: constants[word.value.id]
        if isinstance(word.value, ast.Name)
        else ast.literal_eval(word.value)
        for word in call.keywords
    }


@pytest.mark.parametrize("cores", [1, 64])
def test_the_job_script_of_slurm_has_one_process_for_each_core(tmp_path, monkeypatch, cores):
    """With the arguments of the script, and with those that the page names for whole nodes."""
    from dask_jobqueue.slurm import SLURMJob

    monkeypatch.chdir(tmp_path)  # for the logs
    arguments = slurm_arguments()
    assert (arguments["cores"], arguments["processes"]) == (1, 1)
    assert "`cores=64, processes=64`" in TEXT
    arguments |= {"cores": cores, "processes": cores}
    # As `SLURMCluster.job_script` makes it, but nothing is started.
    script = SLURMJob("tcp://scheduler:8786", name="0", **arguments).job_script()
    done = subprocess.run(["bash", "-n"], input=script, text=True, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    lines = script.splitlines()
    for directive in ("-p regular", "-A myaccount", "-n 1", f"--cpus-per-task={cores}", "--mem=2G"):
        assert f"#SBATCH {directive}" in lines
    (walltime,) = (line.split()[-1] for line in lines if line.startswith("#SBATCH -t "))
    worker = lines[-1].split()
    options = dict(zip(worker, [*worker[1:], ""], strict=True))
    assert worker[:3] == [sys.executable, "-m", "distributed.cli.dask_worker"]
    assert options["--nthreads"] == "1"
    assert options.get("--nworkers", "1") == str(cores)
    longest = seconds(options["--lifetime"]) + seconds(options["--lifetime-stagger"])
    assert longest < seconds(walltime)
    prologue = [line for line in lines if line.startswith("export ")]
    assert "export NPROC=1" in prologue
    assert lines.index(prologue[-1]) < lines.index(lines[-1])


def slurm_scripts(folder):
    """The script of the page, with one small job, and without any cluster."""
    small = {"8192": SMALL, "/shared": folder}
    here = {"=200": "=1", '"/tmp"': f'"{folder}/scratch"', '"logs"': f'"{folder}/logs"'}
    body = SLURM.partition("    cluster = SLURMCluster(")
    alone = body[0] + "    grid = " + body[2].partition("    grid = ")[2]
    without = {"with cluster, Client(cluster) as client": "if True", ", client=client": ""}
    names = {"basin.zarr": "alone.zarr"}
    return replaced(SLURM, **small, **here), replaced(alone, **names, **small, **without)


@pytest.mark.system
def test_the_slurm_script_replaces_a_lost_job_and_computes_what_one_process_does(tmp_path):
    """Its jobs are run by scripts in place of `sbatch` and `scancel`."""
    hold = Hold(tmp_path, tmp_path / "basin.zarr", kept=2)
    jobs, preload = tmp_path / "jobs", tmp_path / "holding.py"
    jobs.touch()
    preload.write_text(hold.code, encoding="utf-8")
    kept = f"{tmp_path}/job-$$.sh"
    run = f"cp $1 {kept}; setsid bash {kept} > {tmp_path}/job-$$.log 2>&1 &"
    executable(tmp_path / "sbatch", run, f"echo $! >> {jobs}", 'echo "Submitted batch job $!"')
    executable(tmp_path / "scancel", 'kill -- "-$1"')
    settings = {
        **path_with(tmp_path),
        "DASK_JOBQUEUE__SLURM__SCHEDULER_OPTIONS": "{'host': '127.0.0.1', 'dashboard': False}",
        "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "0.1s",
        "DASK_DISTRIBUTED__WORKER__PRELOAD": f"['{preload}']",
    }
    scripts = tmp_path / "sweep.py", tmp_path / "alone.py"
    for file, code in zip(scripts, slurm_scripts(tmp_path), strict=True):
        file.write_text(code, encoding="utf-8")
    with Processes(tmp_path) as processes:
        processes.callback(kill_groups, jobs)
        sweep = processes.start([sys.executable, scripts[0]], **settings)
        until(hold.holding, sweep)
        kill_groups(jobs)
        hold.release()
        assert sweep.status() == 0, sweep.said
        assert len(jobs.read_text().split()) == 2
        alone = processes.start([sys.executable, scripts[1]])
        assert alone.status() == 0, alone.said
    assert sweep.said.splitlines()[-1] == alone.said.splitlines()[-1]
    assert files(tmp_path / "basin.zarr") == files(tmp_path / "alone.zarr")


def kill_groups(jobs):
    """End all jobs whose numbers are in a file, and all that they have started."""
    for job in jobs.read_text().split():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(job), signal.SIGKILL)


# Kubernetes


def named(kind, name):
    (found,) = (x for x in MANIFEST if (x["kind"], x["metadata"]["name"]) == (kind, name))
    return found


def pod(kind, name):
    return named(kind, name)["spec"]["template"]["spec"]


def container(kind, name):
    (only,) = pod(kind, name)["containers"]
    return only


SERVICE = named("Service", "dipoletop-scheduler")
SCHEDULER = container("Deployment", "dipoletop-scheduler")
WORKER = container("Deployment", "dipoletop-worker")
MAP = container("Job", "dipoletop-map")


def test_names_of_the_manifest_belong_together():
    labels = named("Deployment", "dipoletop-scheduler")["spec"]["template"]["metadata"]["labels"]
    assert SERVICE["spec"]["selector"].items() <= labels.items()
    for name in ("dipoletop-scheduler", "dipoletop-worker"):
        spec = named("Deployment", name)["spec"]
        assert spec["selector"]["matchLabels"] == spec["template"]["metadata"]["labels"]
    assert len({each["image"] for each in (SCHEDULER, WORKER, MAP)}) == 1
    versions = {x["kind"]: x["apiVersion"] for x in MANIFEST}
    assert versions == {
        "PersistentVolumeClaim": "v1",
        "Service": "v1",
        "Deployment": "apps/v1",
        "Job": "batch/v1",
    }


def test_ports_of_the_manifest_are_one():
    (port,) = SERVICE["spec"]["ports"]
    (own,) = SCHEDULER["ports"]
    command = SCHEDULER["command"]
    given = int(command[command.index("--port") + 1])
    address = f"tcp://{SERVICE['metadata']['name']}:{port['port']}"
    assert port["targetPort"] == own["containerPort"] == given
    assert SCHEDULER["readinessProbe"]["tcpSocket"]["port"] == given
    assert address in WORKER["command"]
    assert parsed(MAP["command"][1:])["scheduler"] == address


def test_workers_and_map_of_the_manifest_see_the_store_at_one_path():
    claim = named("PersistentVolumeClaim", "dipoletop-data")
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    mounts = []
    for kind, name in (("Deployment", "dipoletop-worker"), ("Job", "dipoletop-map")):
        (volume,), (mount,) = pod(kind, name)["volumes"], container(kind, name)["volumeMounts"]
        assert volume["name"] == mount["name"]
        assert volume["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
        mounts.append(mount["mountPath"])
    assert mounts[0] == mounts[1]
    options = parsed(MAP["command"][1:])
    assert Path(options["output"]).parent == Path(mounts[0])
    assert pod("Job", "dipoletop-map")["restartPolicy"] in ("OnFailure", "Never")


def run_here(command, **others):
    """The command of a container, as it runs here."""
    programs = {"dask": DASK, "dipoletop": DIPOLETOP}
    words = [replaced(word, **{x: y for x, y in others.items() if x in word}) for word in command]
    assert all(any(old in word for word in command) for old in others)
    return [*programs[command[0]], *words[1:]]


@pytest.mark.system
def test_the_commands_of_the_manifest_compute_what_one_process_does(tmp_path, alone):
    host = f"tcp://{SERVICE['metadata']['name']}:8786"
    environment = {each["name"]: each["value"] for each in WORKER["env"]}
    small = {"4096": SMALL, "/data": tmp_path}
    with Processes(tmp_path) as processes:
        command = run_here(SCHEDULER["command"], **{"0.0.0.0": "127.0.0.1", "8786": "0"})
        _, address = processes.scheduler(command)
        command = run_here(WORKER["command"], **{host: address, "/tmp": tmp_path / "scratch"})
        worker = processes.start(command, **environment)
        whole_map = processes.start(run_here(MAP["command"], **small, **{host: address}))
        assert whole_map.status() == 0, whole_map.said
        assert worker.popen.poll() is None
    assert files(tmp_path / "map-semi.zarr") == alone


def test_the_tally_tells_where_tops_stop():
    names = {}
    exec(TALLY, names)  # the page's own words
    found = names["found"]
    stops, deltas = found.fractions()["STOP"].share, found.coords["delta"]
    assert np.all(stops[(deltas > 1e-9) & (deltas < 0.75)] == 0)
    assert np.all(stops[deltas < -0.1] > 0.1)
    low, high = found.quantile("time", 0.5)
    assert np.all(low <= high)
