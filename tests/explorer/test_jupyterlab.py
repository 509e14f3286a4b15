"""The explorer as output of a cell in JupyterLab: it draws, follows a slider, and takes a click."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

from benchmarks import browsing

pytest.importorskip("jupyterlab", reason="needs `pip install -e '.[notebooks]'`")
CELL = """\
import jax
import dipoletop as dt
jax.config.update("jax_enable_x64", True)
dt.explore(size=64)"""


def notebook():
    cell = {"cell_type": "code", "execution_count": None, "id": "explorer", "metadata": {}}
    cell |= {"outputs": [], "source": CELL}
    spec = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": [cell], "metadata": {"kernelspec": spec}, "nbformat": 4, "nbformat_minor": 5}


@contextlib.contextmanager
def laboratory(folder):
    """The address of a JupyterLab that shows a folder, to this machine only, without a token."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root"]
    command += [f"--port={port}", "--IdentityProvider.token=", f"--ServerApp.root_dir={folder}"]
    environment = os.environ | {
        "DIPOLETOP_CACHE": "off",
        "JUPYTER_CONFIG_DIR": str(folder / "config"),
        "JUPYTER_DATA_DIR": str(folder / "data"),
    }
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=environment, **quiet)
    url = f"http://127.0.0.1:{port}"
    try:
        end = time.monotonic() + 180
        while True:
            try:
                urllib.request.urlopen(f"{url}/api").close()
                break
            except OSError:
                assert time.monotonic() < end, "JupyterLab did not start"
                time.sleep(0.2)
        yield url
    finally:
        process.terminate()
        process.wait(60)


@pytest.mark.system
def test_the_explorer_lives_in_jupyterlab(chromium, tmp_path):
    (tmp_path / "map.ipynb").write_text(json.dumps(notebook()))
    with laboratory(tmp_path) as url:
        page = chromium.new_context(viewport={"width": 1400, "height": 1000}).new_page()
        page.set_default_timeout(1000 * browsing.PATIENCE)
        visit = browsing.Visit(page)
        page.on("pageerror", lambda error: visit.complaints.append(str(error)))
        page.goto(f"{url}/lab/tree/map.ipynb")
        page.locator(".jp-CodeCell .cm-content").first.click()
        page.get_by_text("Python 3 (ipykernel) | Idle").wait_for()
        page.keyboard.press("Shift+Enter")
        visit.final(fine=True, delta=-0.2)
        before = visit.pixels()
        visit.drag("delta", 40)
        delta = visit.value("delta")
        assert delta > 0.1
        visit.final(fine=True, delta=delta)
        assert np.mean(np.any(before != visit.pixels(), axis=2)) > 0.05
        page.mouse.click(*visit.place(0.5, 0.5))
        visit.until(lambda: "certified for" in visit.text(), "the verdict of the start")
        visit.close()
    assert visit.complaints == []
