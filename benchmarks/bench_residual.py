"""How exact ω∞ is, and whether its estimated error says so: every value against `truth.py`.

Isotropic starts at one δ and amplitude a row. How it is judged is in README.md.

    python benchmarks/bench_residual.py --n 200          a look
    python benchmarks/bench_residual.py --write          all; kept: README.md, results/
    python benchmarks/bench_residual.py --digits         the values that the tests are held to
"""

import argparse
import statistics
import time
from typing import Any

import jax
import numpy as np

import dipoletop as dt
import measure
import report
from dipoletop.equations.levels import equation
from tables import layout
from truth import Truth

LEVELS = ("order-1", "semi")
DELTAS = (-0.9, -0.7, -0.5, -0.3, -0.2, -0.05, 0.01, 0.05, 0.1, 0.3, 0.6, 0.81, 0.9, 0.97)
AMPLITUDES = (1.0, 0.3, 0.1, 0.03, 0.01)
RTOL = 1e-8
GOOD = 1e-5  # of |ω∞|: an estimate that is good for a map
MAX_STEPS = 20_000
REPEATS = 3
FEW = 5  # residual starts below which a row says nothing
DIGITS = (  # level, δ, start: few turns and many, near zeros of ω∞ and far from them
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
    """Isotropic starts, shape (n, 3)."""
    key = [seed, round(1000 * (1 + delta)), round(1e6 * amplitude)]
    ways = np.random.default_rng(key).normal(size=(n, 3))
    return amplitude * ways / np.linalg.norm(ways, axis=1)[:, None]


def row(level: str, delta: float, amplitude: float, n: int, seed: int) -> dict[str, Any]:
    """One δ and amplitude: errors over their estimates, and what they cost."""
    omegas, top = starts(n, delta, amplitude, seed), equation(level, delta)

    def run(**settings: Any) -> Any:
        return dt.classify_many(top, omegas, rtol=RTOL, max_steps=MAX_STEPS, **settings)

    found, fixed = run(), run(value="unchecked", atol=RTOL * amplitude)
    residual = found.outcome == dt.Outcome.RESIDUAL
    if residual.sum() < FEW:
        return {"level": level, "delta": delta, "amplitude": amplitude, "n": int(residual.sum())}
    exact = Truth(level)
    truth = np.array([float(exact.residual(delta, omega)) for omega in omegas[residual]])
    value, error = found.omega_inf[residual], found.omega_inf_error[residual]
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
        "steps": float(found.steps[residual].mean()),
        "steps with atol": float(fixed.steps[residual].mean()),
        "cost": _cost(run),
    }


def _cost(run: Any) -> float:
    """The time with an estimate over that without: the median of ratios side by side."""
    ratios = []
    for _ in range(REPEATS):
        clocks = []
        for value in (True, "unchecked"):
            began = time.perf_counter()
            run(value=value)
            clocks.append(time.perf_counter() - began)
        ratios.append(clocks[0] / clocks[1])
    return statistics.median(ratios)


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table."""
    table = [["level", "\\|ω₀\\|", "δ", "residual", "ω∞ known", f"estimate ≤ {GOOD:.0e}"]]
    table[0] += ["largest error / estimate", "wrong signs", "error: median", "98 %", "largest"]
    table[0] += ["steps", "atol = rtol·\\|ω₀\\|: 98 %", "largest", "steps", "time for the estimate"]
    for r in rows:
        cells = [r["level"], f"{r['amplitude']:g}", f"{r['delta']:g}", str(r["n"])]
        if "over" not in r:
            table.append(cells + ["—"] * (len(table[0]) - len(cells)))
            continue
        cells += [f"{r['known']:.2%}", f"{r['good']:.1%}", f"{r['over']:.2f}"]
        cells += [str(r["wrong signs"]), *(f"{e:.0e}" for e in r["errors"]), f"{r['steps']:.1f}"]
        cells += [f"{e:.0e}" for e in r["errors with atol"][1:]]
        cells += [f"{r['steps with atol']:.1f}", f"{r['cost'] - 1:.1f}"]
        table.append(cells)
    return layout(table, text=1)


def summary(rows: list[dict[str, Any]]) -> str:
    """The table, and what is to be learned from it."""
    full = [r for r in rows if "over" in r]
    total = sum(r["n"] for r in full)
    said = (
        f"{measure.this_run()}. {total} residual starts, rtol {RTOL:.0e}: "
        f"{sum(r['wrong signs'] for r in full)} wrong signs; largest error over its estimate "
        f"{max(r['over'] for r in full):.2f}."
    )
    return f"{said}\n\n{markdown(rows)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
        if level != "order-1" or delta > -0.5  # else all stop
    ]
    print(summary(rows))
    if args.write:
        report.keep("residual", summary(rows), {"run": measure.machine(), "rows": rows})


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
