"""The results as tables for people and as a figure; where they are kept."""

import json
from pathlib import Path
from typing import Any

import report_gradients
import report_scaling
from bench_basin import OURS
from bench_import import BASE
from tables import Table, layout, megabytes, number, per_start

HERE = Path(__file__).parent
COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#000000", "#F0E442")


def keep(name: str, text: str, numbers: Any) -> None:
    """The text into the README between the marks of that name, the numbers into a JSON file."""
    readme = HERE / "README.md"
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, rest = readme.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end)
    readme.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")
    folder = HERE / "results"
    folder.mkdir(exist_ok=True)
    kept = json.dumps(numbers, indent=1, ensure_ascii=False)
    (folder / f"{name}.json").write_text(kept + "\n", encoding="utf-8")


def kept(name: str) -> Any:
    """The numbers that were kept before, or nothing."""
    path = HERE / "results" / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


def markdown(results: dict[str, Any]) -> str:
    """All tables, in Markdown that is also legible as it stands."""
    parts = [_machine(results), _basin(results["basin"])]
    parts += [_precision(results["precision"]), report_scaling.scaling(results["scaling"])]
    parts += [report_gradients.gradients(results["gradients"])]
    parts += [report_scaling.savings(results["savings"]), _maps(results["maps"])]
    parts += [_compilations(results["maps"]), _import(results["import"])]
    return "\n\n".join(parts)


def _machine(results: dict[str, Any]) -> str:
    machine = results["machine"]
    versions = ", ".join(f"{name} {value}" for name, value in machine["versions"].items())
    busy = " and ".join("unknown" if x is None else f"{x:.1f}" for x in results["load"])
    return (
        f"{machine['date']}; {machine['processor']}, {machine['cores']} cores; "
        f"{machine['system']}; {versions}. "
        f"Load average before and after (this run's own work included): {busy}."
    )


def _basin(found: dict[str, Any]) -> str:
    parts = [f"### Mixed basin, rtol {found['rtol']:.0e}, all cores"]
    for size, scene in found["tables"].items():
        parts += [f"N = {size}:", layout(_basin_table(scene["rows"]))]
        parts += [_efficiency(lanes) for lanes in scene["lanes"]]
    truth = found["truth"]
    parts.append(
        f"{truth['note']}: {number(truth['microseconds'])} µs and {truth['steps']:.1f} steps for "
        f"each of {truth['starts']} starts, at rtol 1e-12."
    )
    return "\n\n".join(parts + [line + "." for line in found["missing"]])


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
        wall, spent = per_start(row, "seconds"), per_start(row, "processor_seconds")
        ratio = wall / per_start(ours, "seconds"), spent / per_start(ours, "processor_seconds")
        table.append(
            [
                row["name"],
                f"{row['starts']} × {row['repeats']}",
                " / ".join(number(row["seconds"][w]) for w in ("min", "median")),
                " / ".join(number(row["processor_seconds"][w]) for w in ("min", "median")),
                f"{number(wall)} / {number(spent)}",
                f"{number(ratio[0])} / {number(ratio[1])}",
                number(row["first_seconds"]),
                f"{row['steps']:.1f}",
                str(row["undecided"]),
                str(row["differ_from_ours"]),
                f"{row['differ_from_truth']} of {row['truth_starts']}",
            ]
        )
    return table


def _precision(found: dict[str, Any]) -> str:
    table = [["", "rtol", "largest error", "median error", "µs/start, wall", "µs/start, processor"]]
    few = {row["name"]: row["starts"] for row in found["rows"] if row["starts"] < found["starts"]}
    for row in found["rows"]:
        clocks = [number(per_start(row, clock)) for clock in ("seconds", "processor_seconds")]
        errors = [f"{row[name]:.1e}" for name in ("largest_error", "median_error")]
        table.append([row["name"], f"{row['rtol']:.0e}", *errors, *clocks])
    first = ", ".join(f"{name} {number(s)}" for name, s in found["first_seconds"].items())
    return "\n\n".join(
        [
            f"### Work and precision: end states of {found['starts']} starts at τ = 1000",
            f"Reference: {found['reference']}. Medians of {found['repeats']} repeats"
            + "".join(f"; {name} {n} starts, once" for name, n in few.items())
            + f". The first tolerance with compilation and a first run, s: {first}.",
            layout(table),
            *(line + "." for line in found["missing"]),
        ]
    )


def _maps(found: list[dict[str, Any]]) -> str:
    head = ["level", "engine", "starts", "first sweep, s", "later sweeps, s, min / median"]
    head += [
        "processor s, median",
        "starts/s",
        "steps/start",
        "peak memory, MB",
        "after import, MB",
    ]
    table = [head]
    for row in found:
        later = row["later"]
        memory = [row["peak_bytes"], row["import_bytes"]]
        table.append(
            [
                row["level"],
                row["engine"],
                f"{row['points']} × {row['points']}",
                number(row["first"]["seconds"]),
                " / ".join(number(later["seconds"][w]) for w in ("min", "median")),
                number(later["processor_seconds"]["median"]),
                f"{row['starts_per_second']:.0f}",
                f"{row['steps']:.1f}",
                *map(megabytes, memory),
            ]
        )
    return f"### The default map, with residual values, rtol 1e-8, all cores\n\n{layout(table)}"


def _compilations(found: list[dict[str, Any]]) -> str:
    first = {f"{row['level']}, {row['engine']}": row["compilations"] for row in found}
    calls = list(next(iter(first.values())))
    table = [["level, engine", *calls]]
    table += [[level, *(str(counts[name]) for name in calls)] for level, counts in first.items()]
    return f"### Programs compiled in a second call with other values\n\n{layout(table)}"


def _import(found: dict[str, Any]) -> str:
    table = [["", "wall s, min / median", "processor s, min / median"]]
    for name in (name for name in found if name != "ratio"):
        clocks = (found[name][clock] for clock in ("seconds", "processor_seconds"))
        table.append([f"`{name}`", *(" / ".join(map(number, clock.values())) for clock in clocks)])
    ratio = found["ratio"]
    return "\n\n".join(
        [
            "### Importing, in fresh processes",
            layout(table),
            f"Median ratio of neighbouring runs to `{BASE}`: {ratio['seconds']:.2f} on the clock, "
            f"{ratio['processor_seconds']:.2f} in processor seconds.",
        ]
    )


def figure(found: dict[str, Any]) -> None:
    """Into results/work_precision.png: cost against true error, one line for each method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    drawing, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    # scipy, which takes a thousand times as long, would press the others together.
    names = [name for name in found["first_seconds"] if "scipy" not in name]
    for colour, name in zip(COLOURS, names, strict=False):
        rows = [row for row in found["rows"] if row["name"] == name]
        cost = [1e6 * row["processor_seconds"]["median"] / row["starts"] for row in rows]
        for error, style in (("largest_error", "o-"), ("median_error", "o:")):
            label = name if style == "o-" else None
            ax.loglog([row[error] for row in rows], cost, style, color=colour, label=label, ms=4)
    ax.invert_xaxis()
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("error of the end state over |ω₀|: largest (solid), median (dotted)")
    ax.set_ylabel("processor time per start, µs")
    ax.set_title(f"{found['starts']} starts, δ = −1/5, |ω₀| = 0.2, τ = 1000", fontsize="medium")
    ax.grid(alpha=0.3)
    drawing.legend(loc="outside lower center", ncols=3, fontsize="small")
    drawing.savefig(HERE / "results" / "work_precision.png", dpi=150, metadata={"Software": None})
    plt.close(drawing)
