"""The first call of a process: processor seconds after the imports.

    python -m benchmarks.speed.first_calls --small     each once
    python -m benchmarks.speed.first_calls             three times, five minutes
    python -m benchmarks.speed.first_calls --write     the same, kept: results/first_calls.md

Each call has fresh processes: one whose caches are empty, a second one with the machine code that
the first has left, and one that also finds JAX's programs. No XLA_FLAGS are set. JAX, diffrax and
what they need are imported before; `imports` shows what diffrax takes after JAX.
"""

import importlib
import statistics
import tempfile
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import dipoletop as dt
from benchmarks.reporting import measure

# Nothing else of dipoletop is imported here: that would belong to the first call.


class Call(NamedTuple):
    """A call by a user."""

    made: Callable[[Any], Any]
    """From what was made before to its result."""
    target: float | None = None
    """Seconds that it should take at most the first time ever, and half of them with caches."""
    before: Callable[[], Any] | None = None
    """What is made before, and not counted."""


def start() -> Any:
    return dt.cylindrical(0.2, 0.2, 0.1)


def simulated() -> Any:
    return dt.simulate(dt.TransverseSemi(-0.2), start(), ts=np.linspace(0.0, 1e3, 201))


def many() -> Any:
    omegas = np.random.default_rng(0).normal(size=(1000, 3))
    return dt.classify_many(dt.TransverseSemi(-0.2), 0.1 * omegas)


def swept() -> Any:
    grid = dt.Grid(w3=np.linspace(0.0, 0.5, 64), phi=np.arange(64) * np.pi / 64)
    return dt.sweep(
        lambda w3, phi: (dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)),
        grid,
        progress=False,
    )


def differentiated() -> Any:
    def value(delta: Any) -> Any:
        return dt.residual_rotation(dt.TransverseSemi(delta), start())

    return jax.value_and_grad(value)(-0.2)


def predicted() -> Any:
    grain = dt.Particle.cuboid([1e-7, 6e-8, 4e-8], [0, 0, 8e-27], density=2000)
    return dt.predict(grain, dt.particles.start(grain, "1 GHz", momentum=[1, 1, 1]))


def predicted_needle(*omega: float) -> Any:
    return dt.predict(dt.axisymmetric(0.5), omega)


def derivative_of_needle() -> Any:
    omega = jax.numpy.array([9e-10, 5e-10, 1e-9])
    return jax.grad(lambda omega: dt.predict(dt.axisymmetric(0.5), omega).ratio)(omega)


CALLS = {
    "imports": Call(lambda _: importlib.import_module("diffrax")),
    "cylindrical": Call(lambda _: start()),
    "simulate": Call(lambda _: simulated()),
    "energy": Call(lambda trajectory: trajectory.energy, 0.3, simulated),
    "classify": Call(lambda _: dt.classify(dt.TransverseSemi(-0.2), start()), 2.0),
    "classify_many": Call(lambda _: many(), 2.0),
    "sweep": Call(lambda _: swept(), 2.5),
    "residual_rotation": Call(lambda _: differentiated(), 6.0),
    "predict": Call(lambda _: predicted(), 6.0),
    "predict, needle": Call(lambda _: predicted_needle(9e-10, 5e-10, 1e-9), 6.0),
    "predict, its phase known": Call(lambda _: predicted_needle(9e-4, 5e-4, 1e-7), 6.0),
    "predict, needle, derivative": Call(lambda _: derivative_of_needle()),
    "lines": Call(lambda _: dt.lines(dt.axisymmetric(-0.5), [0.0, 0.0, 2.0]), 2.0),
}


def seconds(name: str, programs: str | None = None) -> float:
    """Processor seconds of the first call in this process, with JAX's cache in a folder or none."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", programs)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    call = CALLS[name]
    if name != "imports":
        importlib.import_module("diffrax")
    before = call.before and jax.block_until_ready(call.before())
    begin = time.process_time()
    jax.block_until_ready(call.made(before))
    return time.process_time() - begin


def in_each_process(name: str) -> list[float]:
    """With empty caches, with machine code, and with JAX's programs, too."""
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as programs:
        folders = (None, None, programs, programs)  # the third one fills JAX's cache
        found = [measure.in_fresh_process(seconds, name, x, cache=cache) for x in folders]
    return [*found[:2], found[3]]


def measured(small: bool) -> dict[str, Any]:
    """A row for each call, medians over the repeats."""
    rows = []
    for name, call in CALLS.items():
        runs = [in_each_process(name) for _ in range(1 if small else 3)]
        first, second, warm = (statistics.median(column) for column in zip(*runs, strict=True))
        later = None if call.target is None else call.target / 2
        row = {"call": name, "repeats": len(runs), "first": first, "second": second, "warm": warm}
        rows.append(row | {"target": call.target, "target_later": later})
    return {"rows": rows}


if __name__ == "__main__":
    from benchmarks.reporting import pages

    pages.command("first_calls", measured)
