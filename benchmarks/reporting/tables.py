"""Tables in Markdown, and numbers in them."""

from collections.abc import Iterable
from typing import Any

Table = list[list[str]]
ABSENT = "—"
CLOCKS = ("seconds", "processor_seconds")


def layout(table: Table, *, text: int = 1) -> str:
    """A Markdown table; the first `text` columns to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    head, *body = (
        [f"{cell:<{w}}" if k < text else f"{cell:>{w}}" for k, (cell, w) in enumerate(cells)]
        for cells in (list(zip(row, widths, strict=True)) for row in table)
    )
    rule = ["-" * w if k < text else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *body))


def number(value: float) -> str:
    """A number with three digits."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.3g}"


def pair(values: Iterable[float]) -> str:
    """Numbers side by side, such as a minimum and a median."""
    return " / ".join(map(number, values))


def per_start(row: dict[str, Any], clock: str, which: str = "median") -> float:
    """Microseconds per start."""
    return 1e6 * row[clock][which] / row["starts"]


def both_clocks(row: dict[str, Any]) -> str:
    """Microseconds per start, by the wall's clock and the processor's."""
    return pair(per_start(row, clock) for clock in CLOCKS)


def megabytes(size: int | None) -> str:
    """A size in MB, where the system reports it."""
    return "unknown" if size is None else f"{size / 1e6:.0f}"


def bullets(runs: Iterable[str]) -> str:
    """The commands that a page came from, one to a line."""
    return "\n".join(["Measured by:", "", *(f"- {run}" for run in runs)])
