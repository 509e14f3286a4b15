"""How precisely must a motion be known for its label?

Numbers: [label_precision.json](label_precision.json). Command, eight minutes on two cores:

    python -m benchmarks.accuracy.label_precision --small     a look
    python -m benchmarks.accuracy.label_precision --write     all, kept here

Of runs that are asked for no more than their outcome dipoletop makes a loose and brief first pass
(Dopri8, rtol = 1e-4, 100 steps), and then makes those again whose label is in doubt. Labels are
compared with those of one pass at rtol = 1e-11, where both are decided.

- **Mixed basin**: `problems/mixed_basin.py`, outcomes only, at most 4096 steps, on all cores.
  Dopri8 and Tsit5 make one pass at the tolerance, by the native engine in `classify_many`; heyoka is
  driven as in [speed](speed.md).
- **Every level and kind of body**: starts at random, and starts that close in on the boundary, which
  are the middles of bisections, the last ones 1e-6 of the first distance from it. **again**: runs
  of the second pass. **wrong**: labels of the first pass alone / of one pass at rtol = 1e-8 / of the
  default. A label that the default has wrong and one pass has right is **lost**; its row is bold.
  **margin**: the largest (\\|ω\\|/\\|ω₀\\|)²/(rtol n²) at the end of a first pass with a wrong
  label, n its steps; 0 if a small displacement of its last state would change the verdict, as at
  order 1 next to the boundary. The run is made again if that is at most 1/4.
  Tops: δ uniform in (−0.99, 0.99), (−½, 0), (−0.05, 0.05), or (0.7532, 0.99) with |ω₀| at most 0.05;
  |ω₀| over two decades and a half, up to 1, or 0.2 from order 2 on. Bodies: `problems/random_bodies.py`.
- **The wall**: starts on both sides of the separatrix, against Taylor series in long double
  (`accuracy/separatrix.py`).

![Cost of a label against the share of wrong labels](label_precision.png)
"""

from pathlib import Path
from typing import Any

from benchmarks.reporting.tables import ABSENT, CLOCKS, bullets, layout, number, pair, per_start

DEFAULT = "default, two passes"
HEYOKA = "heyoka batch"
COLOURS = {"Dopri8": "#0072B2", "Tsit5": "#56B4E9", HEYOKA: "#D55E00", DEFAULT: "#000000"}
BESIDE = {"Dopri8": 0.7, "Tsit5": 1.4, HEYOKA: 1.0, DEFAULT: 1.0}
Row = dict[str, Any]


def body(results: Row) -> str:
    """Sentences, tables, and the command that they came from."""
    costs, wall, cores = results["costs"], results["wall"], results["cores"]
    run = f"`{results['command']}`, {results['date']}, {results['processor']}, {cores} cores"
    parts = [
        f"## Mixed basin, {costs['starts']} starts",
        *as_good(costs["rows"]),
        _costs(costs["rows"]),
        *(line + "." for line in costs["missing"]),
        "## Every level and kind of body",
        _verdict(results["rows"]),
        _kinds(results["rows"]),
        *_lost(results["rows"]),
        f"## The wall: {wall['starts']} starts at distances {wall['span'][1]:.0e} … "
        f"{wall['span'][0]:.0e} from the separatrix",
        _wall(wall["rows"]),
        bullets([run]),
    ]
    return "\n\n".join(parts)


def heyoka_at_equal_labels(rows: list[Row]) -> tuple[Row, Row | None]:
    """The default, and heyoka at its loosest tolerance with as few wrong labels."""
    ours = next(row for row in rows if row["name"] == DEFAULT)
    good = [row for row in rows if row["name"] == HEYOKA and row["wrong"] <= ours["wrong"]]
    return ours, max(good, key=lambda row: row["rtol"], default=None)


def as_good(rows: list[Row]) -> list[str]:
    """How heyoka compares at equal labels, if it was measured."""
    ours, peer = heyoka_at_equal_labels(rows)
    if peer is None:
        return []
    good = [row for row in rows if row["name"] == "Dopri8" and row["wrong"] <= ours["wrong"]]
    once = max(good, key=lambda row: row["rtol"], default=None)

    def times(row: Row) -> str:
        return pair(per_start(peer, clock) / per_start(row, clock) for clock in CLOCKS)

    said = [
        f"heyoka's labels are as good as the default's from rtol = {peer['rtol']:.0e} on "
        f"({peer['wrong']} and {ours['wrong']} wrong). There it takes {times(ours)} times as long "
        "(wall / processor)."
    ]
    if once is not None:
        said.append(
            f"One pass of Dopri8 is as good from rtol = {once['rtol']:.0e} on, where heyoka takes "
            f"{times(once)} times as long."
        )
    return [" ".join(said)]


def _costs(rows: list[Row]) -> str:
    table = [["", "rtol", "steps/start", "µs/start, wall", "µs/start, processor"]]
    table[0] += ["wrong", "undecided"]
    for row in rows:
        clocks = [number(per_start(row, clock)) for clock in CLOCKS]
        counts = [str(row["wrong"]), str(row["undecided"])]
        table.append([row["name"], f"{row['rtol']:.0e}", number(row["steps"]), *clocks, *counts])
    return layout(table)


def total(rows: list[Row], part: str, name: str) -> int:
    """A count over all rows."""
    return sum(row[part].get(name, 0) for row in rows)


def _verdict(rows: list[Row]) -> str:
    sentences = []
    for part, where in (("random", "at random"), ("near", "that close in on the boundary")):
        starts, lost, wrong, once = (
            total(rows, part, name) for name in ("decided", "lost", "wrong", "wrong_once")
        )
        sentences.append(
            f"Of {starts} starts {where} the default has {wrong} labels wrong and one pass at the "
            f"same tolerance {once}; {lost} are lost."
        )
    margin = max(row[part].get("margin", 0) for row in rows for part in ("random", "near"))
    return " ".join([*sentences, f"The largest margin is {margin:.2g}."])


def _kinds(rows: list[Row]) -> str:
    head = ["level", "body", "starts at random", "again", "wrong", "margin"]
    table = [[*head, "starts that close in", "again", "wrong", "margin", "lost"]]
    for row in rows:
        cells = [row["level"], row["kind"] if row["top"] else f"bodies, {row['kind']}"]
        for part in ("random", "near"):
            cells += _cells(row[part])
        lost = sum(row[part].get("lost", 0) for part in ("random", "near"))
        cells.append(str(lost))
        table.append([f"**{cell}**" for cell in cells] if lost else cells)
    return layout(table, text=2)


def _cells(part: Row) -> list[str]:
    if not part:
        return 4 * [ABSENT]
    wrong = " / ".join(str(part[name]) for name in ("wrong_first", "wrong_once", "wrong"))
    margin = f"{part['margin']:.1e}" if part["wrong_first"] else ABSENT
    return [str(part["starts"]), f"{part['again'] / part['starts']:.1%}", wrong, margin]


def _lost(rows: list[Row]) -> list[str]:
    """Some of the starts with a lost label, so that they can be looked at."""
    lines = []
    for row in rows:
        for start in [*row["random"]["lost_starts"], *row["near"].get("lost_starts", [])][:2]:
            about = f"level {row['level']}, {row['kind']}: fields {start['equation']}"
            lines.append(f"- {about}, ω₀ = {start['omega']}, label {start['truth']}")
    return ["\n".join(["Some lost labels:", "", *lines])] if lines else []


def _wall(rows: list[Row]) -> str:
    table = [["", "rtol", "wrong", "undecided", "farthest wrong"]]
    for row in rows:
        counts = [str(row["wrong"]), str(row["undecided"]), f"{row['farthest']:.1e}"]
        table.append([row["name"], f"{row['rtol']:.0e}", *counts])
    return layout(table)


def figure(results: Row, path: Path) -> None:
    """Draw cost against the share of wrong labels; what has none stands in a grey band."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator, StrMethodFormatter

    costs = results["costs"]
    one = 1 / costs["starts"]
    none = one / 6
    drawing, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    ax.axvspan(none / 4, 3 * none, color="0.92", lw=0)
    for name in dict.fromkeys(row["name"] for row in costs["rows"]):
        _draw(ax, name, [row for row in costs["rows"] if row["name"] == name], none)
    ax.set_xlim(none / 4, 2 * max(row["wrong"] * one for row in costs["rows"]) or 1)
    powers = range(-5, -1)
    ax.set_xticks([none, *(10.0**k for k in powers)], ["0", *(f"$10^{{{k}}}$" for k in powers)])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("share of wrong labels (at the points: rtol)")
    ax.set_ylabel("processor time per start, µs")
    ax.set_title(f"Mixed basin, {costs['starts']} starts, outcomes only", fontsize="medium")
    ax.grid(alpha=0.3)
    drawing.legend(loc="outside lower center", ncols=4, fontsize="small")
    drawing.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(drawing)


def _draw(ax: Any, name: str, rows: list[Row], none: float) -> None:
    """One method; in the band, round the share `none`, methods stand side by side."""
    shares = [row["wrong"] / row["starts"] or none * BESIDE[name] for row in rows]
    cost = [per_start(row, "processor_seconds") for row in rows]
    if name == DEFAULT:
        label = f"{name}, rtol {rows[0]['rtol']:.0e}"
        ax.loglog(shares, cost, "*", color=COLOURS[name], ms=11, label=label)
        return
    ax.loglog(shares, cost, "o-", color=COLOURS[name], ms=4, label=name)
    right = [row for row in rows if not row["wrong"]]
    for row, x, y in zip(rows, shares, cost, strict=True):
        place: Row = {"xytext": (0, -11 if name == HEYOKA else 6), "ha": "center"}
        if not row["wrong"]:
            side = 1 if BESIDE[name] > 1 else -1
            place = {"xytext": (5 * side, 3 * side), "ha": "left" if side > 0 else "right"}
        if row["wrong"] or row in (right[0], right[-1]):
            style: Row = {"textcoords": "offset points", "fontsize": "x-small"}
            ax.annotate(f"{row['rtol']:.0e}", (x, y), color=COLOURS[name], **style, **place)
