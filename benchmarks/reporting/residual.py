"""How exact is ω∞? Every value and its estimated error against Taylor series in long double.

Numbers: [residual.json](residual.json). Command:

    python -m benchmarks.accuracy.residual --n 200       a look
    python -m benchmarks.accuracy.residual --write       all, kept here

The truth is heyoka's Taylor method in long double, in units that follow the motion, up to a state
where the quadratic formula of ω∞ is exact to rounding (`accuracy/taylor_truth.py`). It shares
nothing with the library except the labels of the starts.

- **known**: residual starts whose ω∞ is given; the error of the others may exceed ω∞.
- **estimate ≤ 1e-05**: share of the residual starts whose estimated error is at most 1e-5·|ω∞|.
- **largest error / estimate**: at most 3 is claimed. **error**: relative, of the known ones.
- **steps**: of the residual starts. With **atol = rtol·|ω₀|** the error of a step is measured by
  the initial |ω₀| instead of the present |ω|, and there is no estimate: the columns show what
  such an error norm costs and loses.
- **time for the estimate**: of the runs from neighbouring starts, over that of the runs themselves.

The error of ω∞ is at most C·rtol·(5|ω∞| + |ω₀||∂ω∞/∂ω₀|) with C = 0.04 + 0.012·steps; this is the
estimate. Each component of the gradient is weighted by the scale of errors in that component of
ω₀, at most |ω₀|. The gradient is infinite where ω∞ changes its sign, so no C bounds the relative
error.
"""

from typing import Any

from benchmarks.reporting.tables import ABSENT, bullets, layout


def body(results: dict[str, Any]) -> str:
    """The result in a sentence, the table, and the command that it came from."""
    run, rows = results["run"], results["rows"]
    known = [row for row in rows if "over" in row]
    total, wrong = (sum(row[name] for row in known) for name in ("n", "wrong signs"))
    said = (
        f"{total} residual starts, rtol {results['rtol']:.0e}: {wrong} wrong signs; "
        f"largest error over its estimate {max(row['over'] for row in known):.2f}."
    )
    command = f"`{run['command']}`, {run['date']}, {run['cores']} cores"
    return f"{said}\n\n{table(rows, results['good'])}\n\n{bullets([command])}"


def table(rows: list[dict[str, Any]], good: float) -> str:
    """A line for each level, amplitude and δ."""
    head = ["level", "\\|ω₀\\|", "δ", "residual", "ω∞ known", f"estimate ≤ {good:.0e}"]
    head += ["largest error / estimate", "wrong signs", "error: median", "98 %", "largest"]
    head += ["steps", "atol = rtol·\\|ω₀\\|: 98 %", "largest", "steps", "time for the estimate"]
    lines = [head]
    for row in rows:
        cells = [row["level"], f"{row['amplitude']:g}", f"{row['delta']:g}", str(row["n"])]
        if "over" not in row:
            lines.append(cells + [ABSENT] * (len(head) - len(cells)))
            continue
        cells += [f"{row['known']:.2%}", f"{row['good']:.1%}", f"{row['over']:.2f}"]
        cells += [str(row["wrong signs"]), *(f"{error:.0e}" for error in row["errors"])]
        cells += [f"{row['steps']:.1f}", *(f"{error:.0e}" for error in row["errors with atol"][1:])]
        lines.append([*cells, f"{row['steps with atol']:.1f}", f"{row['cost'] - 1:.1f}"])
    return layout(lines)
