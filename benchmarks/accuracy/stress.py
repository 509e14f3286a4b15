"""Labels and integrator in difficult cases: a million starts, the separatrix, every tolerance.

    python -m benchmarks.accuracy.stress --small     a look
    python -m benchmarks.accuracy.stress             all, about ten minutes on one core
    python -m benchmarks.accuracy.stress --write     the same, kept: results/stress.md

Random starts at order 1 are labelled, and integrated further until their end is plain
(`long_runs.py`). The wall is a set of starts on both sides of the separatrix (`separatrix.py`).
"""

import itertools
from collections.abc import Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.accuracy import long_runs, separatrix
from benchmarks.accuracy.separatrix import wrong
from benchmarks.problems.random_bodies import Starts, directions
from benchmarks.reporting import measure, pages
from dipoletop import Outcome

PIECE = 5000  # starts integrated together
BLOCKS = ("mixed", "slow", "tiny")
BUDGETS = {"mixed": (20_000, 60_000), "slow": (5000, 20_000), "tiny": (300, 1000)}
RTOLS = tuple(10.0**-k for k in range(4, 13))
Row = dict[str, Any]


def random_starts(block: str, n: int, rng: np.random.Generator) -> Starts:
    """Return starts with δ uniform in [−1, 0.99], isotropic directions, |ω| log-uniform.

    mixed: |ω| from 1e-3 to 3. tiny: from 1e-30 to 10; hardly any of these can be integrated to the
    end. slow: ω⊥ from 1e-30 to 10 and ω₃/ω⊥² from 1e-3 to 1e3, where both outcomes are near.
    """
    delta = rng.uniform(-1, 0.99, n)
    low, high = (-3, np.log10(3)) if block == "mixed" else (-30, 1)
    size = 10 ** rng.uniform(low, high, n)
    omega = size[:, None] * directions(n, rng)
    if block == "slow":
        phi = rng.uniform(0, 2 * np.pi, n)
        ratio = rng.choice([-1, 1], n) * 10 ** rng.uniform(-3, 3, n)
        omega = size[:, None] * np.stack([np.cos(phi), np.sin(phi), ratio * size], axis=1)
    inertia = np.eye(3) - delta[:, None, None] * np.diag([0, 0, 1])
    return Starts(inertia, np.tile([1.0, 0.0, 0.0], (n, 1)), omega)


def checked(block: str, n: int) -> Row:
    """So many labels against the ends of long runs without certificates."""
    pieces, largest_steps = [], 0
    for number in range(-(-n // PIECE)):
        rng = np.random.default_rng([0, BLOCKS.index(block), number])
        sample = random_starts(block, PIECE, rng)
        result = long_runs.compare("1", sample, budgets=BUDGETS[block], closed=True)
        delta, stop = 1 - sample.inertia[:, 2, 2], result.outcome == Outcome.STOP
        residual = result.outcome == Outcome.RESIDUAL
        # Labels that order 1 excludes.
        contrary = (stop & (delta > 0)) | (residual & (delta <= -0.5))
        pieces.append(result.counted(number, stop=stop, contrary=contrary))
        largest_steps = max(largest_steps, int(result.steps.max()))
    return {"block": block, "largest_steps": largest_steps} | long_runs.merged(pieces)


def wall(small: bool) -> Row:
    """Labels of starts on both sides of the separatrix, at every tolerance."""
    near, rows = separatrix.wall(20 if small else 400), []
    for engine in engines.NAMES:
        before = np.zeros(len(near.truth))
        for rtol in (1e-3, *RTOLS, 1e-13, 1e-14):
            settings: Any = {"rtol": rtol, "engine": engine, "value": False}
            tops = dt.TransverseReduced(separatrix.DELTA)
            run = dt.classify_many(tops, near.starts.T, **settings)
            hidden = wrong(run.outcome, near.truth) & (before == run.outcome)
            row = {"engine": engine, "rtol": rtol} | near.judged(run.outcome)
            row |= {"farthest_hidden": near.farthest(hidden)}
            rows.append(row | {"largest_steps": int(run.steps.max())})
            before = run.outcome
    return near.about() | {"rows": rows}


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
            way: Any = {"solver": method, "until": "time"}
            ends = engines.integrate("native", equation, starts, bounds, **way)
            errors.append(float(jnp.max(jnp.abs(ends.y - exact) / size[None])))
        slope = float(np.polyfit(np.log(RTOLS), np.log(errors), 1)[0])
        over = [error / rtol for error, rtol in zip(errors, RTOLS, strict=True)]
        about = {"method": type(method).__name__, "problem": name}
        rows.append(about | {"over": over, "slope": slope})
    return rows


def measured(small: bool) -> Row:
    """All of it."""
    near, blocks = wall(small), []
    for block in BLOCKS:
        n = (5000 if small else 1_000_000) // (1 if block == "mixed" else 4)
        row, clocks = measure.timed(checked, block, n)
        blocks.append(row | {"seconds": clocks["seconds"]})
    about = {"span": near["span"], "wall": near, "blocks": blocks}
    return about | {"tolerances": tolerances(small)}


if __name__ == "__main__":
    pages.command("stress", measured)
