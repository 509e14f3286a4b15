"""Kinds of values on the command line: numbers and sizes."""

import math
import re
from typing import Any, TypeAlias

import click

Parameter: TypeAlias = click.Parameter | None
Context: TypeAlias = click.Context | None


class Number(click.ParamType):
    """A finite number; multiples of π as pi/30, 2pi or 2*pi/3."""

    name = "number"
    WITH_PI = re.compile(r"([+-]?)([0-9.]*)\*?pi(?:/([0-9.]+))?")

    def convert(self, value: Any, param: Parameter, ctx: Context) -> float:
        """The number that a text stands for."""
        try:
            number = self._read(str(value))
        except (ValueError, ZeroDivisionError):
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number such as 0.2, 1e-3 or pi/30.", param, ctx)
        return number

    def _read(self, text: str) -> float:
        parts = self.WITH_PI.fullmatch(text)
        if not parts:
            return float(text)
        sign, factor, divisor = parts.groups()
        return float(f"{sign}{factor or 1}") * math.pi / float(divisor or 1)


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
