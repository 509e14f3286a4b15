"""The mixed basin: from starts to certain outcomes, every integrator on all cores."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers import with_scipy
from benchmarks.peers.available import available
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.speed import OURS

RTOL = 1e-8
IN_JAX = "dipoletop, JAX engine"
# One vmap over all starts is so slow that it gets fewer starts, and one run.
SLOW = ("diffrax vmap whole, tuple", "diffrax vmap whole, (3,)")
RIVALS = (
    IN_JAX,
    "heyoka batch",
    "diffrax vmap repacked, tuple",
    "diffrax vmap chunked, tuple",
    *SLOW,
)


class Sizes(NamedTuple):
    """Sizes of the measurement."""

    starts: tuple[int, ...]
    slow: int
    """Number of starts for the slow peers."""
    truth: int
    """Number of starts that scipy labels."""
    repeats: int
    rivals: tuple[str, ...] = RIVALS


def run(
    deltas: Float[np.ndarray, " n"],
    omegas: Float[np.ndarray, "n 3"],
    rtol: float,
    engine: str = "native",
    max_steps: int = mixed_basin.MAX_STEPS,
) -> dict[str, Any]:
    """Return labels of all starts by `classify_many`, in the form of a peer."""
    shapes, starts = jnp.asarray(deltas), jnp.asarray(omegas)

    def classified() -> dt.Classification:
        equations = dt.TransverseReduced(shapes)
        settings = {"rtol": rtol, "max_steps": max_steps, "engine": engine}
        return dt.classify_many(equations, starts, value=False, **settings)

    _, first = measure.timed(classified)
    labels, clocks = measure.timed(classified)
    return clocks | {
        "labels": labels.outcome,
        "compile_seconds": first["seconds"],
        "steps": int(labels.steps.sum()),
        "most_steps": int(labels.steps.max()),
        "note": f"dipoletop {dt.__version__}, {engine}, {measure.cores()} threads",
    }


def lane_efficiency(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"], rtol: float, engine: str
) -> dict[str, Any]:
    """Return the share of lane steps that advance a running start, one core's part at a time."""
    parts = np.array_split(np.arange(len(deltas)), measure.cores())
    widths = engines.block_widths(engine, len(parts[-1]))
    made, block_steps = 0, np.zeros(2, int)
    for part in parts:
        y0 = jnp.asarray(omegas[part].T)
        bounds = engines.limits(rtol, rtol * jnp.linalg.norm(y0, axis=0), mixed_basin.MAX_STEPS)
        equation = dt.TransverseReduced(jnp.asarray(deltas[part]))
        with jax.default_device(jax.devices()[0]):  # as in `classify_many`: compiled already
            ends = engines.integrate(engine, equation, y0, bounds, until="outcome")
        made += int(ends.steps.sum())
        block_steps += engines.block_steps(ends)
    return {
        "engine": engine,
        "widths": widths,
        "block_steps": block_steps.tolist(),
        "lane_steps": made,
        "efficiency": made / max(int(block_steps @ widths), 1),
    }


def compare(sizes: Sizes) -> dict[str, Any]:
    """Measure all peers at all sizes, and compare their labels with scipy's and ours."""
    rivals, missing = available()
    truth = with_scipy.run(*mixed_basin.sample(sizes.truth), rtol=1e-12)
    rivals[IN_JAX] = partial(run, engine="jax")
    everybody = {OURS: run} | {name: rivals[name] for name in sizes.rivals if name in rivals}
    tables = {}
    for size in sizes.starts:
        cases: dict[Any, Callable[[], dict[str, Any]]] = {}
        for name, peer in everybody.items():
            starts = mixed_basin.sample(min(size, sizes.slow) if name in SLOW else size)
            cases[name] = partial(peer, *starts, RTOL)
        records = measure.interleaved(cases, sizes.repeats, once=SLOW)
        ours = records[OURS][0]["labels"]
        tables[size] = {
            "rows": [_row(name, runs, ours, truth["labels"]) for name, runs in records.items()],
            "lanes": [
                lane_efficiency(*mixed_basin.sample(size), RTOL, engine) for engine in engines.NAMES
            ],
        }
        jax.clear_caches()  # the next size compiles as if it were the first
    scipy_row = {
        "note": truth["note"],
        "starts": sizes.truth,
        "microseconds": 1e6 * truth["seconds"] / sizes.truth,
        "steps": truth["steps"] / sizes.truth,
    }
    return {"rtol": RTOL, "missing": missing, "truth": scipy_row, "tables": tables}


def _row(name: str, records: list[dict[str, Any]], ours: Any, truth: Any) -> dict[str, Any]:
    """Return one row of the table; labels are compared over the common starts."""
    labels = records[0]["labels"]
    both, known = min(len(labels), len(ours)), min(len(labels), len(truth))
    return measure.summary(records) | {
        "name": name,
        "note": records[0]["note"],
        "starts": len(labels),
        "first_seconds": records[0]["compile_seconds"],
        "steps": records[0]["steps"] / len(labels),
        "undecided": int(np.sum(labels <= mixed_basin.UNDECIDED)),
        "differ_from_ours": int(np.sum(labels[:both] != ours[:both])),
        "differ_from_truth": int(np.sum(labels[:known] != truth[:known])),
        "truth_starts": known,
    }
