"""The JAX engine on one device, such as a GPU, and diffrax under one `vmap` there.

    python benchmarks/bench_device.py --starts 65536 1048576 --widths 4096 65536

The problem is the mixed basin. Each run gives one line of JSON: µs per start without compilation,
labels that differ from the engine's first run, steps of the blocks.
"""

import argparse
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers import with_diffrax
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure

RTOL = 1e-8


def engine(n: int, width: int, repeats: int) -> dict[str, Any]:
    """Measure labels by the JAX engine, all starts in one queue."""
    deltas, omegas = mixed_basin.sample(n)
    equation, y0 = dt.TransverseReduced(jnp.asarray(deltas)), jnp.asarray(omegas.T)
    bounds = engines.limits(RTOL, RTOL * jnp.linalg.norm(y0, axis=0), mixed_basin.MAX_STEPS)
    label = jax.jit(lambda equation, y: equation.verdict(y).outcome)

    def run() -> tuple[Any, Any]:
        ends = engines.integrate("jax", equation, y0, bounds, until="outcome", width=width)
        return ends, jax.block_until_ready(label(equation, ends.y))

    _, first = measure.timed(run)
    (ends, labels), clocks = measure.timed(run)
    for _ in range(repeats - 1):
        clocks = min(clocks, measure.timed(run)[1], key=lambda record: record["seconds"])
    return clocks | {
        "labels": np.asarray(labels),
        "compile_seconds": first["seconds"],
        "steps": int(ends.steps.sum()),
        "block_steps": engines.block_steps(ends).tolist(),
    }


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, nargs="+", default=[65536])
    parser.add_argument("--widths", type=int, nargs="+", default=[4096, 16384, 65536])
    parser.add_argument("--peer", type=int, nargs="*", default=[65536], help="starts for diffrax")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    device = jax.devices()[0]
    print(json.dumps(measure.machine() | {"device": device.device_kind}), flush=True)
    reference: dict[int, Any] = {}

    def show(name: str, n: int, result: dict[str, Any]) -> None:
        labels = result.pop("labels")
        known = reference.setdefault(n, labels)
        result |= {
            "name": name,
            "starts": n,
            "us_per_start": 1e6 * result["seconds"] / n,
            "undecided": int(np.sum(labels <= mixed_basin.UNDECIDED)),
            "differ": int(np.sum(labels != known)),
        }
        print(json.dumps(result), flush=True)

    for n in args.starts:
        for width in args.widths:
            if width <= n:
                show(f"lanes, {width} wide", n, engine(n, width, args.repeats))
    for n in args.peer:
        show("diffrax, vmap", n, with_diffrax.run(*mixed_basin.sample(n), RTOL, way="whole"))
