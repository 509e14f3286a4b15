"""The results of `bench_gradients` as tables."""

from typing import Any

from tables import ABSENT, Table, layout, number, per_start

CLOCKS = ("seconds", "processor_seconds")


def gradients(found: dict[str, Any]) -> str:
    """What derivatives cost, and their errors."""
    starts = found["sweeps"][0]["starts"]
    title = f"### Derivatives in sweeps: mixed basin, {starts} starts, rtol {found['rtol']:.0e}"
    parts = [title, layout(_sweeps(found["sweeps"]), text=2)]
    parts += ["### Derivatives of one start, rtol 1e-10", layout(_single(found["single"]), text=2)]
    parts += [f"### Over many turns: {found['turns'][0]['starts']} starts of a general body"]
    parts += [
        layout(_turns(found["turns"])),
        "### Temporary memory of a gradient by δ",
        layout(_memory(found["memory"])),
    ]
    return "\n\n".join(parts + _end(found["end"]))


def _sweeps(rows: list[dict[str, Any]]) -> Table:
    head = ["level", "engine", "derivatives", "µs/start, wall / processor"]
    head += ["× plain, wall / processor", "steps/start", "a step × plain, processor"]
    head += ["median error", "99 % error", "residual, but none", "undecided", "labels that differ"]
    table = [[*head, "first sweep, s"]]
    for row in rows:
        errors = [f"{row[k]:.1e}" for k in ("median_error", "high_error")]
        counts = [str(row[k]) for k in ("missing", "undecided", "differ")]
        table.append(
            [
                *(row["level"], row["engine"], str(row["derivatives"])),
                " / ".join(number(per_start(row, clock)) for clock in CLOCKS),
                " / ".join(number(row["over_plain"][clock]) for clock in CLOCKS),
                *(f"{row['steps']:.1f}", number(row["step_over_plain"])),
                *(*errors, *counts, number(row["first_seconds"])),
            ]
        )
    return table


def _single(rows: list[dict[str, Any]]) -> Table:
    head = ["level", "", "µs, wall, min / median", "µs, processor, median"]
    table = [[*head, "× ω∞, processor", "error", "compiled in, s"]]
    for row in rows:
        wall = " / ".join(number(per_start(row, "seconds", w)) for w in ("min", "median"))
        costs = [wall, number(per_start(row, "processor_seconds")), number(row["over_plain"])]
        compiled = number(row["compile_seconds"])
        table.append([row["of"], row["name"], *costs, f"{row['error']:.1e}", compiled])
    return table


def _turns(rows: list[dict[str, Any]]) -> Table:
    head = ["\\|d\\|²", "rtol", "steps/start, plain / by a"]
    table = [[*head, "error of ω∞, median / largest", "of ∂ω∞/∂a, median / largest"]]
    for row in rows:
        steps = " / ".join(f"{count:.0f}" for count in row["steps"])
        errors = [" / ".join(f"{e:.1e}" for e in row["errors"][k]) for k in ("value", "slope")]
        table.append([f"{row['strength']:g}", f"{row['rtol']:.0e}", steps, *errors])
    return table


def _memory(rows: list[dict[str, Any]]) -> Table:
    table = [["of", "max_steps", "bytes", "steps of runs that it did", "compiled in, s"]]
    for row in rows:
        served = ", ".join(map(str, row["steps"])) or ABSENT
        sizes = [str(row["max_steps"]), str(row["bytes"])]
        table.append([row["name"], *sizes, served, number(row["compile_seconds"])])
    return table


def _end(rows: list[dict[str, Any]]) -> list[str]:
    head = ["`simulate` to τ = 1000", "starts", "compiled and run once, s"]
    table = [[*head, "µs/start, wall, min / median", "× the end state"]]
    for row in rows:
        wall = " / ".join(number(per_start(row, "seconds", w)) for w in ("min", "median"))
        first, over = number(row["first_seconds"]), number(row["over_plain"])
        table.append([row["name"], str(row["starts"]), first, wall, over])
    apart = max(row["apart"] for row in rows)
    said = f"Derivatives by δ forwards and backwards differ by {apart:.0e} of the largest."
    return ["### Derivatives of an end state, rtol 1e-10", layout(table), said]
