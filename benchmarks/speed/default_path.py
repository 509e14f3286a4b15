"""What the calls cost that a user makes first: the semi-reduced level, defaults, one core.

python -m benchmarks.speed.default_path --small       a look
python -m benchmarks.speed.default_path --write       all; kept: results/default_path.md
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure, pages

RTOL, EXACT = 1e-8, 1e-12  # of the calls; of the run that their errors are measured by
MAX_STEPS = 50_000  # of dipoletop by default; also of heyoka
CALLS: dict[str, dict[str, Any]] = {
    "all defaults": {},
    "`slow_flow=False`": {"slow_flow": False},
    '`value="unchecked"`': {"value": "unchecked"},
    "`value=False`": {"value": False},
}
PEER = "heyoka, SIMD batches"


def tops(n: int) -> tuple[Any, np.ndarray]:
    """Return the tops and starts of the mixed basin."""
    deltas, omegas = mixed_basin.sample(n)
    return dt.TransverseSemi(jnp.asarray(deltas)), omegas


def bodies(n: int) -> tuple[Any, np.ndarray]:
    """Return random triaxial bodies with the dipole on a principal axis, J = 1 about it."""
    _, omegas = mixed_basin.sample(n, seed=5)
    moments = 1 - np.random.default_rng(1).dirichlet(np.ones(3), n)
    moments = jnp.asarray(moments / moments[:, :1])
    dipole = jnp.array([1.0, 0.0, 0.0])
    return dt.SemiReduced(jax.vmap(lambda j: dt.Body(jnp.diag(j), dipole))(moments)), omegas


def compared(name: str, given: tuple[Any, np.ndarray], repeats: int) -> list[dict[str, Any]]:
    """A row for each call, and for heyoka if it is installed."""
    equation, omegas = given

    def ours(call: str) -> measure.Record:
        found, clocks = measure.timed(dt.classify_many, equation, omegas, **CALLS[call])
        steps = float(found.steps.mean())
        return clocks | {"labels": found.outcome, "values": found.omega_inf, "steps": steps}

    cases: dict[str, Callable[[], measure.Record]] = {call: partial(ours, call) for call in CALLS}
    try:
        from benchmarks.peers.heyoka_ends import Ends
    except ImportError:
        pass
    else:
        ends = Ends(equation, RTOL)

        def peer() -> measure.Record:
            (labels, values), clocks = measure.timed(ends.find, omegas, MAX_STEPS)
            return clocks | {"labels": labels, "values": values}

        cases[PEER] = peer
    measure.interleaved(cases, 1)  # everybody is measured warm
    records = measure.interleaved(cases, repeats)
    exact = dt.classify_many(equation, omegas, rtol=EXACT, value="unchecked", slow_flow=False)
    integrated = exact.steps > 0  # others have no error, or none that steps have caused

    def errors(values: np.ndarray) -> list[float]:
        with np.errstate(all="ignore"):
            error = np.abs(values / exact.omega_inf - 1)[integrated]
        return np.nanquantile(error, [0.5, 0.98]).tolist()

    costs = {call: measure.summary(runs)["processor_seconds"] for call, runs in records.items()}
    usual, rows = records["all defaults"][0]["labels"], []
    for call, cost in costs.items():
        run = records[call][0]
        labels = run["labels"]
        known = (labels > 0) & (usual > 0)
        rows.append(
            {
                "of": name,
                "starts": len(omegas),
                "call": call,
                "us": [1e6 * cost[kind] / len(omegas) for kind in ("min", "median")],
                "peer": costs[PEER]["min"] / cost["min"] if PEER in costs else None,
                "errors": None if call == "`value=False`" else errors(run["values"]),
                "steps": run.get("steps"),
                "undecided": int(np.sum(labels <= 0)),
                "differ": int(np.sum((labels != usual) & known)),
            }
        )
    return rows


def slow_bodies(n: int) -> tuple[Any, np.ndarray]:
    """Return the triaxial bodies, so slow that all of them are predicted."""
    equation, omegas = bodies(n)
    return equation, 1e-20 * omegas / np.linalg.norm(omegas, axis=1)[:, None]


def surveys(points: int) -> list[dict[str, Any]]:
    """A map in a store, counts without one, and predictions, of points × points starts."""
    grid = dt.symmetry_cell(points, points)

    def top(w3: Any, phi: Any) -> Any:
        return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)

    def stored() -> measure.Record:
        with tempfile.TemporaryDirectory() as folder:
            store = Path(folder) / "map.zarr"
            return measure.timed(dt.sweep, top, grid, store=store, progress=False)[1]

    def counted() -> measure.Record:
        return measure.timed(dt.tally, top, grid, progress=False)[1]

    slow, omegas = slow_bodies(points**2)

    def predicted() -> measure.Record:
        return measure.timed(dt.classify_many, slow, omegas)[1]

    of_tops = ", tops, δ = −0.2, ω⊥ = 0.2"
    cases = {f"`sweep` with a store{of_tops}": stored, f"`tally`{of_tops}": counted}
    cases["`classify_many`, triaxial bodies, ω = 1e-20: all are predicted"] = predicted
    rows = []
    for name, case in cases.items():
        case()
        cost = measure.summary([case() for _ in range(3)])["processor_seconds"]
        us = [1e6 * cost[kind] / points**2 for kind in ("min", "median")]
        rows.append({"call": name, "starts": points**2, "us": us})
    return rows


def measured(small: bool) -> dict[str, Any]:
    """Every part, on one core."""
    sizes, many, repeats, points = (256,), 32, (1, 1), 16
    if not small:
        sizes, many, repeats, points = (4096, 32_768, 262_144), 4096, (3, 2), 512
    with measure.confined(1):
        rows = [row for n in sizes for row in compared("tops", tops(n), repeats[0])]
        rows += compared("triaxial bodies", bodies(many), repeats[1])
        return {"rows": rows, "surveys": surveys(points)}


if __name__ == "__main__":
    pages.command("default_path", measured)
