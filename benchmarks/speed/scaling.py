"""Growth of the cost with amplitude, shape, batch, cores and grid.

Cores and memory are measured in fresh processes. Which cores a process may use is set before it
starts (`os.sched_setaffinity`, which a child inherits), because JAX counts them once.
"""

import os
from functools import partial
from typing import Any

import numpy as np

from benchmarks import engines
from benchmarks.peers import with_diffrax
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.views import IN_JAX, OURS, REPACKED
from benchmarks.speed import default_map
from benchmarks.speed.outcomes import RTOL, labelled, run

BUDGET = 100_000  # steps of a run; at small amplitudes they are many
SHAPES = (-0.2, 0.3)  # of the tops whose amplitude is varied
AMPLITUDES = (1.0, 0.1, 0.01, 1e-3, 1e-4)
DELTAS = (-0.9, -0.7, -0.51, -0.45, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 0.9)
AMPLITUDE = 0.1  # where δ is varied
SMALL = 0.01  # amplitude below which there are fewer starts
SMALLEST = 1e-3  # amplitude below which diffrax, ten times as slow, is left out
SHARED = 262_144  # starts that the cores share
MAPS = [(n, engine, False) for n in (64, 256, 512, 1024) for engine in engines.NAMES]
"""Points on each axis, engine, whether the result goes to the disk."""


def sampled(
    samples: dict[str, tuple[Any, Any]], budget: int, small: bool, diffrax: bool = True
) -> list[dict[str, Any]]:
    """A row for each sample (δ, ω) and peer: both clocks, steps, right-hand sides, labels."""
    peers: dict[str, Any] = {OURS: run}
    if not small:
        peers[IN_JAX] = partial(run, engine="jax")
    if diffrax and not small:
        peers[REPACKED] = with_diffrax.run
    rows = []
    for at, sample in samples.items():
        cases: dict[Any, Any] = {
            name: partial(peer, *sample, RTOL, max_steps=budget) for name, peer in peers.items()
        }
        rows += [row | {"at": at} for row in labelled(cases, 1 if small else 3)]
    return rows


def on_these_cores(starts: int, small: bool) -> list[dict[str, Any]]:
    """The mixed basin on the cores that this process may use."""
    samples = {f"cores: {measure.cores()}": mixed_basin.sample(starts)}
    return sampled(samples, mixed_basin.MAX_STEPS, small, diffrax=False)


def in_fresh_processes(small: bool) -> dict[str, Any]:
    """Cores and memory: to be called while this process is small."""
    rows, shared = [], 64 if small else SHARED
    counts = {1, 1 if small else measure.cores()} if hasattr(os, "sched_setaffinity") else ()
    for count in sorted(counts):
        with measure.confined(count):
            rows += measure.in_fresh_process(on_these_cores, shared, small)
    maps = [(16, "native", False)] if small else [*MAPS, (1024, "native", True)]
    memory = [measure.in_fresh_process(default_map.memory, *case) for case in maps]
    return {"cores": rows, "memory": memory}


def compare(small: bool) -> dict[str, Any]:
    """Isotropic starts with one |ω|, for two shapes; with one δ; the mixed basin in batches."""
    n, found = 64 if small else 16384, {}
    found["amplitude"], found["shape"] = [], []
    for delta in SHAPES:
        for size in (AMPLITUDE,) if small else AMPLITUDES:
            many = n if size >= SMALL else n // 32
            sample = np.full(many, delta), mixed_basin.isotropic(many, size)
            name = f"δ = {delta:g}, amplitude {size:g}"
            found["amplitude"] += sampled({name: sample}, BUDGET, small, diffrax=size >= SMALLEST)
    for delta in (-0.7, 0.3) if small else DELTAS:
        sample = np.full(n, delta), mixed_basin.isotropic(n, AMPLITUDE)
        # The peers' regions hold for −1/2 < δ < 1 only.
        found["shape"] += sampled({f"δ = {delta:g}": sample}, BUDGET, small, diffrax=delta > -0.5)
    sizes = (1, 100) if small else [10**k for k in range(7)]
    samples = {f"N = {size}": mixed_basin.sample(size) for size in sizes}
    found["batch"] = sampled(samples, mixed_basin.MAX_STEPS, small)
    return {"rtol": RTOL, "budget": BUDGET} | found
