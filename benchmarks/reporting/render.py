"""Tables in Markdown, made of numbers and a template.

A paragraph of a template is a text with fields as `str.format` has them, or a table:

    @wall[rows]                     the rows
    rtol | steps                    the heads
    {rtol:.0e} | {steps:n}          the fields of a row (a row that is no dictionary is `{0}`)

Formats of our own: `n` three digits, `M` bytes in MB, `m` seconds in ms, and `/` before another
one: the values of a list or dictionary side by side. What is not known is a dash. `prepared` adds
what fields may ask for: `[sum]`, `[max]` of a column of rows, their `[last]`; and `us`, the medians
of both clocks in µs for each start.
"""

import re
import string
from typing import Any

from benchmarks.reporting.measure import CLOCKS

ABSENT = "—"


def number(value: float) -> str:
    """A number with three digits."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.3g}"


SPECS = {"n": number, "M": lambda x: f"{x / 1e6:.0f}", "m": lambda x: number(1e3 * x)}


class Formatter(string.Formatter):
    """`str.format` with our formats, and with dashes."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        try:
            return super().get_field(field_name, args, kwargs)
        except (KeyError, IndexError, TypeError):
            return None, field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec.startswith("/"):
            values = value.values() if isinstance(value, dict) else value or [None]
            return " / ".join(self.format_field(each, format_spec[1:]) for each in values)
        if isinstance(value, dict):
            value = [f"{key} {self.format_field(each, format_spec)}" for key, each in value.items()]
            return ", ".join(value)
        if isinstance(value, list):
            return ", ".join(self.format_field(each, format_spec) for each in value) or ABSENT
        if value is None or value != value:
            return ABSENT
        if format_spec in SPECS:
            return SPECS[format_spec](value)
        return format(value, format_spec)


class Rows(list):
    """Rows with sums over them."""

    def __getitem__(self, key: Any) -> Any:
        if key == "last":
            return self[-1]
        if key in ("sum", "max"):
            columns = [k for k, v in self[0].items() if isinstance(v, int | float)]
            add = {"sum": sum, "max": max}[key]
            return {name: add(row.get(name) or 0 for row in self) for name in columns}
        return super().__getitem__(key)


def prepared(numbers: Any) -> Any:
    """The numbers, and what fields may ask for beside them."""
    if isinstance(numbers, list):
        return Rows(map(prepared, numbers))
    if not isinstance(numbers, dict):
        return numbers
    found = {name: prepared(value) for name, value in numbers.items()}
    if isinstance(found.get("seconds"), dict) and "starts" in found:
        found["us"] = [1e6 * found[clock]["median"] / found["starts"] for clock in CLOCKS]
        found["us_least"] = 1e6 * found["seconds"]["min"] / found["starts"]
    return found


def fill(template: str, row: Any) -> str:
    """The template with the numbers of a row."""
    return Formatter().vformat(template, (row,), row if isinstance(row, dict) else {})


def render(template: str, numbers: Any) -> str:
    """The paragraphs of a template with their numbers."""
    parts = []
    for part in template.split("\n\n"):
        if part.startswith("@"):
            place, heads, *lines = part[1:].split("\n")
            rows = Formatter().get_field(place, (), numbers)[0] if place else [numbers]
            table = [
                [fill(cell, row) for cell in cells.split(" | ")]
                for row in rows or []
                for cells in lines
            ]
            part = layout([fill(heads, numbers).split(" | "), *table]) if table else "None."
        else:
            part = fill(part, numbers)
        parts.append(part)
    return "\n\n".join(parts)


def layout(table: list[list[str]]) -> str:
    """A Markdown table, columns of numbers to the right."""
    columns = []
    for head, *cells in zip(*table, strict=True):
        width, right = max(map(len, (head, *cells))), all(re.match(r"[\d+−×—-]", c) for c in cells)
        rule = "-" * (width - 1) + ":" if right else "-" * width
        columns.append([c.rjust(width) if right else c.ljust(width) for c in (head, rule, *cells)])
    return "\n".join(f"| {' | '.join(row)} |" for row in zip(*columns, strict=True))
