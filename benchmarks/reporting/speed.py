"""Speed: outcomes, the default map, compilation, importing.

Numbers: [speed.json](speed.json). Command: `python benchmarks/run.py --write`.

**Mixed basin** (`problems/mixed_basin.py`): tops with a transverse dipole, equations (4.2)–(4.4),
δ uniform in (−0.45, 0.45), |ω| log-uniform in 0.05 … 1, isotropic directions. A run goes on until
its outcome is certain, for at most 4096 steps. Everybody gets the same starts, the same tolerance
(rtol = 1e-8, atol = rtol·|ω₀|), the same regions that decide the outcome, and all cores.

| who | driven how |
|---|---|
| dipoletop, native engine | `classify_many(TransverseReduced(deltas), omegas, value=False)` |
| dipoletop, JAX engine | the same with `engine="jax"`, as it runs without llvmlite |
| heyoka | Taylor method in SIMD batches, one process for each core; between rounds of a few steps a vectorised certificate, and the undecided starts are packed together (`peers/with_heyoka.py`) |
| diffrax, repacked | Dopri8 with an event, a few steps at a time; finished starts are dropped in between (`peers/with_diffrax.py`) |
| diffrax, chunked | the same, starts sorted by \\|ω\\|, one `vmap` for every 32 |
| diffrax, whole | one `vmap` over all starts, as one would write it first; the state is a tuple of scalars or an array of shape (3,) |
| scipy | DOP853 at rtol = 1e-12, one start after another: the labels to compare with |

"Whole" is measured once, on fewer starts. All lanes wait for the slowest, so its cost for each
start grows with the number of starts, and the ratio in the table is a lower bound.

heyoka's steps are of another kind (Taylor, order about 20): compare steps only among the others.
A few starts with δ near 0 spin almost along the axis and are decided only at τ beyond 1e20, or not
within 4096 steps. diffrax needs a last time (1e30) and leaves some of them undecided, so read the
labels that differ together with the column "undecided". The JAX engine steps a block of lanes
together: at N = 4096 a start that uses up its 4096 steps is a good part of the whole cost.

**The default map**: `dt.sweep` over one symmetry cell (φ, ω₃) at δ = −1/5, ω⊥ = 0.2, with ω∞ to the
tolerance, at order 1 and at the semi-reduced level, with each engine, each in a fresh process.
Memory is the largest resident memory of that process.

**Programs compiled** in a second call of `sweep`, `classify_many`, `classify` and `simulate` when
δ, starts, times and tolerance change: JAX's monitoring counts them, and the native engine reports
its own to it.
"""

from typing import Any

from benchmarks.reporting.tables import CLOCKS, Table, layout, megabytes, number, pair, per_start

OURS = "dipoletop, native engine"
BASE = "import jax, diffrax, equinox"
COLD_BASE = "import jax, diffrax, equinox, matplotlib.pyplot, xarray, zarr"
FRESH = {
    "native": OURS,
    "jax": "dipoletop, JAX engine",
    "heyoka": "heyoka batch",
    "diffrax": "diffrax vmap repacked, tuple",
}
"""The integrators of `speed.fresh_outcomes`."""
FIRST_MAP, LATER_MAP = "dipoletop map, the first time ever", "dipoletop map, later"


def body(results: dict[str, Any]) -> str:
    """All tables of this page."""
    parts = [machine(results), _basin(results["basin"]), _maps(results["maps"])]
    parts += [_compilations(results["maps"]), _import(results["import"])]
    if "cold_start" in results:  # older numbers are without
        parts.append(_cold_start(results["cold_start"]))
    if "fresh_outcomes" in results:
        parts.append(_fresh_outcomes(results["fresh_outcomes"]))
    return "\n\n".join(parts)


def machine(results: dict[str, Any]) -> str:
    """Date, processor, versions and load of the run."""
    about = results["machine"]
    versions = ", ".join(f"{name} {value}" for name, value in about["versions"].items())
    busy = " and ".join("unknown" if x is None else f"{x:.1f}" for x in results["load"])
    return (
        f"{about['date']}; {about['processor']}, {about['cores']} cores; "
        f"{about['system']}; {versions}. "
        f"Load average before and after (this run's own work included): {busy}."
    )


def _basin(scene: dict[str, Any]) -> str:
    parts = [f"## Mixed basin, rtol {scene['rtol']:.0e}, all cores"]
    for size, table in scene["tables"].items():
        parts += [f"N = {size}:", layout(_basin_table(table["rows"]))]
        parts += [_efficiency(lanes) for lanes in table["lanes"]]
    truth = scene["truth"]
    parts.append(
        f"{truth['note']}: {number(truth['microseconds'])} µs and {truth['steps']:.1f} steps for "
        f"each of {truth['starts']} starts, at rtol 1e-12."
    )
    return "\n\n".join(parts + [line + "." for line in scene["missing"]])


def _efficiency(lanes: dict[str, Any]) -> str:
    blocks = zip(lanes["block_steps"], lanes["widths"], strict=True)
    steps = " and ".join(f"{count} steps of {width} lanes" for count, width in blocks if width)
    return (
        f"Lane efficiency of the {lanes['engine']} engine: {lanes['efficiency']:.1%} "
        f"({lanes['lane_steps']} lane steps in {steps})."
    )


def _basin_table(rows: list[dict[str, Any]]) -> Table:
    ours = next(row for row in rows if row["name"] == OURS)
    head = ["", "starts × repeats", "wall s, min / median", "processor s, min / median"]
    head += ["µs/start, wall / processor", "× the first, wall / processor", "before it is warm, s"]
    head += ["steps/start", "undecided", "differ from the first", "differ from scipy"]
    table = [head]
    for row in rows:
        clocks = [pair(row[clock].values()) for clock in CLOCKS]  # minimum and median
        clocks.append(pair(per_start(row, clock) for clock in CLOCKS))
        clocks.append(pair(per_start(row, clock) / per_start(ours, clock) for clock in CLOCKS))
        counts = [f"{row['steps']:.1f}", str(row["undecided"]), str(row["differ_from_ours"])]
        counts.append(f"{row['differ_from_truth']} of {row['truth_starts']}")
        about = [row["name"], f"{row['starts']} × {row['repeats']}"]
        table.append([*about, *clocks, number(row["first_seconds"]), *counts])
    return table


def _maps(rows: list[dict[str, Any]]) -> str:
    head = ["level", "engine", "starts", "first sweep, s", "later sweeps, s, min / median"]
    head += ["processor s, median", "starts/s", "steps/start"]
    table = [[*head, "peak memory, MB", "after import, MB"]]
    for row in rows:
        later = row["later"]
        about = [row["level"], row["engine"], f"{row['points']} × {row['points']}"]
        clocks = [number(row["first"]["seconds"]), pair(later["seconds"].values())]
        clocks.append(number(later["processor_seconds"]["median"]))
        counts = [f"{row['starts_per_second']:.0f}", f"{row['steps']:.1f}"]
        memory = [megabytes(row["peak_bytes"]), megabytes(row["import_bytes"])]
        table.append([*about, *clocks, *counts, *memory])
    return f"## The default map, with residual values, rtol 1e-8, all cores\n\n{layout(table)}"


def _compilations(rows: list[dict[str, Any]]) -> str:
    first = {f"{row['level']}, {row['engine']}": row["compilations"] for row in rows}
    calls = list(next(iter(first.values())))
    table = [["level, engine", *calls]]
    table += [[level, *(str(counts[name]) for name in calls)] for level, counts in first.items()]
    return f"## Programs compiled in a second call with other values\n\n{layout(table)}"


def _import(times: dict[str, Any]) -> str:
    names = [name for name in times if name != "ratio"]
    ratio = times["ratio"]
    return "\n\n".join(
        [
            "## Importing, in fresh processes",
            _clock_table(times, names),
            f"Median ratio of neighbouring runs to `{BASE}`: {ratio['seconds']:.2f} on the clock, "
            f"{ratio['processor_seconds']:.2f} in processor seconds.",
        ]
    )


def _cold_start(times: dict[str, Any]) -> str:
    side = f"{times['points']} × {times['points']}"
    ratios = [
        f"{name}: {ratio['seconds']:.2f} on the clock, "
        f"{ratio['processor_seconds']:.2f} in processor seconds"
        for name, ratio in times["ratio"].items()
    ]
    return "\n\n".join(
        [
            "## The first map, in fresh processes",
            f"`dipoletop map`: {side} starts at two levels, picture, table and stores. The first "
            "time ever the cache of machine code is empty; later it is not.",
            _clock_table(times, [FIRST_MAP, LATER_MAP, COLD_BASE]),
            f"Median ratio of neighbouring runs to `{COLD_BASE}`: {'; '.join(ratios)}.",
        ]
    )


def _fresh_outcomes(scene: dict[str, Any]) -> str:
    head = ["", "the first time ever, wall s", "later, wall s, min / median"]
    table = [[*head, "later, processor s, min / median", "peak memory, MB"]]
    for row in scene["rows"]:
        clocks = [number(row["first_seconds"]), *(pair(row[clock].values()) for clock in CLOCKS)]
        table.append([FRESH[row["name"]], *clocks, megabytes(row["peak_bytes"])])
    return "\n\n".join(
        [
            f"## The outcomes of {scene['starts']} starts, in fresh processes",
            "A process imports one integrator, compiles, and labels so many starts of the mixed "
            "basin. The first time ever no cache is on the disk. heyoka's memory is that of all "
            "its processes.",
            layout(table),
        ]
    )


def _clock_table(times: dict[str, Any], names: list[str]) -> str:
    table = [["", "wall s, min / median", "processor s, min / median"]]
    for name in names:
        table.append([f"`{name}`", *(pair(times[name][clock].values()) for clock in CLOCKS)])
    return layout(table)
