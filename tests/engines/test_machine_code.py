"""Machine code is compiled once, and found on disk by later processes."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from dipoletop._base import private_cache
from dipoletop._base.monitoring import NATIVE_COMPILATION
from dipoletop._engines import machine_code

SCRIPT = f"""
import warnings; warnings.simplefilter("error")
import jax
jax.config.update("jax_enable_x64", True)
compiled = []
jax.monitoring.register_event_listener(lambda event, **_: compiled.append(event))
import dipoletop as dt
ends = dt.classify_many(
    dt.TransverseReduced(-0.2), [[0.2, 0.1, 0.2], [0.0, 0.2, 0.1]], engine="native"
)
print(compiled.count({NATIVE_COMPILATION!r}), ends.omega_inf.tolist(), ends.steps.tolist())
"""


def fresh(**variables):
    """How many functions a new process compiles, and what it finds."""
    clean = {k: x for k, x in os.environ.items() if k != private_cache.VARIABLE}
    environment = clean | {k: str(x) for k, x in variables.items()}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    number, found = done.stdout.split(maxsplit=1)
    return int(number), found


@pytest.mark.system
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the cache has another folder")
def test_a_second_process_compiles_nothing_and_finds_the_same(tmp_path):
    functions, found = fresh(XDG_CACHE_HOME=tmp_path)
    assert functions == 5  # four kernels and the loop
    assert fresh(XDG_CACHE_HOME=tmp_path) == (0, found)
    entries = list((tmp_path / "dipoletop").iterdir())
    assert len(entries) == 5
    content = entries[0].read_bytes()
    entries[0].write_bytes(content[:200] + bytes([content[200] ^ 1]) + content[201:])
    assert fresh(XDG_CACHE_HOME=tmp_path) == (1, found)
    assert entries[0].read_bytes() == content
    assert fresh(XDG_CACHE_HOME=tmp_path, DIPOLETOP_CACHE="off") == (5, found)
    (tmp_path / "file").write_text("")
    # As in a home that cannot be written to; modes do not stop an administrator.
    assert fresh(XDG_CACHE_HOME=tmp_path / "file") == (5, found)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache."""
    monkeypatch.delenv(private_cache.VARIABLE, raising=False)
    monkeypatch.setattr(private_cache, "location", lambda: tmp_path / "cache")


def number(value):
    """A function that writes a number."""
    return f"""
define void @treat(double* %first, i64 %stride, double* %shared) {{
  store double {value:.17e}, double* %first
  ret void
}}"""


def call(code):
    import ctypes

    place = np.zeros(1)
    pointers = ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p
    function = ctypes.CFUNCTYPE(None, *pointers)(code.address)
    function(place.ctypes.data, 8, place.ctypes.data)
    return place[0]


def test_code_is_found_by_its_text_and_by_nothing_else(cache, monkeypatch):
    assert call(machine_code.machine_code(number(1.5))) == 1.5
    assert call(machine_code.machine_code(number(2.5))) == 2.5
    monkeypatch.setattr(machine_code, "_compile", None)  # it is on disk
    assert call(machine_code.machine_code(number(1.5))) == 1.5


def test_code_of_other_circumstances_is_not_found(cache, monkeypatch):
    machine_code.machine_code(number(1.5))
    compiled, here = [], machine_code._circumstances()
    for i in range(len(here)):
        other = (*here[:i], here[i] + b"x", *here[i + 1 :])
        monkeypatch.setattr(machine_code, "_circumstances", lambda other=other: other)
        monkeypatch.setattr(machine_code, "report_native_compilation", lambda: compiled.append(1))
        assert call(machine_code.machine_code(number(1.5))) == 1.5
    assert len(compiled) == len(here)


def test_circumstances_name_processor_and_versions():
    import llvmlite
    from llvmlite import binding

    known = machine_code._circumstances()
    for text in (llvmlite.__version__, binding.get_host_cpu_name()):
        assert text.encode() in known
    assert any(re.search(rb"[+-]\w", text) for text in known)  # features
