"""How the cost grows: with amplitude, shape, batch, cores and memory.

Numbers: [speed.json](speed.json). Command: `python benchmarks/run.py --write`.

Classification by both engines and by diffrax, repacked (see [speed](speed.md)), per start. A step
of Dopri8 takes 13 right-hand sides, and each start two more (diffrax, which starts again after
each round, takes a few more).

- **Amplitude**: isotropic starts with |ω| = 1 … 1e-4. At δ = −0.2 nearly all of them are decided
  at once when |ω| is small; at δ = 0.3 steps grow like 1/|ω|. At most 100 000 steps; what is then
  still undecided is counted. 512 of the 16384 starts below 0.01; diffrax down to 1e-3.
- **Shape**: δ = −0.9 … 0.9 at |ω| = 0.1. The regions that the peers share hold for δ > −1/2, so
  diffrax takes part there only.
- **Batch**: 1 … a million starts of the mixed basin in one call.
- **Cores**: the mixed basin in a fresh process that may use one core, and in one that may use all
  (`os.sched_setaffinity` before it starts). These are not interleaved with each other.
- **Memory**: one sweep of the default map from 64 × 64 to 1024 × 1024 starts (`--large`: 2048²),
  each in a fresh process; once with `store=`, so that the result is on the disk. What the
  smallest map takes is compilation.
"""

from typing import Any

from benchmarks.reporting.speed import machine
from benchmarks.reporting.tables import ABSENT, Table, both_clocks, layout, megabytes, number


def body(results: dict[str, Any]) -> str:
    """All tables of this page."""
    return f"{machine(results)}\n\n{_tables(results['scaling'])}"


def _tables(scenes: dict[str, Any]) -> str:
    """A table for each scene, and that of the memory."""
    tolerance = f"rtol {scenes['rtol']:.0e}"
    limits = f"{tolerance}, at most {scenes['budget']} steps, all cores"
    titles = {
        "amplitude": f"Cost against amplitude, {limits}",
        "shape": f"Cost against shape, amplitude 0.1, {limits}",
        "batch": f"Cost against the size of the batch: mixed basin, {tolerance}, all cores",
        "cores": f"Cost against cores: mixed basin, {tolerance}, fresh processes",
    }
    parts = []
    for scene, title in titles.items():
        table = layout(_costs(scenes[scene])) if scenes[scene] else "Not measured on this system."
        parts += [f"## {title}", table]
    parts += ["## Memory of one sweep of the default map, with residual values, fresh processes"]
    parts += [layout(_memory(scenes["memory"]))]
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
        clocks = [ABSENT if row is None else both_clocks(row) for row in every]
        table.append([at, str(first["starts"]), *counts, *both, *clocks])
    return table


def _memory(rows: list[dict[str, Any]]) -> Table:
    table = [["starts", "engine", "result", "peak, MB", "after import, MB", "first sweep, s"]]
    for row in rows:
        place = "on the disk" if row["stored"] else "in memory"
        sizes = [megabytes(row[name]) for name in ("peak_bytes", "import_bytes")]
        starts = f"{row['points']} × {row['points']}"
        table.append([starts, row["engine"], place, *sizes, number(row["seconds"])])
    return table
