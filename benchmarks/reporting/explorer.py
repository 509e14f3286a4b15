"""The explorer: from a slider to the picture.

Numbers: [explorer.json](explorer.json). Command, some minutes on two cores:

    python -m benchmarks.speed.explorer --small     a look
    python -m benchmarks.speed.explorer --write     all, kept here

`dipoletop explore` (semi-reduced, δ ≈ −0.2, ω⊥ = 0.2, rtol 1e-8, native engine) and a headless browser
that draws without a GPU, both on this machine. Milliseconds from the event of the mouse that moves the
slider of δ to the second frame after the picture has arrived, so that it has been drawn.

- **First**: a picture of any size. **Full size**: of all starts, at the tolerance 1e-5 and without
  estimates of errors. **Finished**: at the tolerance that is asked for, and with these estimates; it is
  begun when the slider has rested for 100 ms.
- **While it moves**: the slider moves without a rest; the age of the values that a picture shows.
- On the whole plane the symmetries leave a quarter of the starts to compute; on a part of it all are.
"""

from typing import Any

from benchmarks.reporting.tables import ABSENT, bullets, layout

ASKED = {256: 150, 512: 500}
"""Milliseconds within which a picture of full size should come."""


def body(results: Any) -> str:
    """Times by case and size."""
    if not results:
        return "Not measured yet."
    head = ["map", "starts", "first", "full size", "target", "finished"]
    table = [[*head, "while it moves", "pictures/s", "their size"]]
    for row in results["rows"]:
        times = [_pair(row[name]) for name in ("first", "full")]
        size = row["size"]
        target = str(ASKED[size]) if size in ASKED else ABSENT
        moving = [_pair(row["age"]), f"{row['pictures']:.1f}", f"{row['pixels']:.0f}²"]
        table.append([row["name"], f"{size}²", *times, target, _pair(row["final"]), *moving])
    loads = [row["load"] for row in results["rows"] if row["load"] is not None]
    load = f", load average {min(loads):.1f} to {max(loads):.1f}" if loads else ""
    made = f"`{results['command']}`, {results['date']}, {results['processor']}"
    return "\n\n".join(
        [
            "Milliseconds, median / 95 %.",
            layout(table),
            bullets([f"{made}, {results['cores']} cores{load}, {results['browser']}"]),
        ]
    )


def _pair(times: dict[str, float]) -> str:
    return f"{times['median']:.0f} / {times['95%']:.0f}"
