"""Conversion of numbers, including multiples of π, to text and back."""

import math
import re
from fractions import Fraction

WITH_PI = re.compile(r"([+-]?)([0-9.]*)\*?pi(?:/([0-9.]+))?")


def number_in(text: str) -> float:
    """Return the finite number in a text, such as 0.2, 1e-3, pi/30, 2pi or 2*pi/3.

    Raises:
        ValueError: the text is not a finite number.
    """
    parts = WITH_PI.fullmatch(text.strip())
    if parts:
        sign, factor, divisor = parts.groups()
        below = float(divisor or 1)
        number = float(f"{sign}{factor or 1}") * math.pi / below if below else math.nan
    else:
        number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text!r} is not a finite number")
    return number


def as_text(value: float) -> str:
    """Return a number as text, with six digits, or as a multiple of π such as "2π/3"."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    part = Fraction(value / math.pi).limit_denominator(60)
    if not math.isclose(part * math.pi, value, rel_tol=1e-12):
        return f"{value:g}"
    above = {1: "", -1: "-"}.get(part.numerator, str(part.numerator))
    return f"{above}π" + (f"/{part.denominator}" if part.denominator > 1 else "")
