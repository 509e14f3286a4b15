"""The labels and the integrator where it is hard: a million starts, the separatrix, tolerances.

    python benchmarks/bench_stress.py --small     a look
    python benchmarks/bench_stress.py             all, about ten minutes on one core
    python benchmarks/bench_stress.py --write     and kept: README.md, results/

Random starts at order 1 are labelled, and integrated on until their end is plain (`labels.py`).
The wall stands at the separatrix, which 80-bit Taylor series find without any certificate.
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
import labels
import measure
import report
from dipoletop._base.types import Outcome
from dipoletop._engines.interface import Limits
from dipoletop._engines.native_engine import NativeEngine

PIECE = 5000  # starts followed together
BLOCKS = ("mixed", "slow", "tiny")
BUDGETS = {"mixed": (20_000, 60_000), "slow": (5000, 20_000), "tiny": (300, 1000)}
RTOLS = tuple(10.0**-k for k in range(4, 13))
LEAST, LARGEST, HALVINGS = 1e-14, 1e-2, 6  # of the wall; 2^HALVINGS angles for each round
ORDER = 26  # of the Taylor series
Row = dict[str, Any]


def random_starts(block: str, n: int, rng: np.random.Generator) -> labels.Starts:
    """δ uniform in [−1, 0.99], isotropic directions, |ω| log-uniform.

    mixed: |ω| from 1e-3 to 3. tiny: from 1e-30 to 10, of which hardly any can be followed to its
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
    return labels.Starts(inertia, np.tile([1.0, 0.0, 0.0], (n, 1)), omega)


def checked(block: str, n: int, seed: int) -> Row:
    """So many labels against the end of a long run that knows no certificate."""
    begin = time.perf_counter()
    row: Row = {"block": block, "largest_steps": 0, "wrong_starts": []}
    for number in range(-(-n // PIECE)):
        rng = np.random.default_rng([seed, BLOCKS.index(block), number])
        sample = random_starts(block, PIECE, rng)
        found = labels.compare("1", sample, budgets=BUDGETS[block], closed=True)
        decided = found.outcome > 0
        plain = decided & (found.final > 0)
        wrong = plain & (found.final != found.outcome)
        counts = {
            "n": np.ones_like(plain),
            "residual": found.outcome == Outcome.RESIDUAL,
            "stop": found.outcome == Outcome.STOP,
            "undecided": found.outcome == Outcome.UNDECIDED,
            "failed": found.outcome == Outcome.FAILED,
            "plain": plain,
            "wrong": wrong,
            "contrary": _contrary(sample, found.outcome),
        }
        for name, values in counts.items():
            row[name] = row.get(name, 0) + int(np.sum(values))
        row["wrong_starts"] += [[number, int(k)] for k in np.flatnonzero(wrong)]
        row["largest_steps"] = max(row["largest_steps"], int(found.steps.max()))
    return row | {"seconds": time.perf_counter() - begin}


def _contrary(sample: labels.Starts, outcome: np.ndarray) -> np.ndarray:
    """Labels that order 1 excludes: a stop for δ > 0, a residual rotation for δ ≤ −1/2."""
    delta = 1 - sample.inertia[:, 2, 2]
    stop, residual = outcome == Outcome.STOP, outcome == Outcome.RESIDUAL
    return (stop & (delta > 0)) | (residual & (delta <= -0.5))


# --- the separatrix --------------------------------------------------------------------------


def _series(d: np.longdouble, y: np.ndarray) -> np.ndarray:
    """Taylor coefficients (ORDER + 1, 3, N) of the solution of (4.2)–(4.4), typed again."""
    c = np.zeros((ORDER + 1, *y.shape), np.longdouble)
    c[0] = y
    drag, axial = np.zeros((2, ORDER + 1, y.shape[1]), np.longdouble)
    w1, w2, w3 = c[:, 0], c[:, 1], c[:, 2]
    for k in range(ORDER):

        def product(a: np.ndarray, b: np.ndarray, k: int = k) -> np.ndarray:
            return np.sum(a[: k + 1] * b[k::-1], axis=0)

        s1, s2, s3 = product(c, c)
        drag[k] = s1 + s2 + s3 + d * (1 + d) * s3
        axial[k] = (s1 + s2 + s3 + d * (2 * s1 - s2)) / (1 - d)
        rate = [d * product(w2, w3), -d * product(w1, w3) - product(drag, w2), -product(axial, w3)]
        c[k + 1] = np.stack(rate) / (k + 1)
    return c


def destinies(delta: float, omegas: np.ndarray) -> np.ndarray:
    """Outcomes of starts (3, N) in 80-bit numbers: until precession, or the line, is far ahead."""
    d, y = np.longdouble(delta), np.array(omegas, np.longdouble)
    found, live = np.zeros(y.shape[1], int), np.arange(y.shape[1])
    while live.size:
        c = _series(d, y[:, live])
        sizes = np.sqrt(np.sum(c**2, axis=1))
        reach = [(sizes[0] / sizes[k]) ** (1 / np.longdouble(k)) for k in (ORDER - 1, ORDER)]
        h = np.minimum(*reach) * np.exp(np.longdouble(-2))
        new = c[ORDER]
        for lower in c[-2::-1]:
            new = new * h + lower
        y[:, live] = new
        w1, w2, w3 = new
        stop = np.abs(d * w3) > 6 * (w1**2 + w2**2)
        line = (w1 * w2) ** 2 + (d * w3) ** 2 < 1e-4 * w1**4
        found[live] = np.where(stop, Outcome.STOP, np.where(line, Outcome.RESIDUAL, 0))
        live = live[~(stop | line)]
    return found


def _at(phi: np.ndarray) -> np.ndarray:
    """ω⊥ = ω₃ = 1/5 at the angles φ, shape (3, N)."""
    fifth = np.longdouble(1) / 5
    return np.stack([fifth * np.cos(phi), fifth * np.sin(phi), np.full_like(phi, fifth)])


def separatrix(delta: float, rounds: int) -> tuple[Any, Any]:
    """The angle from which ω⊥ = ω₃ = 1/5 stops, between two neighbours."""
    low, high = np.longdouble(0), np.longdouble(1)
    for _ in range(rounds):
        phi = low + (high - low) * np.arange(2**HALVINGS + 1) / np.longdouble(2**HALVINGS)
        last = np.flatnonzero(np.diff(destinies(delta, _at(phi))))[0]
        low, high = phi[last], phi[last + 1]
    return low, high


def wall(small: bool) -> Row:
    """Labels of starts on both sides of the separatrix, at every tolerance."""
    delta = -0.2
    low, high = separatrix(delta, 5 if small else 10)
    edge = (low + high) / 2
    each = 20 if small else 400
    far = np.geomspace(LARGEST, 1e-8 if small else LEAST, each).astype(np.longdouble)
    starts = _at(np.concatenate([edge - far, edge + far])).astype(float)
    truth = destinies(delta, starts)  # of the rounded starts
    distance = np.concatenate([far, far]).astype(float)
    found: Row = {"edge": str(edge), "between": float(high - low), "starts": 2 * each, "rows": []}
    for engine in ("native", "jax"):
        before = None
        for rtol in (1e-3, *RTOLS, 1e-13, 1e-14):
            run = dt.classify_many(
                dt.TransverseReduced(delta), starts.T, rtol=rtol, value=False, engine=engine
            )
            wrong = (run.outcome > 0) & (run.outcome != truth)
            hidden = wrong & (before == run.outcome) if before is not None else wrong & False
            found["rows"].append(
                {
                    "engine": engine,
                    "rtol": rtol,
                    "undecided": int(np.sum(run.outcome <= 0)),
                    "wrong": int(np.sum(wrong)),
                    "farthest": float(np.max(distance[wrong], initial=0)),
                    "farthest_hidden": float(np.max(distance[hidden], initial=0)),
                    "largest_steps": int(run.steps.max()),
                }
            )
            before = run.outcome
    return found


# --- tolerances ------------------------------------------------------------------------------


def problems(n: int) -> Iterator[tuple[str, Any, Any, Any, Any]]:
    """Name, equations, starts, 20 braking times, and the exact ends there."""
    rng = np.random.default_rng(7)
    deltas = jnp.asarray(rng.uniform(-0.9, 0.9, n))
    speeds = 10 ** rng.uniform(-1, 0.5, n)
    times = jnp.asarray(20 * 10 ** rng.uniform(-2.5, 0, n) / speeds**2)  # every stage of braking
    way = rng.normal(size=(3, n))
    any_way = jnp.asarray(way / np.linalg.norm(way, axis=0) * speeds)
    plane = any_way.at[2].set(0.0)
    axis = jnp.zeros((3, n)).at[2].set(speeds)
    exact = dt.exact
    for name, level, shapes, starts, solution in (
        ("longitudinal", dt.LongitudinalReduced, deltas, any_way, exact.longitudinal),
        ("transverse, ω₃ = 0", dt.TransverseReduced, deltas, plane, exact.transverse),
        ("transverse, ω⊥ = 0", dt.TransverseReduced, deltas, axis, exact.transverse),
        ("transverse, δ = 0", dt.TransverseReduced, 0 * deltas, any_way, exact.transverse),
    ):
        ends = jax.vmap(solution, (0, -1, 0), -1)(shapes, starts, times)
        yield name, level(shapes), starts, times, ends
    ends = jax.vmap(exact.rotator)(jnp.asarray(speeds), times)[None]
    yield "rotator", dt.RotatorReduced(), jnp.asarray(speeds)[None], times, ends


def tolerances(small: bool) -> list[Row]:
    """Largest error over rtol·|ω₀| at every rtol, and the slope of log error on log rtol."""
    methods = [diffrax.Dopri8()] if small else [diffrax.Dopri8(), diffrax.Dopri5(), diffrax.Tsit5()]
    rows = []
    for method, problem in itertools.product(methods, problems(64 if small else 1024)):
        name, equation, starts, times, exact = problem
        size, errors = jnp.linalg.norm(starts, axis=0), []
        for rtol in RTOLS:
            limits = Limits(jnp.asarray(rtol), rtol * size, times, jnp.asarray(1_000_000))
            ends = NativeEngine(method).end_states(equation, starts, limits, until="time")
            errors.append(float(jnp.max(jnp.abs(ends.y - exact) / size[None])))
        slope = np.polyfit(np.log(RTOLS), np.log(errors), 1)[0]
        over = [error / rtol for error, rtol in zip(errors, RTOLS, strict=True)]
        rows.append(
            {"method": type(method).__name__, "problem": name, "over": over, "slope": float(slope)}
        )
    return rows


# --- tables ----------------------------------------------------------------------------------


def markdown(found: Row) -> str:
    """Three tables."""
    names = ["n", "residual", "stop", "undecided", "failed", "plain", "wrong", "contrary"]
    names.append("largest_steps")
    blocks = [["starts", *(name.replace("_", " ") for name in names), "seconds"]]
    for row in found["blocks"]:
        cells = [row["block"], *(str(row[name]) for name in names), f"{row['seconds']:.0f}"]
        blocks.append(cells)
    near = [["engine", "rtol", "wrong", "undecided", "farthest wrong", "… and at the rtol before"]]
    near[0] += ["largest steps"]
    for row in found["wall"]["rows"]:
        gaps = [f"{row[name]:.1e}" for name in ("farthest", "farthest_hidden")]
        counts = [str(row["wrong"]), str(row["undecided"])]
        near.append(
            [row["engine"], f"{row['rtol']:.0e}", *counts, *gaps, str(row["largest_steps"])]
        )
    errors = [["method", "problem", *(f"{rtol:.0e}" for rtol in RTOLS), "slope"]]
    for row in found["tolerances"]:
        over = [f"{x:.2f}" for x in row["over"]]
        errors.append([row["method"], row["problem"], *over, f"{row['slope']:.2f}"])
    edge = found["wall"]
    return "\n\n".join(
        [
            f"`{found['command']}`, {found['date']}, {found['cores']} cores.",
            report.layout(blocks),
            f"{edge['starts']} starts at distances {LARGEST:.0e} … {LEAST:.0e} from the "
            f"separatrix at φ = {edge['edge']} (δ = −1/5, ω⊥ = ω₃ = 1/5):",
            report.layout(near),
            "Largest error after 20 braking times over rtol·|ω₀|:",
            report.layout(errors, text=2),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=1_000_000, help="starts of the first block")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="does everything work?")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.small and args.write:
        parser.error("--small measures nothing that is worth keeping, so it takes no --write")
    n = 5000 if args.small else args.n
    found: Row = {
        "command": measure.command(),
        "seed": args.seed,
        **measure.machine(),
        "tolerances": tolerances(args.small),
        "wall": wall(args.small),
        "blocks": [
            checked(block, n if block == "mixed" else n // 4, args.seed) for block in BLOCKS
        ],
    }
    text = markdown(found)
    print(text)
    if args.write:
        report.keep("stress", text, found)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
