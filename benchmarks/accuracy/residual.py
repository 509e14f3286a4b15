"""How exact are ω∞ and its estimated error? Every value is compared with `taylor_truth.py`.

Isotropic starts; each row has one δ and one amplitude.

    python -m benchmarks.accuracy.residual --n 200       a look
    python -m benchmarks.accuracy.residual --write       all; kept: results/residual.md
    python -m benchmarks.accuracy.residual --digits      the values that the tests compare with
"""

import argparse
import statistics
from functools import partial
from typing import Any

import jax
import numpy as np

import dipoletop as dt
from benchmarks.accuracy.taylor_truth import Truth
from benchmarks.reporting import measure, pages
from benchmarks.reporting import residual as page

LEVELS = ("order-1", "semi")
DELTAS = (-0.9, -0.7, -0.5, -0.3, -0.2, -0.05, 0.01, 0.05, 0.1, 0.3, 0.6, 0.81, 0.9, 0.97)
AMPLITUDES = (1.0, 0.3, 0.1, 0.03, 0.01)
RTOL = 1e-8
GOOD = 1e-5  # largest estimated error, over |ω∞|, that is good enough for a map
MAX_STEPS = 20_000
REPEATS = 3
FEW = 5  # least number of residual starts for a row
DIGITS = (  # level, δ, start: few rotations and many, near zeros of ω∞ and far from them
    ("order-1", 0.05, (0.0075448639831482275, 0.030977464484466803, -0.29830097505973624)),
    ("order-1", -0.3, (0.25, 0.12, 0.05)),
    ("order-1", 0.1, (0.02, 0.03, 0.28)),
    ("order-1", 0.3, (-0.004, 0.01, 0.027)),
    ("order-1", 0.81, (0.01, -0.02, 0.3)),
    ("order-1", 0.97, (0.3, 0.8, -0.5)),
    ("semi", -0.9, (0.28, 0.05, 0.02)),
    ("semi", -0.2, (0.2, 0.1, -0.1)),
    ("semi", 0.05, (0.01, -0.04, 0.29)),
    ("semi", 0.3, (0.004, 0.01, 0.027)),
    ("semi", 0.6, (-0.1, 0.2, 0.2)),
    ("semi", 0.9, (0.2, 0.01, 0.1)),
)


def starts(n: int, delta: float, amplitude: float, seed: int) -> np.ndarray:
    """Return isotropic starts, shape (n, 3)."""
    key = [seed, round(1000 * (1 + delta)), round(1e6 * amplitude)]
    ways = np.random.default_rng(key).normal(size=(n, 3))
    return amplitude * ways / np.linalg.norm(ways, axis=1)[:, None]


def row(level: str, delta: float, amplitude: float, n: int, seed: int) -> dict[str, Any]:
    """Return for one δ and amplitude the errors over their estimates, and the estimates' cost."""
    omegas, top = starts(n, delta, amplitude, seed), dt.equation_at(level, delta)

    def run(**settings: Any) -> Any:
        return dt.classify_many(top, omegas, rtol=RTOL, max_steps=MAX_STEPS, **settings)

    labels, fixed = run(), run(value="unchecked", atol=RTOL * amplitude)
    residual = labels.outcome == dt.Outcome.RESIDUAL
    if residual.sum() < FEW:
        return {"level": level, "delta": delta, "amplitude": amplitude, "n": int(residual.sum())}
    exact = Truth(level)
    truth = np.array([float(exact.residual(delta, omega)) for omega in omegas[residual]])
    value, error = labels.omega_inf[residual], labels.omega_inf_error[residual]
    known = np.isfinite(value) & np.isfinite(truth)
    off = np.abs(value - truth)
    before = np.abs(fixed.omega_inf[residual] / truth - 1)
    good = known & (error <= GOOD * np.abs(truth))
    relative = off[known] / np.abs(truth[known])
    return {
        "level": level,
        "delta": delta,
        "amplitude": amplitude,
        "n": int(residual.sum()),
        "truth unknown": int(np.sum(np.isnan(truth))),
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
            measure.timed(partial(run, value=value))[1]["seconds"] for value in (True, "unchecked")
        )
        ratios.append(estimated / plain)
    return statistics.median(ratios)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, default=1000, help="starts of each row")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=list(LEVELS))
    parser.add_argument("--amplitudes", nargs="+", type=float, default=list(AMPLITUDES))
    parser.add_argument("--deltas", nargs="+", type=float, default=list(DELTAS))
    parser.add_argument("--digits", action="store_true", help="print reference values instead")
    parser.add_argument("--write", action="store_true", help="keep the results")
    args = parser.parse_args()
    if args.digits:
        for level, delta, omega0 in DIGITS:
            value = Truth(level).residual(delta, omega0)
            print(f'("{level}", {delta}, {omega0}, {np.format_float_scientific(value, 16)}),')
        return
    rows = [
        row(level, delta, amplitude, args.n, args.seed)
        for level in args.levels
        for amplitude in args.amplitudes
        for delta in args.deltas
        if level != "order-1" or delta > -0.5  # at smaller δ all stop
    ]
    run = {"command": measure.command(), **measure.machine()}
    numbers = {"run": run, "rtol": RTOL, "good": GOOD, "rows": rows}
    print(page.table(rows, GOOD))
    if args.write:
        pages.save("residual", numbers)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
