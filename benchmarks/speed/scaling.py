"""Growth of the cost with amplitude and shape."""

from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers import with_diffrax
from benchmarks.problems import mixed_basin
from benchmarks.reporting.views import IN_JAX, OURS, REPACKED
from benchmarks.speed.outcomes import RTOL, labelled, run

BUDGET = 100_000  # steps of a run; at small amplitudes they are many
SHAPES = (-0.2, 0.3)  # of the tops whose amplitude is varied
AMPLITUDES = (1.0, 0.1, 0.01, 1e-3, 1e-4)
DELTAS = (-0.9, -0.7, -0.51, -0.45, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 0.9)
AMPLITUDE = 0.1  # where δ is varied
SMALL = 0.01  # amplitude below which there are fewer starts
SMALLEST = 1e-3  # amplitude below which diffrax, ten times as slow, is left out


def sampled(
    samples: dict[str, tuple[Any, Any]], small: bool, diffrax: bool
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
            name: partial(peer, *sample, RTOL, max_steps=BUDGET) for name, peer in peers.items()
        }
        rows += [row | {"at": at} for row in labelled(cases, 1 if small else 3)]
    return rows


def compare(small: bool) -> dict[str, Any]:
    """Isotropic starts with one |ω|, for two shapes; with one δ."""
    n, found = 64 if small else 16384, {}
    found["amplitude"], found["shape"] = [], []
    for delta in SHAPES:
        for size in (AMPLITUDE,) if small else AMPLITUDES:
            many = n if size >= SMALL else n // 32
            sample = np.full(many, delta), mixed_basin.isotropic(many, size)
            name = f"δ = {delta:g}, amplitude {size:g}"
            found["amplitude"] += sampled({name: sample}, small, diffrax=size >= SMALLEST)
    for delta in (-0.7, 0.3) if small else DELTAS:
        sample = np.full(n, delta), mixed_basin.isotropic(n, AMPLITUDE)
        # The peers' regions hold for −1/2 < δ < 1 only.
        found["shape"] += sampled({f"δ = {delta:g}": sample}, small, diffrax=delta > -0.5)
    return {"rtol": RTOL, "budget": BUDGET} | found
