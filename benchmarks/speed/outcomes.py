"""The mixed basin: from starts to certain outcomes, every integrator on all cores."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks import engines
from benchmarks.peers.available import available
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.views import IN_JAX, OURS

RTOL = 1e-8
# One vmap over all starts is so slow that it gets fewer starts, once.
SLOW = ("diffrax vmap whole, tuple", "diffrax vmap whole, (3,)")


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
    }


def labelled(cases: dict[Any, Callable[[], dict[str, Any]]], repeats: int) -> list[dict[str, Any]]:
    """A row for each peer; labels are compared with the first one's, where both have them."""
    records = measure.interleaved(cases, repeats, once=SLOW)
    ours = next(iter(records.values()))[0]["labels"]
    rows = []
    for name, runs in records.items():
        labels, steps = runs[0]["labels"], runs[0]["steps"]
        row = measure.summary(runs) | {"name": name, "starts": (n := len(labels))}
        row |= {"first_seconds": runs[0]["compile_seconds"], "steps": steps / n}
        row |= {"evaluations": engines.evaluations(steps, n) / n}
        row |= {"undecided": int(np.sum(labels <= mixed_basin.UNDECIDED))}
        rows.append(row | {"differ_from_ours": int(np.sum(labels != ours[:n]))})
    return rows


def compare(small: bool) -> dict[str, Any]:
    """All peers at all sizes, their labels compared with ours."""
    sizes, slow, repeats = ((256,), 32, 1) if small else ((4096, 32768, 262_144), 1024, 5)
    others, missing = available()
    peers = {OURS: run, IN_JAX: partial(run, engine="jax"), **others}
    tables = {}
    for size in sizes:
        cases: dict[Any, Any] = {
            name: partial(
                peer, *mixed_basin.sample(min(size, slow) if name in SLOW else size), RTOL
            )
            for name, peer in peers.items()
        }
        tables[size] = {"rows": labelled(cases, repeats)}
        jax.clear_caches()  # the next size compiles as if it were the first
    return {"rtol": RTOL, "missing": missing, "tables": tables}
