"""Dask schedulers, workers and maps as processes of this machine, none of which outlives a test.

Nothing here waits for a time: a process is waited for until it says or writes something, or fails.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time

DASK = [sys.executable, "-m", "dask"]
DIPOLETOP = [sys.executable, "-c", "from dipoletop.cli import main; main()"]
SCHEDULER = [*DASK, "scheduler", "--host", "127.0.0.1", "--no-dashboard"]
WORKER = [*DASK, "worker", "--nworkers=1", "--nthreads=1", "--no-dashboard"]
LONGEST = 300  # seconds, after which something hangs


HOLDING = """
import os, time
from pathlib import Path
from dipoletop._maps import sweep_plan
folder = Path({folder!r})
def held(plan, tiles, device, compute=sweep_plan.Plan.compute):
    with open(folder / "begun", "a") as log:
        log.write(f"{{tiles[0]}}\\n")
    if len(list(Path({records!r}).glob("*"))) >= {kept} and (folder / "hold").exists():
        with open(folder / "holding", "a") as log:
            log.write(f"{{tiles[0]}}\\n")
        while (folder / "hold").exists():
            time.sleep(0.02)
    return compute(plan, tiles, device)
if sweep_plan.Plan.compute.__name__ != "held":  # a preloaded file may run twice
    sweep_plan.Plan.compute = held
"""


class Hold:
    """Workers that preload `code` keep their tiles in hand once some are finished, until released.

    Args:
        folder: where they leave word of it.
        store: the store of the sweep.
        kept: how many tiles are finished before they do so.
    """

    def __init__(self, folder, store, kept):
        self.folder, self.records = folder, store / "dipoletop-tiles/done/c"
        names = {"folder": str(folder), "records": str(self.records)}
        self.code = HOLDING.format(kept=kept, **names)
        for name in ("begun", "holding", "hold"):
            (folder / name).touch()

    def kept(self):
        """The finished tiles."""
        return {int(file.name) for file in self.records.glob("*")}

    def _logged(self, name):
        return [int(line) for line in (self.folder / name).read_text().split()]

    def begun(self):
        """The tiles that were begun, as often as they were."""
        return self._logged("begun")

    def holding(self):
        """The tiles that were kept in hand."""
        return self._logged("holding")

    def release(self):
        (self.folder / "hold").unlink()


class Process:
    """A process in a group of its own, with all that it starts; `log` is the file of its output."""

    def __init__(self, command, log, **settings):
        environment = {**os.environ, "DIPOLETOP_CACHE": "off", "PYTHONUNBUFFERED": "1", **settings}
        self.log, streams = log, {"stdin": subprocess.DEVNULL, "stderr": subprocess.STDOUT}
        with open(log, "wb") as output:
            self.popen = subprocess.Popen(
                [str(word) for word in command],
                stdout=output,
                env=environment,
                start_new_session=True,
                **streams,
            )

    @property
    def said(self):
        return self.log.read_text(encoding="utf-8", errors="replace")

    def kill(self):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait()

    def status(self):
        """Its exit status, once it has ended."""
        until(lambda: self.popen.poll() is not None, self)
        return self.popen.returncode

    def says(self, pattern):
        """The match of a pattern in its output, once it is there."""
        found = []

        def look():
            found[:] = re.finditer(pattern, self.said)
            assert found or self.popen.poll() is None, self.said
            return found

        until(look, self)
        return found[0]


def until(condition, *processes):
    """Wait for a condition; what the processes have said is shown if it does not come."""
    end = time.monotonic() + LONGEST
    while not condition():
        assert time.monotonic() < end, "\n".join(process.said for process in processes)
        time.sleep(0.02)


class Processes(contextlib.ExitStack):
    """Starts processes, whose logs are in a folder, and kills at the end what is left of them."""

    def __init__(self, folder):
        super().__init__()
        self.folder, self.count = folder, 0

    def start(self, command, **settings):
        self.count += 1
        process = Process(command, self.folder / f"{self.count}.log", **settings)
        self.callback(process.kill)
        return process

    def scheduler(self, command=(*SCHEDULER, "--port", "0"), **settings):
        """A scheduler, and its address."""
        scheduler = self.start(command, **settings)
        return scheduler, scheduler.says(r"Scheduler at: +(tcp://[\d.]+:\d+)")[1]

    def worker(self, address, command=WORKER, preload="", **settings):
        """A worker that has joined; `preload` is code that it runs first."""
        scratch = ["--local-directory", self.folder / "scratch"]
        if preload:
            file = self.folder / f"preload_{self.count}.py"
            file.write_text(preload, encoding="utf-8")
            scratch += ["--preload", file]
        worker = self.start([*command, address, *scratch], **settings)
        worker.says("Starting established connection to")
        return worker
