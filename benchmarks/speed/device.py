"""The JAX engine on one device, such as a GPU, and diffrax under one `vmap` there.

    python -m benchmarks.speed.device --starts 65536 1048576 --widths 4096 65536

The mixed basin; one line of JSON for each run: µs per start without compilation, labels that
differ from those of the first run, steps of the blocks.
"""

import argparse
import json
from functools import partial
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
REPEATS = 3


def engine(deltas: np.ndarray, omegas: np.ndarray, width: int) -> dict[str, Any]:
    """Labels by the JAX engine, all starts in one queue; the fastest run."""
    label = jax.jit(lambda deltas, y: dt.TransverseReduced(deltas).verdict(y).outcome)

    def run() -> tuple[Any, Any]:
        shapes, y0 = jnp.asarray(deltas), jnp.asarray(omegas.T)
        atol = RTOL * jnp.linalg.norm(y0, axis=0)
        bounds = engines.limits(RTOL, atol, mixed_basin.MAX_STEPS)
        way: Any = {"until": "outcome", "width": width}
        ends = engines.integrate("jax", dt.TransverseReduced(shapes), y0, bounds, **way)
        return ends, jax.block_until_ready(label(shapes, ends.y))

    first, *runs = [measure.timed(run) for _ in range(1 + REPEATS)]
    (ends, labels), clocks = min(runs, key=lambda run: run[1]["seconds"])
    about = {"labels": np.asarray(labels), "compile_seconds": first[1]["seconds"]}
    steps = {"steps": int(ends.steps.sum()), "block_steps": np.asarray(ends.block_steps).tolist()}
    return clocks | about | steps


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, nargs="+", default=[65536])
    parser.add_argument("--widths", type=int, nargs="+", default=[4096, 16384, 65536])
    args = parser.parse_args()
    print(json.dumps(measure.machine() | {"device": jax.devices()[0].device_kind}), flush=True)
    for n in args.starts:
        ways: dict[str, Any] = {f"lanes, {k} wide": partial(engine, width=k) for k in args.widths}
        ways["diffrax, vmap"] = partial(with_diffrax.run, rtol=RTOL, way="whole")
        known = None
        for name, way in ways.items():
            result = way(*mixed_basin.sample(n))
            labels = result.pop("labels")
            known = labels if known is None else known
            result |= {"name": name, "starts": n, "us_per_start": 1e6 * result["seconds"] / n}
            result |= {"undecided": int(np.sum(labels <= mixed_basin.UNDECIDED))}
            print(json.dumps(result | {"differ": int(np.sum(labels != known))}), flush=True)


if __name__ == "__main__":
    main()
