"""Cost against error, a line for each method."""

from pathlib import Path
from typing import Any

COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#000000", "#F0E442")


def work_precision(numbers: Any, folder: Path) -> None:
    """Processor time of end states against their largest error."""
    # scipy, which takes a thousand times as long, would press the others together.
    rows = [row for row in numbers["precision"]["rows"] if "scipy" not in row["name"]]
    text = "largest error of an end state over |ω₀|"
    _draw(rows, "largest_error", text, 0.0, folder / "work_precision.png")


def label_precision(numbers: Any, folder: Path) -> None:
    """Processor time of labels against the share of wrong ones; none: in the grey band."""
    rows = [row | {"share": row["wrong"] / row["starts"]} for row in numbers["costs"]["rows"]]
    text, least = "share of wrong labels; grey: none", 1 / numbers["costs"]["starts"]
    _draw(rows, "share", text, least, folder / "label_precision.png")


def _draw(rows: list[dict[str, Any]], of: str, text: str, least: float, path: Path) -> None:
    """Both axes logarithmic; the points are named by their tolerances."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    drawing, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for k, name in enumerate(dict.fromkeys(row["name"] for row in rows)):
        mine, colour = [row for row in rows if row["name"] == name], COLOURS[k % len(COLOURS)]
        at, cost = [row[of] or least / 2 ** (k + 1) for row in mine], [row["us"][1] for row in mine]
        ax.loglog(at, cost, "o-", color=colour, label=name, ms=4)
        for row, x, y in zip(mine, at, cost, strict=True):
            style: Any = {"textcoords": "offset points", "color": colour, "fontsize": "xx-small"}
            ax.annotate(f"{row['rtol']:.0e}", (x, y), xytext=(4, 2), **style)
    if least:
        ax.axvspan(least / 2**6, least * 0.7, color="0.92", lw=0)
    ax.set(xlabel=f"{text} (at the points: rtol)", ylabel="processor time per start, µs")
    ax.margins(x=0.1)  # room for the last name
    ax.grid(alpha=0.3)
    drawing.legend(loc="outside lower center", ncols=3, fontsize="small")
    drawing.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(drawing)
