"""The JAX engine on one device, a GPU above all, beside diffrax under one `vmap` there.

    python benchmarks/bench_device.py --starts 65536 1048576 --widths 4096 65536

The mixed basin of `problem.py`; one JSON line for each run: µs per start without compilation,
labels that differ from those of the engine's first run, steps of the blocks.
"""

import argparse
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
import measure
import peer_diffrax
import problem
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import JaxEngine

RTOL = 1e-8


def engine(n: int, width: int, repeats: int) -> dict[str, Any]:
    """Labels by the JAX engine, all starts in one queue."""
    deltas, omegas = problem.mixed_basin(n)
    equation, y0 = dt.TransverseReduced(jnp.asarray(deltas)), jnp.asarray(omegas.T)
    limits = Limits(
        jnp.asarray(RTOL),
        RTOL * jnp.linalg.norm(y0, axis=0),
        jnp.full(n, jnp.inf),
        jnp.asarray(problem.MAX_STEPS),
    )
    judge = jax.jit(lambda equation, y: equation.verdict(y).outcome)

    def run() -> tuple[Any, Any]:
        ends = JaxEngine(width=width).end_states(equation, y0, limits, until="outcome")
        return ends, jax.block_until_ready(judge(equation, ends.y))

    _, first = measure.timed(run)
    (ends, labels), clocks = measure.timed(run)
    for _ in range(repeats - 1):
        clocks = min(clocks, measure.timed(run)[1], key=lambda record: record["seconds"])
    return clocks | {
        "labels": np.asarray(labels),
        "compile_seconds": first["seconds"],
        "steps": int(ends.steps.sum()),
        "block_steps": np.asarray(ends.block_steps).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, nargs="+", default=[65536])
    parser.add_argument("--widths", type=int, nargs="+", default=[4096, 16384, 65536])
    parser.add_argument("--peer", type=int, nargs="*", default=[65536], help="starts of diffrax")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    device = jax.devices()[0]
    print(json.dumps(measure.machine() | {"device": device.device_kind}), flush=True)
    reference: dict[int, Any] = {}

    def show(name: str, n: int, found: dict[str, Any]) -> None:
        labels = found.pop("labels")
        known = reference.setdefault(n, labels)
        found |= {
            "name": name,
            "starts": n,
            "us_per_start": 1e6 * found["seconds"] / n,
            "undecided": int(np.sum(labels <= problem.UNDECIDED)),
            "differ": int(np.sum(labels != known)),
        }
        print(json.dumps(found), flush=True)

    for n in args.starts:
        for width in args.widths:
            if width <= n:
                show(f"lanes, {width} wide", n, engine(n, width, args.repeats))
    for n in args.peer:
        show("diffrax, vmap", n, peer_diffrax.run(*problem.mixed_basin(n), RTOL, way="whole"))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
