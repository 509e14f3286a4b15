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
    at: str, delta: float, amplitude: float, n: int, small: bool, diffrax: bool
) -> list[dict[str, Any]]:
    """A row for each peer: both clocks, steps, right-hand sides, labels of isotropic starts."""
    peers: dict[str, Any] = {OURS: run}
    if not small:
        peers[IN_JAX] = partial(run, engine="jax")
    if diffrax and not small:
        peers[REPACKED] = with_diffrax.run
    sample = np.full(n, delta), mixed_basin.isotropic(n, amplitude)
    cases: dict[Any, Any] = {
        name: partial(peer, *sample, RTOL, max_steps=BUDGET) for name, peer in peers.items()
    }
    return [row | {"at": at} for row in labelled(cases, 1 if small else 3)]


def compare(small: bool) -> dict[str, Any]:
    """Isotropic starts with one |ω|, for two shapes; with one δ."""
    n, amplitude, shape = 64 if small else 16384, [], []
    for delta in SHAPES:
        for size in (AMPLITUDE,) if small else AMPLITUDES:
            at, many = f"δ = {delta:g}, amplitude {size:g}", n if size >= SMALL else n // 32
            amplitude += sampled(at, delta, size, many, small, diffrax=size >= SMALLEST)
    for delta in (-0.7, 0.3) if small else DELTAS:
        # The peers' regions hold for −1/2 < δ < 1 only.
        shape += sampled(f"δ = {delta:g}", delta, AMPLITUDE, n, small, diffrax=delta > -0.5)
    return {"rtol": RTOL, "budget": BUDGET, "amplitude": amplitude, "shape": shape}
