"""Numbers written as text, multiples of π among them."""

import math
import re

WITH_PI = re.compile(r"([+-]?)([0-9.]*)\*?pi(?:/([0-9.]+))?")


def number_in(text: str) -> float:
    """The finite number that a text stands for, such as 0.2, 1e-3, pi/30, 2pi or 2*pi/3.

    Raises:
        ValueError: it stands for none.
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
