"""Labels and integrator in difficult cases: a million starts, the separatrix, every tolerance.

    python -m benchmarks.accuracy.stress --small     a look
    python -m benchmarks.accuracy.stress             all, about ten minutes on one core
    python -m benchmarks.accuracy.stress --write     the same, kept: results/stress.md

Random starts at order 1 are labelled, and integrated further until their end is plain
(`long_runs.py`). The wall is a set of starts on both sides of the separatrix (`separatrix.py`).
"""

import argparse
import itertools
import time
from collections.abc import Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.accuracy import long_runs, separatrix
from benchmarks.problems.random_bodies import Starts
from benchmarks.reporting import measure, pages
from dipoletop import Outcome

PIECE = 5000  # starts integrated together
BLOCKS = ("mixed", "slow", "tiny")
BUDGETS = {"mixed": (20_000, 60_000), "slow": (5000, 20_000), "tiny": (300, 1000)}
RTOLS = tuple(10.0**-k for k in range(4, 13))
DELTA = -0.2  # shape of the tops at the wall
NEAREST, FARTHEST = 1e-14, 1e-2  # distances of the wall's starts from the separatrix, in φ
Row = dict[str, Any]


def random_starts(block: str, n: int, rng: np.random.Generator) -> Starts:
    """Return starts with δ uniform in [−1, 0.99], isotropic directions, |ω| log-uniform.

    mixed: |ω| from 1e-3 to 3. tiny: from 1e-30 to 10; hardly any of these can be integrated to the
    end. slow: ω⊥ from 1e-30 to 10 and ω₃/ω⊥² from 1e-3 to 1e3, where both outcomes are near.
    """
    delta = rng.uniform(-1, 0.99, n)
    low, high = (-3, np.log10(3)) if block == "mixed" else (-30, 1)
    size = 10 ** rng.uniform(low, high, n)
    way = rng.normal(size=(n, 3))
    omega = size[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
    if block == "slow":
        phi = rng.uniform(0, 2 * np.pi, n)
        ratio = rng.choice([-1, 1], n) * 10 ** rng.uniform(-3, 3, n)
        omega = size[:, None] * np.stack([np.cos(phi), np.sin(phi), ratio * size], axis=1)
    inertia = np.zeros((n, 3, 3))
    inertia[:, 0, 0] = inertia[:, 1, 1] = 1
    inertia[:, 2, 2] = 1 - delta
    return Starts(inertia, np.tile([1.0, 0.0, 0.0], (n, 1)), omega)


def checked(block: str, n: int, seed: int) -> Row:
    """Compare n labels with the ends of long runs without certificates."""
    begin = time.perf_counter()
    row: Row = {"block": block, "largest_steps": 0, "wrong_starts": []}
    for number in range(-(-n // PIECE)):
        rng = np.random.default_rng([seed, BLOCKS.index(block), number])
        sample = random_starts(block, PIECE, rng)
        result = long_runs.compare("1", sample, budgets=BUDGETS[block], closed=True)
        counts = {
            "n": np.ones(PIECE),
            "residual": result.outcome == Outcome.RESIDUAL,
            "stop": result.outcome == Outcome.STOP,
            "undecided": result.outcome == Outcome.UNDECIDED,
            "failed": result.outcome == Outcome.FAILED,
            "plain": result.plain,
            "wrong": result.wrong,
            "contrary": _contrary(sample, result.outcome),
        }
        for name, values in counts.items():
            row[name] = row.get(name, 0) + int(np.sum(values))
        row["wrong_starts"] += [[number, int(k)] for k in np.flatnonzero(result.wrong)]
        row["largest_steps"] = max(row["largest_steps"], int(result.steps.max()))
    return row | {"seconds": time.perf_counter() - begin}


def _contrary(sample: Starts, outcome: np.ndarray) -> np.ndarray:
    """Mark labels that order 1 excludes: a stop at δ > 0, a residual rotation at δ ≤ −1/2."""
    delta = 1 - sample.inertia[:, 2, 2]
    stop, residual = outcome == Outcome.STOP, outcome == Outcome.RESIDUAL
    return (stop & (delta > 0)) | (residual & (delta <= -0.5))


def wall(small: bool) -> Row:
    """Label starts on both sides of the separatrix, at every tolerance."""
    each = 20 if small else 400
    distances = np.geomspace(FARTHEST, 1e-8 if small else NEAREST, each)
    near = separatrix.wall(DELTA, distances, 5 if small else 10)
    about = {"edge": str(near.edge), "between": near.between, "starts": 2 * each}
    result: Row = about | {"rows": []}
    for engine in ("native", "jax"):
        before = None
        for rtol in (1e-3, *RTOLS, 1e-13, 1e-14):
            settings: Any = {"rtol": rtol, "engine": engine, "value": False}
            run = dt.classify_many(dt.TransverseReduced(DELTA), near.starts.T, **settings)
            wrong = (run.outcome > 0) & (run.outcome != near.truth)
            hidden = wrong & (before == run.outcome) if before is not None else wrong & False
            result["rows"].append(
                {
                    "engine": engine,
                    "rtol": rtol,
                    "undecided": int(np.sum(run.outcome <= 0)),
                    "wrong": int(np.sum(wrong)),
                    "farthest": float(np.max(near.distance[wrong], initial=0)),
                    "farthest_hidden": float(np.max(near.distance[hidden], initial=0)),
                    "largest_steps": int(run.steps.max()),
                }
            )
            before = run.outcome
    return result


def problems(n: int) -> Iterator[tuple[str, Any, Any, Any, Any]]:
    """Yield name, equations, starts, times up to 20 braking times, and the exact states there."""
    rng = np.random.default_rng(7)
    deltas = jnp.asarray(rng.uniform(-0.9, 0.9, n))
    speeds = 10 ** rng.uniform(-1, 0.5, n)
    times = jnp.asarray(20 * 10 ** rng.uniform(-2.5, 0, n) / speeds**2)  # every stage of braking
    way = rng.normal(size=(3, n))
    any_way = jnp.asarray(way / np.linalg.norm(way, axis=0) * speeds)
    plane = any_way.at[2].set(0.0)
    axis = jnp.zeros((3, n)).at[2].set(speeds)
    exact = dt.exact
    for name, equation, shapes, starts, solution in (
        ("longitudinal", dt.LongitudinalReduced, deltas, any_way, exact.longitudinal),
        ("transverse, ω₃ = 0", dt.TransverseReduced, deltas, plane, exact.transverse),
        ("transverse, ω⊥ = 0", dt.TransverseReduced, deltas, axis, exact.transverse),
        ("transverse, δ = 0", dt.TransverseReduced, 0 * deltas, any_way, exact.transverse),
    ):
        ends = jax.vmap(solution, (0, -1, 0), -1)(shapes, starts, times)
        yield name, equation(shapes), starts, times, ends
    ends = jax.vmap(exact.rotator)(jnp.asarray(speeds), times)[None]
    yield "rotator", dt.RotatorReduced(), jnp.asarray(speeds)[None], times, ends


def tolerances(small: bool) -> list[Row]:
    """Return the largest error over rtol·|ω₀| at every rtol, and d log error/d log rtol."""
    methods = [diffrax.Dopri8()] if small else [diffrax.Dopri8(), diffrax.Dopri5(), diffrax.Tsit5()]
    rows = []
    for method, problem in itertools.product(methods, problems(64 if small else 1024)):
        name, equation, starts, times, exact = problem
        size, errors = jnp.linalg.norm(starts, axis=0), []
        for rtol in RTOLS:
            bounds = engines.limits(rtol, rtol * size, 1_000_000, times)
            ends = engines.integrate(
                "native", equation, starts, bounds, solver=method, until="time"
            )
            errors.append(float(jnp.max(jnp.abs(ends.y - exact) / size[None])))
        slope = np.polyfit(np.log(RTOLS), np.log(errors), 1)[0]
        over = [error / rtol for error, rtol in zip(errors, RTOLS, strict=True)]
        rows.append(
            {"method": type(method).__name__, "problem": name, "over": over, "slope": float(slope)}
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, default=1_000_000, help="starts of the first block")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="small sizes: does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")
    n = 5000 if args.small else args.n
    results: Row = {
        "command": measure.command(),
        "seed": args.seed,
        **measure.machine(),
        "rtols": RTOLS,
        "span": [NEAREST, FARTHEST],
        "tolerances": tolerances(args.small),
        "wall": wall(args.small),
        "blocks": [
            checked(block, n if block == "mixed" else n // 4, args.seed) for block in BLOCKS
        ],
    }
    pages.show("stress", results, keep=args.write)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
