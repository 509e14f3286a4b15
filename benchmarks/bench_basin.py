"""The mixed basin: from starts to certain outcomes, everybody on all cores."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
import measure
import peers
import problem
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import NARROW, JaxEngine
from dipoletop._engines.native_engine import WIDTH, NativeEngine

RTOL = 1e-8
OURS, IN_JAX = "dipoletop, native engine", "dipoletop, JAX engine"
# One vmap over all starts is so slow that fewer starts, once, must do.
SLOW = ("diffrax vmap whole, tuple", "diffrax vmap whole, (3,)")
RIVALS = (
    IN_JAX,
    "heyoka batch",
    "diffrax vmap repacked, tuple",
    "diffrax vmap chunked, tuple",
    *SLOW,
)


class Sizes(NamedTuple):
    """How much is measured."""

    starts: tuple[int, ...]
    slow: int
    """Starts for the slow ones."""
    truth: int
    """Starts that scipy follows."""
    repeats: int
    rivals: tuple[str, ...] = RIVALS


def run(
    deltas: Float[np.ndarray, " n"],
    omegas: Float[np.ndarray, "n 3"],
    rtol: float,
    engine: str = "native",
    max_steps: int = problem.MAX_STEPS,
) -> dict[str, Any]:
    """dipoletop as one of the peers: labels of all starts by `classify_many`."""
    shapes, starts = jnp.asarray(deltas), jnp.asarray(omegas)

    def classified() -> dt.Classification:
        equations = dt.TransverseReduced(shapes)
        settings = {"rtol": rtol, "max_steps": max_steps, "engine": engine}
        return dt.classify_many(equations, starts, value=False, **settings)

    _, first = measure.timed(classified)
    found, clocks = measure.timed(classified)
    return clocks | {
        "labels": found.outcome,
        "compile_seconds": first["seconds"],
        "steps": int(found.steps.sum()),
        "most_steps": int(found.steps.max()),
        "note": f"dipoletop {dt.__version__}, {engine}, {measure.cores()} threads",
    }


def block_widths(engine: Any, starts: int) -> list[int]:
    """Lanes of an engine's wide and narrow blocks; 0 where there is none."""
    if isinstance(engine, NativeEngine):
        return [WIDTH, 0]
    return [min(engine.width, starts), max(engine.width // NARROW, 1)]


def lane_efficiency(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"], rtol: float, engine: Any
) -> dict[str, Any]:
    """Which part of the lane steps was made for a running start, one core's share at a time."""
    parts = np.array_split(np.arange(len(deltas)), measure.cores())
    widths = block_widths(engine, len(parts[-1]))
    made, swept = 0, np.zeros(2, int)
    for part in parts:
        y0 = jnp.asarray(omegas[part].T)
        limits = Limits(
            jnp.asarray(rtol),
            rtol * jnp.linalg.norm(y0, axis=0),
            jnp.full(len(part), jnp.inf),
            jnp.asarray(problem.MAX_STEPS),
        )
        equation = dt.TransverseReduced(jnp.asarray(deltas[part]))
        with jax.default_device(jax.devices()[0]):  # as `classify_many` has it: compiled already
            ends = engine.end_states(equation, y0, limits, until="outcome")
        made += int(ends.steps.sum())
        swept += np.asarray(ends.block_steps)
    return {
        "engine": engine.name,
        "widths": widths,
        "block_steps": swept.tolist(),
        "lane_steps": made,
        "efficiency": made / max(int(swept @ widths), 1),
    }


def compare(sizes: Sizes) -> dict[str, Any]:
    """All peers at all sizes, their labels held to scipy's and to ours."""
    available, missing = peers.available()
    truth = peers.truth(*problem.mixed_basin(sizes.truth))
    available[IN_JAX] = partial(run, engine="jax")
    everybody = {OURS: run} | {name: available[name] for name in sizes.rivals if name in available}
    tables = {}
    for size in sizes.starts:
        cases: dict[Any, Callable[[], dict[str, Any]]] = {}
        for name, peer in everybody.items():
            starts = problem.mixed_basin(min(size, sizes.slow) if name in SLOW else size)
            cases[name] = partial(peer, *starts, RTOL)
        records = measure.interleaved(cases, sizes.repeats, once=SLOW)
        ours = records[OURS][0]["labels"]
        tables[size] = {
            "rows": [_row(name, found, ours, truth["labels"]) for name, found in records.items()],
            "lanes": [
                lane_efficiency(*problem.mixed_basin(size), RTOL, engine)
                for engine in (NativeEngine(), JaxEngine())
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
    """One line of the table; labels are compared over the starts that both have."""
    labels = records[0]["labels"]
    both, known = min(len(labels), len(ours)), min(len(labels), len(truth))
    return measure.summary(records) | {
        "name": name,
        "note": records[0]["note"],
        "starts": len(labels),
        "first_seconds": records[0]["compile_seconds"],
        "steps": records[0]["steps"] / len(labels),
        "undecided": int(np.sum(labels <= problem.UNDECIDED)),
        "differ_from_ours": int(np.sum(labels[:both] != ours[:both])),
        "differ_from_truth": int(np.sum(labels[:known] != truth[:known])),
        "truth_starts": known,
    }
