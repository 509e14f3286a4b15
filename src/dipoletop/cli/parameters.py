"""Kinds of values on the command line: numbers, sizes, lengths, directions."""

import math
import re
from typing import Any, ClassVar, TypeAlias

import click

from .._base.numerals import number_in

Parameter: TypeAlias = click.Parameter | None
Context: TypeAlias = click.Context | None


class Number(click.ParamType):
    """A finite number; multiples of π as pi/30, 2pi or 2*pi/3."""

    name = "number"

    def convert(self, value: Any, param: Parameter, ctx: Context) -> float:
        """The number that a text stands for."""
        try:
            return number_in(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a finite number such as 0.2, 1e-3 or pi/30.", param, ctx)


class Size(click.ParamType):
    """The size of a grid: N for N × N, or NXxNY."""

    name = "N or NXxNY"

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[int, int]:
        """The numbers of starts on x and on y."""
        if isinstance(value, tuple):
            return value
        parts = re.fullmatch(r"(\d+)(?:x(\d+))?", str(value))
        if not parts or min(int(n) for n in parts.groups() if n) < 2:
            self.fail(f"{value!r} is not a size such as 512 or 512x256, at least 2.", param, ctx)
        return int(parts[1]), int(parts[2] or parts[1])


class Duration(click.ParamType):
    """A time as 90s, 30m, 2h, or as batch systems write it: [[hours:]minutes:]seconds."""

    name = "time"
    UNITS: ClassVar[dict[str, float]] = {"s": 1.0, "m": 60.0, "h": 3600.0}

    def convert(self, value: Any, param: Parameter, ctx: Context) -> float:
        """Seconds."""
        if isinstance(value, float):
            return value
        text = str(value).strip()
        parts = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
        clock = re.fullmatch(r"(?:(?:(\d+):)?(\d+):)?(\d+)", text)
        if parts:
            seconds = float(parts[1]) * self.UNITS[parts[2]]
        elif clock:
            hours, minutes, rest = (float(x or 0) for x in clock.groups())
            seconds = 3600 * hours + 60 * minutes + rest
        else:
            seconds = 0.0
        if seconds <= 0:
            self.fail(f"{value!r} is not a time such as 90s, 30m, 2h or 1:30:00.", param, ctx)
        return seconds


class Lengths(click.ParamType):
    """Lengths with a unit, in metres: "100nm", or several as 100x60x40nm."""

    UNITS: ClassVar[dict[str, float]] = {
        "pm": 1e-12,
        "Å": 1e-10,
        "nm": 1e-9,
        "um": 1e-6,
        "µm": 1e-6,
        "μm": 1e-6,
        "mm": 1e-3,
        "cm": 1e-2,
        "m": 1.0,
    }
    PART = re.compile(r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zÅµμ]*)", re.ASCII)

    def __init__(self, count: int, example: str) -> None:
        self.count, self.example, self.name = count, example, example

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[float, ...]:
        """The lengths; a part without a unit has that of the last one."""
        if isinstance(value, tuple):
            return value
        parts = [self.PART.fullmatch(part.strip()) for part in re.split("[x×]", str(value))]
        units = [part[2] if part else "" for part in parts]
        factors = [self.UNITS.get(unit or units[-1]) for unit in units]
        lengths = tuple(
            float(part[1]) * factor
            for part, factor in zip(parts, factors, strict=True)
            if part and factor
        )
        if len(lengths) != self.count or len(parts) != self.count or min(lengths) <= 0:
            what = "a positive length" if self.count == 1 else f"{self.count} positive lengths"
            message = f"{value!r} is not {what} with a unit (nm, um, mm, …) such as {self.example}."
            self.fail(message, param, ctx)
        return lengths


class Numbers(click.ParamType):
    """Three numbers such as 3,4,5."""

    name = "numbers"

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[float, ...]:
        """The three numbers."""
        if isinstance(value, tuple):
            return value
        numbers = three_numbers(value)
        if not numbers:
            self.fail(f"{value!r} is not three numbers such as 3,4,5.", param, ctx)
        return numbers


def three_numbers(text: Any) -> tuple[float, ...]:
    """Three finite numbers from a text, with commas between them; none if it is not that."""
    try:
        numbers = tuple(float(part) for part in str(text).split(","))
    except ValueError:
        return ()
    return numbers if len(numbers) == 3 and all(map(math.isfinite, numbers)) else ()


class Direction(click.ParamType):
    """A direction in body axes: x, y, z, or three numbers such as 1,0,0.01."""

    name = "direction"
    AXES: ClassVar[dict[str, tuple[float, ...]]] = {
        "x": (1.0, 0.0, 0.0),
        "y": (0.0, 1.0, 0.0),
        "z": (0.0, 0.0, 1.0),
    }

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[float, ...]:
        """The three components, of any length except 0."""
        if isinstance(value, tuple):
            return value
        if value in self.AXES:
            return self.AXES[value]
        vector = three_numbers(value)
        if not any(vector):
            message = f"{value!r} is not a direction such as x, y, z or 1,0,0.01."
            self.fail(message, param, ctx)
        return vector
