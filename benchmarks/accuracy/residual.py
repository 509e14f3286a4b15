"""How exact are ω∞ and its estimated error? Every value is compared with `taylor_truth.py`.

Isotropic starts; each row has one δ and one amplitude.

    python -m benchmarks.accuracy.residual --small       a look
    python -m benchmarks.accuracy.residual --write       all; kept: results/residual.md
"""

import statistics
from typing import Any

import numpy as np

import dipoletop as dt
from benchmarks.accuracy.taylor_truth import Truth
from benchmarks.problems.random_bodies import directions
from benchmarks.reporting import measure, pages

LEVELS = ("order-1", "semi")
DELTAS = (-0.9, -0.7, -0.5, -0.3, -0.2, -0.05, 0.01, 0.05, 0.1, 0.3, 0.6, 0.81, 0.9, 0.97)
AMPLITUDES = (1.0, 0.3, 0.1, 0.03, 0.01)
RTOL = 1e-8
GOOD = 1e-5  # largest estimated error, over |ω∞|, that is good enough for a map
MAX_STEPS = 20_000
REPEATS = 3
FEW = 5  # residual starts below which a row is left empty


def row(level: str, delta: float, amplitude: float, n: int) -> dict[str, Any]:
    """One δ and amplitude: errors over their estimates, and the cost of these."""
    rng = np.random.default_rng([0, round(1000 * (1 + delta)), round(1e6 * amplitude)])
    omegas, top = amplitude * directions(n, rng), dt.equation_at(level, delta)

    def run(**settings: Any) -> Any:
        return dt.classify_many(top, omegas, rtol=RTOL, max_steps=MAX_STEPS, **settings)

    labels, fixed = run(), run(value="unchecked", atol=RTOL * amplitude)
    residual = labels.outcome == dt.Outcome.RESIDUAL
    about = {"level": level, "delta": delta, "amplitude": amplitude, "n": int(residual.sum())}
    if about["n"] < FEW:
        return about
    exact = Truth(level)
    truth = np.array([float(exact.residual(delta, omega)) for omega in omegas[residual]])
    value, error = labels.omega_inf[residual], labels.omega_inf_error[residual]
    known = np.isfinite(value) & np.isfinite(truth)
    off = np.abs(value - truth)
    before = np.abs(fixed.omega_inf[residual] / truth - 1)
    good = known & (error <= GOOD * np.abs(truth))
    relative = off[known] / np.abs(truth[known])
    return about | {
        "known": float(known.mean()),
        "good": float(good.mean()),
        "over": float(np.max(off[known] / error[known])),
        "wrong signs": int(np.sum(np.sign(value[known]) != np.sign(truth[known]))),
        "errors": [float(q) for q in np.quantile(relative, [0.5, 0.98, 1])],
        "errors with atol": [float(q) for q in np.nanquantile(before, [0.5, 0.98, 1])],
        "steps": float(labels.steps[residual].mean()),
        "steps with atol": float(fixed.steps[residual].mean()),
        "cost": _cost(run),
    }


def _cost(run: Any) -> float:
    """Return the time with over the time without an estimate: the median of interleaved ratios."""
    ratios = []
    for _ in range(REPEATS):
        estimated, plain = (
            measure.timed(run, value=value)[1]["seconds"] for value in (True, "unchecked")
        )
        ratios.append(estimated / plain)
    return statistics.median(ratios)


def measured(small: bool) -> dict[str, Any]:
    """A row for each level, amplitude and δ."""
    rows = [
        row(level, delta, amplitude, 40 if small else 1000)
        for level in LEVELS
        for amplitude in (AMPLITUDES[::2] if small else AMPLITUDES)
        for delta in (DELTAS[::3] if small else DELTAS)
        if level != "order-1" or delta > -0.5  # below it all stop
    ]
    return {"rtol": RTOL, "good": GOOD, "rows": rows}


if __name__ == "__main__":
    pages.command("residual", measured)
