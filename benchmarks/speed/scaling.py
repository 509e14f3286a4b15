"""Growth of the cost with amplitude, shape, batch, cores and grid.

Cores and memory are measured in fresh processes. The cores of a process are set before it starts
(`os.sched_setaffinity`, which a child inherits), because JAX counts them once.

    python -m benchmarks.speed.scaling 32768 3 native jax     starts, repeats, engines: JSON
"""

import argparse
import importlib
import itertools
import json
import os
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import engines
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.speed import OURS
from benchmarks.speed import default_map
from benchmarks.speed.outcomes import IN_JAX, RTOL, run

NAMES = {"native": OURS, "jax": IN_JAX}
DIFFRAX = "diffrax vmap repacked, tuple"
BUDGET = 100_000  # largest number of steps of a run; small amplitudes need many
SHAPES = (-0.2, 0.3)  # δ of the tops whose amplitude is varied
AMPLITUDE = 0.1  # of the tops whose δ is varied
SMALL = 0.01  # amplitude below which there are fewer starts
SMALLEST = 1e-3  # amplitude below which diffrax, ten times slower, is left out


class Sizes(NamedTuple):
    """Sizes of the measurement."""

    amplitudes: tuple[float, ...] = (1.0, 0.1, 0.01, 1e-3, 1e-4)
    deltas: tuple[float, ...] = (-0.9, -0.7, -0.51, -0.45, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 0.9)
    starts: int = 16384
    batches: tuple[int, ...] = (1, 10, 100, 1_000, 10_000, 100_000, 1_000_000)
    cores: tuple[int, ...] = (1, measure.cores())
    shared: int = 262_144
    """Number of starts that the cores share."""
    maps: tuple[tuple[int, str, bool], ...] = (
        *((n, engine, False) for n in (64, 256, 512, 1024) for engine in engines.NAMES),
        (1024, "native", True),
    )
    """Number of points on each axis, engine, whether the result is written to the disk."""
    repeats: int = 3
    engines: tuple[str, ...] = engines.NAMES
    diffrax: bool = True


FEW = Sizes(
    amplitudes=(0.1,),
    deltas=(-0.7, 0.3),
    starts=64,
    batches=(1, 100),
    cores=(1,),
    shared=64,
    maps=((16, "native", False),),
    repeats=1,
    engines=("native",),
    diffrax=False,
)


def _peers(sizes: Sizes) -> dict[str, Callable[..., dict[str, Any]]]:
    everybody: dict[str, Any] = {
        NAMES[engine]: partial(run, engine=engine) for engine in sizes.engines
    }
    if sizes.diffrax:
        everybody[DIFFRAX] = importlib.import_module("benchmarks.peers.with_diffrax").run
    return everybody


def _labelled(samples: dict[Any, Any], sizes: Sizes, budget: int) -> list[dict[str, Any]]:
    """Return rows by sample (δ, ω) and peer: both clocks, steps, right-hand sides, labels."""
    rows = []
    for key, (deltas, omegas) in samples.items():
        cases: dict[Any, Any] = {
            name: partial(peer, deltas, omegas, RTOL, max_steps=budget)
            for name, peer in _peers(sizes).items()
        }
        records = measure.interleaved(cases, sizes.repeats)
        ours = records[OURS][0]["labels"]
        for name, runs in records.items():
            starts, steps, labels = len(omegas), runs[0]["steps"], runs[0]["labels"]
            rows.append(
                measure.summary(runs)
                | {"name": name, "at": key, "starts": starts, "steps": steps / starts}
                | {"evaluations": measure.evaluations(steps, starts) / starts}
                | {"undecided": int(np.sum(labels <= mixed_basin.UNDECIDED))}
                | {"differ_from_ours": int(np.sum(labels != ours))}
            )
    return rows


def by_amplitude(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure isotropic starts with one |ω|, for two shapes."""
    rows = []
    for delta, size in itertools.product(SHAPES, sizes.amplitudes):
        n = sizes.starts if size >= SMALL else sizes.starts // 32
        sample = np.full(n, delta), mixed_basin.isotropic(n, size)
        who = sizes if size >= SMALLEST else sizes._replace(diffrax=False)
        rows += _labelled({f"δ = {delta:g}, amplitude {size:g}": sample}, who, BUDGET)
    return rows


def by_shape(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure isotropic starts of tops with one δ; the peers' regions hold for −1/2 < δ < 1."""
    omegas = mixed_basin.isotropic(sizes.starts, AMPLITUDE)
    rows = []
    for delta in sizes.deltas:
        sample = {f"δ = {delta:g}": (np.full(sizes.starts, delta), omegas)}
        who = sizes if delta > -0.5 else sizes._replace(diffrax=False)
        rows += _labelled(sample, who, BUDGET)
    return rows


def by_batch(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure the mixed basin in batches of all sizes."""
    samples = {f"N = {n}": mixed_basin.sample(n) for n in sizes.batches}
    return _labelled(samples, sizes, mixed_basin.MAX_STEPS)


def by_cores(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure the mixed basin on one core and on all, each in its own process."""
    if not hasattr(os, "sched_setaffinity"):  # not Linux
        return []
    rows = []
    for cores in dict.fromkeys(sizes.cores):
        with measure.confined(cores):
            rows += measure.in_fresh_process(__name__, sizes.shared, sizes.repeats, *sizes.engines)
    return rows


def _on_these_cores(starts: int, repeats: int, names: list[str]) -> list[dict[str, Any]]:
    samples = {f"cores: {measure.cores()}": mixed_basin.sample(starts)}
    sizes = Sizes(repeats=repeats, engines=tuple(names), diffrax=False)
    return _labelled(samples, sizes, mixed_basin.MAX_STEPS)


def by_memory(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure the memory of single sweeps of the default map, each in its own process."""
    return [default_map.measured("memory", n, engine, int(disk)) for n, engine, disk in sizes.maps]


def in_fresh_processes(sizes: Sizes) -> dict[str, Any]:
    """Measure cores and memory; to be called while this process is small."""
    return {"cores": by_cores(sizes), "memory": by_memory(sizes)}


def compare(sizes: Sizes) -> dict[str, Any]:
    """Measure the dependence on amplitude, shape and batch."""
    return {
        "rtol": RTOL,
        "budget": BUDGET,
        "amplitude": by_amplitude(sizes),
        "shape": by_shape(sizes),
        "batch": by_batch(sizes),
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("starts", type=int)
    parser.add_argument("repeats", type=int)
    parser.add_argument("engines", nargs="*", choices=engines.NAMES, default=engines.NAMES)
    args = parser.parse_args()
    print(json.dumps(_on_these_cores(args.starts, args.repeats, args.engines)))
