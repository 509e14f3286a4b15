"""The quantities that fix a transverse top and its start: symbols, defaults, ranges.

A quantity has the name of its axis in a `Grid`, such as `w_perp`. Nothing here needs JAX, so that
the command line can name them at once.
"""

import math
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any, NamedTuple

from .._base.numerals import as_text
from .._base.refusals import described, refuse


class Quantity(NamedTuple):
    """A quantity that may be given or varied: symbol, meaning, default, usual range, bounds."""

    symbol: str
    meaning: str
    default: float
    low: float
    high: float
    least: float = -math.inf
    most: float = math.inf


QUANTITIES = {
    "delta": Quantity(
        "δ",
        "δ = 1 − I₃/I₁: −1 of a disc, 0 of a sphere, 1 of a rod.",
        *(-0.2, -1.0, 0.9),
        *(-1.0, math.nextafter(1.0, 0.0)),
    ),
    "w_perp": Quantity("ω⊥", "ω⊥, across the symmetry axis.", 0.2, 0.0, 0.5, 0.0),
    "w3": Quantity("ω₃", "ω₃, along the symmetry axis.", 0.2, 0.0, 0.6),
    "phi": Quantity("φ", "φ, from the dipole to ω⊥.", math.pi / 30, 0.0, math.pi),
    "amplitude": Quantity("|ω|", "|ω|, the size of ω.", 0.2, 0.02, 0.5, 0.0),
    "theta": Quantity(
        "ϑ", "Angle from the symmetry axis to ω.", math.pi / 4, 0.0, math.pi / 2, 0.0, math.pi
    ),
}
CYLINDRICAL, SPHERICAL = {"w_perp", "w3"}, {"amplitude", "theta"}
"""The two ways to give the size and the direction of ω₀; φ belongs to both."""


def checked(name: str, value: Any, quantity: Quantity) -> float:
    """A number that a quantity may have.

    Raises:
        ValueError: it is none, or lies out of bounds.
    """
    must = "be a finite number"
    if isinstance(value, bool) or not isinstance(value, Real):
        refuse(name, must, described(value))
    number = float(value)
    if not math.isfinite(number):
        refuse(name, must, f"is {number}")
    if not quantity.least <= number <= quantity.most:
        refuse(name, _bounds(quantity), f"is {number:g}")
    return number


def checked_range(name: str, ends: Iterable[Any], quantity: Quantity) -> tuple[float, float]:
    """A range of numbers that a quantity may have.

    Raises:
        ValueError: an end is none of them, or the range does not increase.
    """
    low, high = (checked(name, end, quantity) for end in ends)
    if not low < high:
        refuse(name, "have a range that increases", f"has {low:g} to {high:g}")
    return low, high


def _bounds(quantity: Quantity) -> str:
    if math.isinf(quantity.most):
        return f"be at least {quantity.least:g}"
    end = ")" if quantity.most < round(quantity.most) else "]"  # δ < 1, by its last bit
    return f"lie in [{quantity.least:g}, {quantity.most:.6g}{end}"


def describe(values: Mapping[str, float]) -> str:
    """Return the values with their symbols."""
    return ", ".join(
        f"{QUANTITIES[name].symbol} = {as_text(value)}" for name, value in values.items()
    )
