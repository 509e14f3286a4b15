"""The quantities that a map or a run is given: names, options, defaults, and the grid of a map.

Everywhere in Python a quantity has the name of its axis in a `Grid`, such as `w_perp`. The command
line spells it as an option, `--w-perp`: `OPTIONS` leads from there to the name, and messages go
the other way by `WORDS`.
"""

import math
from collections.abc import Mapping
from typing import Any

import click
import numpy as np

from .._base.numerals import as_text
from .._maps.grids import Grid
from .._maps.top_parameters import CYLINDRICAL, QUANTITIES, SPHERICAL, describe
from ..equations.transverse import TransverseReduced
from .parameters import Number
from .refusals import Command, Refusal

OPTIONS = {name.replace("_", "-"): name for name in QUANTITIES}
"""Names of the quantities, by the words of the command line."""
WORDS = {name: word for word, name in OPTIONS.items()}
IN_PLACE = {"amplitude": " With --theta in place of w-perp and w3."}
"""What the help of an option says besides its meaning."""


def spelled(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names as the command line spells them."""
    return tuple(WORDS[name] for name in names)


def quantity_options(command: Command) -> Command:
    """The options --delta, --w-perp, …; the command gets them by the names of `QUANTITIES`."""
    for name, quantity in reversed(QUANTITIES.items()):
        default = as_text(quantity.default).replace("π", "pi")
        help_text = f"{quantity.meaning}{IN_PLACE.get(name, '')}  [default: {default}]"
        option = click.option(f"--{WORDS[name]}", name, type=Number(), help=help_text)
        command = option(command)
    return command


def with_defaults(
    given: Mapping[str, float | None], axes: tuple[str, ...] = ()
) -> dict[str, float]:
    """The quantities that fix δ and ω₀, as given or by default; `axes` will be varied.

    Raises:
        Refusal: an axis that is given, ω⊥ or ω₃ with |ω| or ϑ, or values that cannot be.
    """
    fixed = {name: value for name, value in given.items() if value is not None}
    for name in fixed:
        if name in axes:
            option = WORDS[name]
            raise Refusal(
                f"--{option} would fix an axis of the map; use --range {option} LOW HIGH."
            )
    named = {*axes, *fixed}
    if named & SPHERICAL and named & CYLINDRICAL:
        mixed = spelled(tuple(named & (SPHERICAL | CYLINDRICAL)))
        raise Refusal(
            f"{' and '.join(sorted(mixed))} cannot be mixed: "
            "the start is given by w-perp and w3, or by amplitude and theta."
        )
    left_out = CYLINDRICAL if named & SPHERICAL else SPHERICAL
    values = {
        name: fixed.get(name, quantity.default)
        for name, quantity in QUANTITIES.items()
        if name not in left_out
    }
    for name, value in values.items():
        _check(name, value)
    return values


def _check(name: str, *values: float) -> None:
    """Refuse values that no top can have."""
    option = WORDS[name]
    for value in values:
        if name in ("w_perp", "amplitude") and value < 0:
            raise Refusal(f"{option} must not be negative, but is {value:g}.")
        if name == "theta" and not 0 <= value <= math.pi:
            raise Refusal(f"theta must lie between 0 and pi, but is {value:g}.")
        if name == "delta":
            TransverseReduced(value)  # which refuses a δ that no body has


def grid_over(
    axes: tuple[str, str],
    ranges: Mapping[str, tuple[float, float]],
    size: tuple[int, int],
    given: Mapping[str, float | None],
) -> tuple[Grid, str]:
    """The grid over two quantities, and a line that describes it.

    A quantity that is fixed is an axis of length 1, so that the data hold all of them. The axes
    x and y of the map come last, x after y.

    Raises:
        Refusal: axes, ranges or values that do not go together.
    """
    x, y = axes
    options = spelled(axes)
    if x == y:
        raise Refusal(f"--x and --y must be two different quantities, but are both {options[0]}.")
    for name in ranges:
        if name not in axes:
            raise Refusal(
                f"--range {WORDS[name]}: the axes of this map are {options[0]} and {options[1]}."
            )
    fixed = {name: v for name, v in with_defaults(given, axes).items() if name not in axes}
    values: dict[str, Any] = dict(fixed)
    spans = {}
    for name, n in zip(axes, size, strict=True):
        quantity = QUANTITIES[name]
        low, high = ranges.get(name, (quantity.low, quantity.high))
        if not low < high:
            raise Refusal(f"--range {WORDS[name]}: {low:g} must be less than {high:g}.")
        _check(name, low, high)
        values[name] = np.linspace(low, high, n, endpoint=not _repeats(name, low, high))
        spans[name] = f"{quantity.symbol} from {as_text(low)} to {as_text(high)}"
    text = f"{size[0]} × {size[1]} starts: {spans[x]}, {spans[y]}, at {describe(fixed)}"
    return Grid(**{name: values[name] for name in (*fixed, y, x)}), text


def _repeats(name: str, low: float, high: float) -> bool:
    """Whether outcomes at both ends of a range are the same: they repeat after φ → φ + π."""
    half_turns = (high - low) / math.pi
    return name == "phi" and math.isclose(half_turns, round(half_turns), abs_tol=1e-9)
