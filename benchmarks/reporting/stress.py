"""Where it is hard: a million starts, the separatrix, every tolerance.

Numbers: [stress.json](stress.json). Command, about ten minutes on one core:

    python -m benchmarks.accuracy.stress --small     a look
    python -m benchmarks.accuracy.stress --write     all, kept here

A million and a half starts are labelled, and integrated on without certificates; 800 starts stand
at the separatrix; errors are compared with the tolerance at every stage of braking.

- **plain**: starts whose long integration came to a plain end, to compare with. **contrary**:
  labels that theory excludes (a stop at δ > 0, residual rotation at δ ≤ −1/2).
- **farthest wrong**: distance in φ from the separatrix of the farthest start with a wrong label;
  the next column takes only those whose label was the same at the tolerance before, so that
  comparing two tolerances does not show the error.
"""

from typing import Any

from benchmarks.reporting.tables import bullets, layout


def body(results: dict[str, Any]) -> str:
    """Three tables, and the command that they came from."""
    wall, span = results["wall"], results["span"]
    cores = f"{results['cores']} core" + "s" * (results["cores"] > 1)
    return "\n\n".join(
        [
            _blocks(results["blocks"]),
            f"{wall['starts']} starts at distances {span[1]:.0e} … {span[0]:.0e} from the "
            f"separatrix at φ = {wall['edge']} (δ = −1/5, ω⊥ = ω₃ = 1/5):",
            _wall(wall["rows"]),
            "Largest error after 20 braking times over rtol·|ω₀|:",
            _tolerances(results["tolerances"], results["rtols"]),
            bullets([f"`{results['command']}`, {results['date']}, {cores}"]),
        ]
    )


def _blocks(rows: list[dict[str, Any]]) -> str:
    names = ["n", "residual", "stop", "undecided", "failed", "plain", "wrong", "contrary"]
    names.append("largest_steps")
    lines = [["starts", *(name.replace("_", " ") for name in names), "seconds"]]
    for row in rows:
        cells = [row["block"], *(str(row[name]) for name in names), f"{row['seconds']:.0f}"]
        lines.append(cells)
    return layout(lines)


def _wall(rows: list[dict[str, Any]]) -> str:
    lines = [["engine", "rtol", "wrong", "undecided", "farthest wrong", "… and at the rtol before"]]
    lines[0] += ["largest steps"]
    for row in rows:
        gaps = [f"{row[name]:.1e}" for name in ("farthest", "farthest_hidden")]
        counts = [str(row["wrong"]), str(row["undecided"])]
        about = [row["engine"], f"{row['rtol']:.0e}"]
        lines.append([*about, *counts, *gaps, str(row["largest_steps"])])
    return layout(lines)


def _tolerances(rows: list[dict[str, Any]], rtols: list[float]) -> str:
    lines = [["method", "problem", *(f"{rtol:.0e}" for rtol in rtols), "slope"]]
    for row in rows:
        over = [f"{ratio:.2f}" for ratio in row["over"]]
        lines.append([row["method"], row["problem"], *over, f"{row['slope']:.2f}"])
    return layout(lines, text=2)
