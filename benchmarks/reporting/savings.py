"""What is saved: steps and right-hand sides with and without each saving.

Numbers: [speed.json](speed.json). Command: `python benchmarks/run.py --write`.

Counts, no clock: every machine finds the same but for rounding.

- **One symmetry cell**, not the whole plane of φ and ω₃; the labels of both are compared.
- **End when the outcome is certain**, or when ω∞ is known, against all starts going on to one late
  time, by when 90 % and 99 % of them have their value. Starts undecided even there are counted.
- **No step if decided**, for the starts that lie in a deciding region already; **exact values** on
  invariant sets, which a random sample never meets.
- **Outcomes only**, against outcomes with ω∞.
- **Lanes refilled**, against blocks in lockstep: lane steps paid for, idle lanes included, blocks
  of the engine's own width in the order given, sorted by |ω|, and one block of all starts.
- **No dense output**: calls of the right-hand side that diffrax makes for one start, counted by a
  callback. Its Dopri8 interpolates from the slopes that it has, so only memory is saved.
- **The method**: right-hand sides for a true error at τ = 1000 with Bosh3, Tsit5, Dopri5 and Dopri8
  in the native engine, tolerances 1e-3 … 1e-12. The first table interpolates between these by power
  laws; a dash is beyond them.
"""

from typing import Any

from benchmarks.reporting.speed import machine
from benchmarks.reporting.tables import ABSENT, layout, number


def body(results: dict[str, Any]) -> str:
    """All tables of this page."""
    return f"{machine(results)}\n\n{_tables(results['savings'])}"


def _tables(counted: dict[str, Any]) -> str:
    """What each saving saves, and the cheapest method."""
    head = ["saving", "steps with", "without", "right-hand sides with", "without", "×"]
    table = [[*head, "without it"]]
    for row in counted["rows"]:
        counts = [row[w][what] for what in ("steps", "evaluations") for w in ("with", "without")]
        factor = number(counts[3] / counts[2])
        table.append([row["name"], *map(str, counts), factor, row["note"]])
    title = f"## What is saved: mixed basin, {counted['starts']} starts, rtol {counted['rtol']:.0e}"
    return "\n\n".join([title, layout(table), *_methods(counted["methods"])])


def _methods(compared: dict[str, Any]) -> list[str]:
    title = f"## Right-hand sides for each of {compared['starts']} starts to τ = 1000, by method"
    crossings = compared["evaluations_at_error"]
    table = [["median true error", *crossings]]
    for k, error in enumerate(compared["errors"]):
        costs = [ABSENT if row[k] is None else number(row[k]) for row in crossings.values()]
        table.append([f"{error:.0e}", *costs])
    every = [["", "rtol", "largest error", "median error", "steps", "right-hand sides"]]
    for row in compared["rows"]:
        errors = [f"{row[name]:.1e}" for name in ("largest_error", "median_error")]
        made = [number(row[name]) for name in ("steps", "evaluations")]
        every.append([row["solver"], f"{row['rtol']:.0e}", *errors, *made])
    return [title, layout(table), "At each tolerance:", layout(every)]
