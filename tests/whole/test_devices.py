"""Several devices: each does its share, and no bit depends on which one did the work.

Only the native engine classifies many starts in one call: its threads share one queue.
"""

import hashlib
import json
import os
import subprocess
import sys
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._maps.columns import COLUMNS
from dipoletop._runs import memory_limits

pytestmark = pytest.mark.system

COUNT, DEVICES = "--xla_force_host_platform_device_count", 2
ENGINES = ["jax", "native"]
TILE, TILES = 128, 6
WAYS = np.random.default_rng(8).normal(size=(32, 3))
GRID = dt.Grid(rate=np.linspace(0.5, 2.0, 24), omega0=0.3 * WAYS)

FORKED = """
import os
from dipoletop._base.parallel import pool
assert pool(2).submit(int).result() == 0
child = os.fork()
if not child:
    os._exit(pool(2).submit(int).result(timeout=120))
assert os.waitpid(child, 0)[1] == 0
"""


class Braked(eqx.Module):
    """ω′ = −r ω²ω: short, since every device compiles it anew; it ends on a small sphere."""

    rate: jax.Array

    def __call__(self, t, y, args=None):
        return -(self.rate * jnp.sum(y**2, axis=0))[None] * y

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done, ahead = jnp.sum(y**2, axis=0) < 0.02, y[0] > 0
        outcome = jnp.where(ahead, int(dt.Outcome.RESIDUAL), int(dt.Outcome.STOP))
        return jnp.where(done, outcome, 0), jnp.where(ahead, y[0], 0.0), done


def swept(devices, engine):
    def problem(rate, omega0):
        return Braked(rate), omega0

    return dt.sweep(problem, GRID, devices=devices, engine=engine, value="unchecked")


def classified(engine, device=None):
    points = GRID.points(np.arange(TILE * TILES))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(memory_limits, "TILE", TILE)
        starts = jax.device_put(points["omega0"], device)
        tops = Braked(points["rate"])
        return dt.classify_many(tops, starts, engine=engine, value="unchecked")


def digest(found):
    """A hash of every bit that was found."""
    columns = (np.asarray(getattr(found, name), float).tobytes() for name in COLUMNS)
    return hashlib.sha256(b"".join(columns)).hexdigest()


def watched(run, together):
    """What a run finds, and the device of each tile: in JAX that which its results lie on.

    So many tiles at a time wait for each other, so no device can do the work of another.
    """
    in_machine_code, by_jax = NativeEngine.classify, JaxEngine.classify
    meeting, used = threading.Barrier(together), []

    def met(devices):
        used.extend(device.id for device in devices)
        meeting.wait(300)

    def native(engine, finish, queue, device, threads=1):
        met([device])
        return in_machine_code(engine, finish, queue, device, threads)

    def in_jax(engine, finish, queue, device, threads=1):
        found, paused = by_jax(engine, finish, queue, device, threads)
        met(jax.tree.leaves(found)[0].devices())
        return found, paused

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NativeEngine, "classify", native)
        patch.setattr(JaxEngine, "classify", in_jax)
        return digest(run()), sorted(used)


def everything(engine):
    """Runs on every device, on one of them, and with starts that lie on one of them."""
    devices = jax.devices()
    every = len(devices)
    at_once = 1 if engine == "native" else every
    return {
        "many": watched(lambda: classified(engine), at_once),
        "sweep": watched(lambda: swept(devices, engine), every),
        "sweep on one": watched(lambda: swept(devices[1:2], engine), 1),
        "starts on one": watched(lambda: classified(engine, devices[1]), at_once),
    }


@pytest.fixture(scope="module")
def runs():
    settings = {
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {COUNT}={DEVICES}",
        "JAX_ENABLE_X64": "1",
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": os.pathsep.join(sys.path),  # with that of `quick`
    }
    # Options come first: engines take them when they are imported.
    code = "import quick; quick.set_compiler_options(); import test_devices; test_devices.show()"
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, env=os.environ | settings, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr.decode()
    return json.loads(run.stdout)


def show():
    print(json.dumps({engine: everything(engine) for engine in ENGINES}))


@pytest.mark.parametrize("engine", ENGINES)
def test_every_device_works_and_finds_the_same_bits(runs, engine):
    here = swept(jax.devices()[:1], engine)
    assert set(here.fractions()) == {"RESIDUAL", "STOP"}
    bits = digest(here)
    assert digest(classified(engine)) == bits
    everywhere = [bits, sorted([*range(DEVICES)] * (TILES // DEVICES))]
    many = [bits, [0]] if engine == "native" else everywhere
    assert runs[engine] == {
        "many": many,
        "sweep": everywhere,
        "sweep on one": [bits, [1] * TILES],
        "starts on one": many,
    }


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_has_threads_of_its_own():
    subprocess.run([sys.executable, "-c", FORKED], check=True, timeout=300)
