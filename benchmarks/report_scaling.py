"""The results of `bench_scaling` and `bench_savings` as tables."""

from typing import Any

from tables import ABSENT, Table, layout, megabytes, number, per_start


def scaling(found: dict[str, Any]) -> str:
    """How the cost grows."""
    tolerance = f"rtol {found['rtol']:.0e}"
    limits = f"{tolerance}, at most {found['budget']} steps, all cores"
    titles = {
        "amplitude": f"Cost against amplitude, {limits}",
        "shape": f"Cost against shape, amplitude 0.1, {limits}",
        "batch": f"Cost against the size of the batch: mixed basin, {tolerance}, all cores",
        "cores": f"Cost against cores: mixed basin, {tolerance}, fresh processes",
    }
    parts = []
    for scene, title in titles.items():
        table = layout(_costs(found[scene])) if found[scene] else "Not measured on this system."
        parts += [f"### {title}", table]
    parts += ["### Memory of one sweep of the default map, with residual values, fresh processes"]
    parts += [layout(_memory(found["memory"]))]
    return "\n\n".join(parts)


def _costs(rows: list[dict[str, Any]]) -> Table:
    """A line for each sample, a column for each peer; the steps are those of the first."""
    names = list(dict.fromkeys(row["name"] for row in rows))
    head = ["", "starts", "steps/start", "right-hand sides/start", "undecided, of each"]
    table = [[*head, "labels that differ", *(f"{n}: µs/start, wall / processor" for n in names)]]
    for at in dict.fromkeys(row["at"] for row in rows):
        peers = {row["name"]: row for row in rows if row["at"] == at}
        first = peers[names[0]]
        every = [peers.get(name) for name in names]
        counts = [number(first["steps"]), number(first["evaluations"])]
        both = [
            " / ".join(ABSENT if row is None else str(row[key]) for row in group)
            for key, group in (("undecided", every), ("differ_from_ours", every[1:]))
        ]
        clocks = [ABSENT if row is None else _clocks(row) for row in every]
        table.append([at, str(first["starts"]), *counts, *both, *clocks])
    return table


def _clocks(row: dict[str, Any]) -> str:
    return " / ".join(number(per_start(row, c)) for c in ("seconds", "processor_seconds"))


def _memory(rows: list[dict[str, Any]]) -> Table:
    head = ["starts", "engine", "result", "peak, MB", "after import, MB", "first sweep, s"]
    table = [head]
    for row in rows:
        place = "on the disk" if row["stored"] else "in memory"
        sizes = [megabytes(row[name]) for name in ("peak_bytes", "import_bytes")]
        starts = f"{row['points']} × {row['points']}"
        table.append([starts, row["engine"], place, *sizes, number(row["seconds"])])
    return table


def savings(found: dict[str, Any]) -> str:
    """What each saving saves, and the cheapest method."""
    head = ["saving", "steps with", "without", "right-hand sides with", "without", "×"]
    table = [[*head, "without it"]]
    for row in found["rows"]:
        counts = [row[w][what] for what in ("steps", "evaluations") for w in ("with", "without")]
        factor = number(counts[3] / counts[2])
        table.append([row["name"], *map(str, counts), factor, row["note"]])
    title = f"### What is saved: mixed basin, {found['starts']} starts, rtol {found['rtol']:.0e}"
    return "\n\n".join([title, layout(table), *_methods(found["methods"])])


def _methods(found: dict[str, Any]) -> list[str]:
    title = f"### Right-hand sides for each of {found['starts']} starts to τ = 1000, by method"
    crossings = found["evaluations_at_error"]
    table = [["median true error", *crossings]]
    for k, error in enumerate(found["errors"]):
        costs = [ABSENT if row[k] is None else number(row[k]) for row in crossings.values()]
        table.append([f"{error:.0e}", *costs])
    every = [["", "rtol", "largest error", "median error", "steps", "right-hand sides"]]
    for row in found["rows"]:
        errors = [f"{row[name]:.1e}" for name in ("largest_error", "median_error")]
        made = [number(row[name]) for name in ("steps", "evaluations")]
        every.append([row["solver"], f"{row['rtol']:.0e}", *errors, *made])
    return [title, layout(table), "At each tolerance:", layout(every)]
