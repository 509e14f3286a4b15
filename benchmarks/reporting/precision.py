"""Work and precision: cost of an end state against its true error.

Numbers: [speed.json](speed.json). Command: `python benchmarks/run.py --write`.

End states at τ = 1000 for δ = −1/5, |ω| = 0.2, tolerances 1e-6 … 1e-12. The error is the largest
component of the difference from the reference, over |ω₀|; the table shows the largest and the
median over all starts. Every method has one core, in a process that may use no other. What depends
on problem and tolerance only is made before the clock starts.

| who | driven how |
|---|---|
| dipoletop | both engines, all starts in one queue |
| diffrax | Dopri8, `vmap` over 512 starts, the fastest width of four; the state is a tuple or has shape (3,) |
| heyoka batch, heyoka scalar | Taylor method, starts in SIMD batches, or one after another from Python |
| numbalsoda | DOP853 and LSODA, right-hand side and loop over the starts compiled by numba (`peers/with_numbalsoda.py`); `pip install numba numbalsoda` needs a Fortran compiler |
| scipy | DOP853, 64 starts, once |

heyoka's compiler is given δ and |ω₀| as numbers; the others are given them at run time. With its
polynomials multiplied out heyoka would be a little faster (measured: 2 to 4 %), and its processor
time leaves out what the parent process does.

![Cost of an end state against its true error](work_precision.png)
"""

from pathlib import Path
from typing import Any

from benchmarks.reporting.speed import machine
from benchmarks.reporting.tables import CLOCKS, layout, number, per_start

COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#000000", "#F0E442")


def body(results: dict[str, Any]) -> str:
    """The table of this page."""
    return f"{machine(results)}\n\n{_table(results['precision'])}"


def _table(scene: dict[str, Any]) -> str:
    table = [["", "rtol", "largest error", "median error", "µs/start, wall", "µs/start, processor"]]
    few = {row["name"]: row["starts"] for row in scene["rows"] if row["starts"] < scene["starts"]}
    for row in scene["rows"]:
        clocks = [number(per_start(row, clock)) for clock in CLOCKS]
        errors = [f"{row[name]:.1e}" for name in ("largest_error", "median_error")]
        table.append([row["name"], f"{row['rtol']:.0e}", *errors, *clocks])
    first = ", ".join(f"{name} {number(s)}" for name, s in scene["first_seconds"].items())
    return "\n\n".join(
        [
            f"## End states of {scene['starts']} starts at τ = 1000",
            f"Reference: {scene['reference']}. Medians of {scene['repeats']} repeats"
            + "".join(f"; {name} {n} starts, once" for name, n in few.items())
            + f". The first tolerance with compilation and a first run, s: {first}.",
            layout(table),
            *(line + "." for line in scene["missing"]),
        ]
    )


def figure(scene: dict[str, Any], path: Path) -> None:
    """Draw cost against true error, one line for each method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    drawing, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    # scipy, which takes a thousand times as long, would press the others together.
    names = [name for name in scene["first_seconds"] if "scipy" not in name]
    for colour, name in zip(COLOURS, names, strict=False):
        rows = [row for row in scene["rows"] if row["name"] == name]
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
    ax.set_title(f"{scene['starts']} starts, δ = −1/5, |ω₀| = 0.2, τ = 1000", fontsize="medium")
    ax.grid(alpha=0.3)
    drawing.legend(loc="outside lower center", ncols=3, fontsize="small")
    drawing.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(drawing)
