"""Are `predict` and its estimated error right? Comparison with integration turn by turn.

python -m benchmarks.accuracy.slow_flow --small     a look
python -m benchmarks.accuracy.slow_flow             all: about four minutes of processor time
python -m benchmarks.accuracy.slow_flow --write     the same, kept: results/slow_flow.md
"""

import statistics
from typing import Any

import numpy as np

import dipoletop as dt
from benchmarks.accuracy.turn_by_turn import Predicted, Resolved, compared, differences
from benchmarks.problems import slow_rotations
from benchmarks.problems.random_bodies import directions
from benchmarks.reporting import measure, pages
from dipoletop import Outcome

AMPLITUDES = (1e-2, 3e-3, 1e-3, 3e-4)
BUDGET = 200_000  # largest number of steps of a run
ROUNDING = 1e-9  # smaller differences come from the integration, and have no order
FEW = 12  # least number of pairs of differences for an order
TYPICAL = ((0.6, 0.75, 1.0), (0.0, 0.0, 1.0))  # moments and dipole for the costs
SPEEDS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-15, 1e-25)
RESOLVED_FROM = 1e-5  # least |ω| of `SPEEDS` that is integrated
MANY = 5_000_000  # largest number of steps of such a run
Row = dict[str, Any]


def summed(of: Predicted, runs: Resolved, chosen: np.ndarray) -> Row:
    """Return counts and differences of some motions."""
    ratio, energy = differences(of, runs)
    both = chosen & (of.outcome > 0) & (runs.outcome > 0)
    signs = both & np.isfinite(of.omega_inf) & np.isfinite(runs.omega_inf)
    row: Row = {
        "n": int(chosen.sum()),
        "refused": int(np.sum(chosen & of.refused)),
        "failed": int(np.sum(chosen & (of.outcome == Outcome.FAILED))),
        "labels": int(both.sum()),
        "wrong": int(np.sum(both & (of.outcome != runs.outcome))),
        "signs": int(signs.sum()),
        "wrong signs": int(np.sum(signs & (np.sign(of.omega_inf) != np.sign(runs.omega_inf)))),
    }
    for name, values in (("ratio", ratio), ("energy", energy)):
        known = chosen & np.isfinite(values)
        if known.any():
            over = (values / of.error)[known]
            middle, most = (float(q) for q in np.quantile(values[known], [0.5, 1]))
            row[name] = {"n": int(known.sum()), "median": middle, "largest": most}
            row[name] |= {"over": float(over.max()), "beyond": int(np.sum(over > 1))}
    return row


def on_bodies(small: bool) -> Row:
    """Compare on the chosen bodies, from the same directions at every amplitude."""
    bodies = slow_rotations.chosen(small)
    ways = directions(2 if small else 8, np.random.default_rng(1))
    family = np.repeat(bodies.family, len(ways))
    amplitudes = AMPLITUDES[1:3] if small else AMPLITUDES
    rows, found, signs = [], [], []
    for amplitude in amplitudes:
        sample = bodies.started(amplitude * ways)
        of, runs = compared(sample, BUDGET)
        found.append(differences(of, runs))
        signs.append(_signs(of, runs))
        for name in dict.fromkeys(bodies.family):
            row = {"family": name, "amplitude": amplitude}
            rows.append(row | summed(of, runs, family == name))
    orders = []
    for name in dict.fromkeys(bodies.family):
        values = np.array(found)[:, :, family == name]  # (amplitudes, 2, starts)
        steps = np.log(np.array(amplitudes[:-1]) / amplitudes[1:])[:, None, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.log(values[:-1] / values[1:]) / steps
        slopes = np.where(values[1:] > ROUNDING, slopes, np.nan).swapaxes(0, 1).reshape(2, -1)
        known = [one[np.isfinite(one)] for one in slopes]
        ratio, energy = (float(np.median(one)) if one.size >= FEW else None for one in known)
        orders.append({"family": name, "ratio": ratio, "energy": energy})
    return {"rows": rows, "orders": orders, "signs": np.sum(signs, axis=0).tolist()}


def _signs(of: Predicted, runs: Resolved) -> np.ndarray:
    """Return numbers of residual rotations with a random sense: all, and along the dipole."""
    by_chance = of.sign_by_chance & of.certain & np.isfinite(runs.omega_inf)
    return np.array([by_chance.sum(), np.sum(by_chance & (runs.omega_inf > 0))])


def on_random(n: int) -> Row:
    """Bodies, dipoles, starts and amplitudes at random, and those beyond the estimate."""
    kinds, sample = slow_rotations.at_random(n)
    of, runs = compared(sample, BUDGET)
    ratio, energy = differences(of, runs)
    over = np.fmax(ratio, energy) / of.error
    sizes = {"speed": np.linalg.norm(sample.omega, axis=1), "error": of.error}
    sizes |= {"ratio": ratio / of.error, "energy": energy / of.error}
    beyond = [
        {"kind": kinds[k], "dipole": sample.dipole[k].tolist()}
        | {"moments": np.diag(sample.inertia[k]).tolist()}
        | {name: float(values[k]) for name, values in sizes.items()}
        for k in np.flatnonzero(over > 1)
    ]
    names = np.array(kinds)
    rows = [{"kind": kind} | summed(of, runs, names == kind) for kind in dict.fromkeys(kinds)]
    rows.append({"kind": "all"} | summed(of, runs, names == names))
    known = int(np.isfinite(over).sum())
    about = {"compared": known, "within": known - len(beyond), "signs": _signs(of, runs).tolist()}
    return about | {"rows": rows, "beyond": beyond}


def costs(n: int, slowest: float) -> list[Row]:
    """Measure steps and time of runs, and the time of a prediction, at every amplitude."""
    body = dt.Body(np.diag(TYPICAL[0]), TYPICAL[1])
    equation: Any = dt.SemiReduced(body)
    ways = directions(n, np.random.default_rng(0))
    rows: list[Row] = []

    def predict(*start: Any) -> None:
        dt.predict(*start).ratio.block_until_ready()

    for amplitude in SPEEDS:
        row: Row = {"amplitude": amplitude}
        if amplitude >= slowest:
            dt.classify_many(equation, amplitude * ways, max_steps=1)  # compiled
            runs, clocks = measure.timed(
                dt.classify_many, equation, amplitude * ways, max_steps=MANY
            )
            row |= {"seconds": clocks["seconds"] / n, "steps": float(runs.steps.mean())}
        if amplitude <= 1e-2:
            laps = [measure.timed(predict, body, amplitude * way) for way in ways]
            row["prediction"] = statistics.median(clocks["seconds"] for _, clocks in laps)
        rows.append(row)
    return rows


def measured(small: bool) -> Row:
    """All of it."""
    return {
        "budget": BUDGET,
        "bodies": on_bodies(small),
        "random": on_random(8 if small else 1000),
        "costs": costs(4 if small else 32, 1e-3 if small else RESOLVED_FROM),
    }


if __name__ == "__main__":
    pages.command("slow_flow", measured)
