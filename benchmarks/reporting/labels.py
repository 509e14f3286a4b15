"""Are the labels right? Every verdict against long integration without verdicts.

Numbers: [labels.json](labels.json). Command:

    python -m benchmarks.accuracy.labels --n 300 --families closed       a look
    python -m benchmarks.accuracy.labels --jobs 16 --into rows.jsonl     all; a line for each piece
    python -m benchmarks.accuracy.labels --merge rows.jsonl --write      kept here

Random starts are labelled. The run goes on from the state in which the verdict fell, with the same
equation and without any verdict, until its end is plain to see (`accuracy/long_runs.py`).

- Family `closed`: `TransverseReduced` and `TransverseSemi`, δ uniform in (−0.98, 0.98). The others
  are bodies given by tensor and dipole (`Reduced`, `SemiReduced`), in axes rotated at random.
  Directions are isotropic, amplitudes |d|²|Ω|√tr(I⁻²) log-uniform in 0.01 … 1, from order 2 on up
  to 0.2.
- **plain**: decided runs whose end was plain within the budget. Only these are compared. A small
  |Ω| alone never counts as a stop; the conditions are in `Settling` and `compare`.
- **WRONG**: plain, and not as labelled. **certified**: share of the decided runs.
- **Δω∞ over its estimate**: the difference of ω∞, given with the label, from the long run, over the
  error estimated with it; the largest of certified and of other labels. Above 1 the estimate is too
  small, and the next column gives the largest relative error among those. ω∞ is taken where the
  outcome is decided, which is long before ω∞ is settled. **steps**: until the label, the mean.
"""

from typing import Any

from benchmarks.reporting.tables import bullets, layout


def body(results: dict[str, Any]) -> str:
    """How many labels are right, the table, and the commands that it came from."""
    rows = results["rows"]
    runs = [f"`{run['command']}`, {run['date']}, {run['cores']} cores" for run in results["runs"]]
    plain, wrong = (sum(row[name] for row in rows) for name in ("plain", "wrong"))
    return f"{plain} labels checked, {wrong} wrong.\n\n{table(rows)}\n\n{bullets(runs)}"


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each level and family."""
    head = ["level", "family", "N", "residual", "stop: rotating", "wobbling", "other"]
    head += ["undecided", "failed", "certified", "plain", "WRONG"]
    head += ["Δω∞ over its estimate, certified / tested", "largest Δω∞/ω∞ beyond", "steps"]
    lines = [head]
    for row in rows:
        stops = [row[f"stop_{kind}"] for kind in ("rotating", "wobbling", "other")]
        cells = [row["level"], row["family"], row["n"], row["residual"], *stops]
        decided = max(row["residual"] + sum(stops), 1)
        cells += [row["undecided"], row["failed"], f"{row['certified'] / decided:.1%}"]
        cells += [row["plain"], row["wrong"]]
        cells.append(f"{row['over_certified']:.2f} / {row['over_tested']:.2f}")
        cells.append(f"{row['beyond_certified']:.1e} / {row['beyond_tested']:.1e}")
        lines.append([*map(str, cells), f"{row['steps'] / row['n']:.0f}"])
    return layout(lines, text=2)
