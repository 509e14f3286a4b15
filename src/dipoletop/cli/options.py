"""What the options of commands share: kinds of values, names of files, quantities of a top."""

import contextlib
import functools
import math
import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .._base.numerals import as_text, number_in
from .._maps.top_parameters import CYLINDRICAL, QUANTITIES, SPHERICAL, checked, describe
from ..equations.levels import Level
from .running import Command, Refusal, plain_reason, say

if TYPE_CHECKING:
    from .._maps.grids import Grid

TERMS = """\b
The top is axisymmetric, I₁ = I₂, and its dipole lies across the symmetry axis. Quantities
are dimensionless: ω = τ₀Ω and τ = t/τ₀, with τ₀ = 2d²/(3c³I₁) in Gaussian units.
  delta      δ = 1 − I₃/I₁, the shape: -1 a disc, 0 a sphere, towards 1 a needle
  w-perp     ω⊥, angular velocity across the symmetry axis
  w3         ω₃, angular velocity along the symmetry axis
  phi        φ, angle from the dipole to ω⊥, in radians; may be written pi/30
  amplitude  |ω|; with theta, the angle from the symmetry axis to ω, in place of
             w-perp and w3

\b
Levels of the equation of motion:
  order-1    the paper's reduced equation (4.2)-(4.4). For this top it lacks a leading
             term of the full equation: some outcomes, and its threshold at δ = -1/2,
             are not those of the full equation
  order-2 … order-4   the same reduction to higher order, which has that term
  semi       semi-reduced: only the second derivative of ω is replaced. It has that
             term and is as cheap as order 1: use it for outcomes and maps
  full       the full equation on its physical branch (too slow for maps)

\b
Outcomes:
  RESIDUAL   ω → ω∞ ≠ 0, along the dipole. omega_inf is not known where its sign is a
             matter of chance, or where its error may exceed it
  STOP       ω → 0, along an AXIS, ROTATING about the symmetry axis, or WOBBLING about
             the axis across the dipole
  UNDECIDED  the run would take more steps than --max-steps, or chance decides
  FAILED     the state is not a number
certified: the run entered a region that is proven to decide for this level of the
equation; the difference between this level and the full equation is not counted.
predicted: not integrated, but by the average over free rotation, SLOW_FLOW or AVERAGED;
by the capture of a slow needle, UNFOLDED; or in closed form, EXACT."""

TIMES = {"s": 1.0, "m": 60.0, "h": 3600.0}
LENGTHS = {"pm": 1e-12, "Å": 1e-10, "nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
LENGTHS |= dict.fromkeys(("µm", "μm"), 1e-6)
LENGTH = re.compile(r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zÅµμ]*)", re.ASCII)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def name_of(word: str) -> str:
    """The name of an axis in a `Grid`, which the command line spells with hyphens."""
    return word.replace("-", "_")


def spelled(name: str) -> str:
    """The word of the command line for a quantity."""
    return name.replace("_", "-")


class Kind(click.ParamType):
    """A kind of values on the command line.

    Args:
        name: what the help calls them.
        read: the function from a text to the value; None, or an error, where there is none.
        what: what such a text is not, with examples.
    """

    def __init__(self, name: str, read: Callable[[str], Any], what: str) -> None:
        self.name, self.read, self.what = name, read, what

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value that a text stands for."""
        if not isinstance(value, str):  # a default
            return value
        with contextlib.suppress(KeyError, ValueError):
            if (read := self.read(value)) is not None:
                return read
        self.fail(f"{value!r} is not {self.what}.", param, ctx)


def _size(text: str) -> tuple[int, ...] | None:
    """The size of a grid: N for N × N, or NXxNY."""
    parts = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    numbers = tuple(int(n) for n in parts.groups(parts[1])) if parts else (0,)
    return numbers if min(numbers) > 1 else None


def _seconds(text: str) -> float | None:
    """A time as 90s, 30m, 2h, or as batch systems write it: [[hours:]minutes:]seconds."""
    if re.fullmatch(r"\d+(\.\d+)?[smh]", text):
        return float(text[:-1]) * TIMES[text[-1]] or None
    parts = text.split(":") if re.fullmatch(r"(\d+:){0,2}\d+", text) else ()
    return sum(float(part) * 60**k for k, part in enumerate(reversed(parts))) or None


def _three_numbers(text: str) -> tuple[float, ...] | None:
    numbers = tuple(number_in(part) for part in text.split(","))
    return numbers if len(numbers) == 3 else None


def _direction(text: str) -> tuple[float, ...] | None:
    """A direction of any length except 0."""
    vector = AXES.get(text) or _three_numbers(text)
    return vector if any(vector or ()) else None


def lengths(count: int, example: str) -> Kind:
    """So many lengths in metres, such as 100x60x40nm: one without a unit has that of the last."""

    def read(text: str) -> tuple[float, ...] | None:
        parts = [LENGTH.fullmatch(part.strip()) for part in re.split("[x×]", text)]
        found = [(float(part[1]), part[2]) for part in parts if part]
        if not count == len(parts) == len(found) or min(found)[0] <= 0:
            return None
        return tuple(number * LENGTHS[unit or found[-1][1]] for number, unit in found)

    many = "a positive length" if count == 1 else f"{count} positive lengths"
    return Kind(example, read, f"{many} with a unit (nm, um, mm, …) such as {example}")


NUMBER = Kind("number", number_in, "a finite number such as 0.2, 1e-3 or pi/30")
NUMBERS = Kind("numbers", _three_numbers, "three numbers such as 3,4,5")
DIRECTION = Kind("direction", _direction, "a direction such as x, y, z or 1,0,0.01")
SIZE = Kind("size", _size, "a size such as 512 or 512x256, at least 2")
DURATION = Kind("time", _seconds, "a time such as 90s, 30m, 2h or 1:30:00")
LEVEL = click.Choice([level.value for level in Level])
MAP_LEVEL = click.Choice([level.value for level in Level if level is not Level.FULL])
AXIS = click.Choice(list(map(spelled, QUANTITIES)))
FORMATS = click.Choice(["png", "pdf", "svg"])


def those_given(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """The named options that were given, with their values."""
    return {name: options[name] for name in names if options.get(name) is not None}


def together(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Several options as one decorator."""
    return lambda command: functools.reduce(lambda done, add: add(done), options[::-1], command)


progress_option = click.option(
    "--progress/--quiet",
    default=lambda: sys.stderr.isatty(),
    show_default=False,
    help="Progress bar.  [default: on a terminal]",
)
quantity_options = together(
    *(
        click.option(
            f"--{spelled(name)}",
            type=NUMBER,
            help=f"{quantity.meaning}{' In place of w-perp and w3.' * (name in SPHERICAL)}"
            f"  [default: {as_text(quantity.default).replace('π', 'pi')}]",
        )
        for name, quantity in QUANTITIES.items()
    )
)


def range_option(what: str, axis: Any = AXIS) -> Any:
    """The option --range, which may be given for several axes."""
    several: Any = {"multiple": True, "metavar": "AXIS LOW HIGH"}
    return click.option("--range", "ranges", type=(axis, NUMBER, NUMBER), help=what, **several)


def levels_option(choices: click.Choice, default: tuple[str, ...], what: str) -> Any:
    """The option --level, which may be given several times."""
    several = {"metavar": "LEVEL", "multiple": True, "default": default}
    return click.option("--level", type=choices, help=what, **several)


def output_option(name: str, what: str = "Folder, or first part of the names of all files.") -> Any:
    """The option --output, which has a default and must not be empty."""

    def named(ctx: Any, param: Any, output: str) -> str:
        if not output.strip():
            must = "be a folder or the first part of a file name"
            raise Refusal(f"--output must {must}, but is empty.")
        return output

    return click.option("--output", default=f"dipoletop-{name}", callback=named, help=what)


def picture_options(name: str) -> Callable[[Command], Command]:
    """The options --output and --format of a command that draws one picture."""
    what = "Format of the picture.  [default: png]"
    return together(
        output_option(name), click.option("--format", "suffix", type=FORMATS, help=what)
    )


def output_paths(options: Mapping[str, Any], name: str) -> tuple[Path, Path]:
    """The path that all files begin with, and that of the picture; `name` in a folder.

    The output may end with the format of the picture; a missing folder is made.
    """
    output, suffix = options["output"], options["suffix"]
    base = Path(output)
    if output.endswith(("/", os.sep)) or base.is_dir():
        base = base / name
    if base.suffix[1:] in FORMATS.choices:
        suffix, base = suffix or base.suffix[1:], base.with_suffix("")
    make_folder(base.parent)
    return base, base.with_name(f"{base.name}.{suffix or 'png'}")


def make_folder(folder: Path, given: str = "--output") -> None:
    """Make a folder, and those above it, unless it is there; `given` is what names it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        said = f"{given}: the folder {folder} cannot be made ({plain_reason(error)})."
        raise Refusal(said) from None


def saved(kind: str, path: Path, write: Callable[[Path], Any], about: str = "") -> None:
    """Write a file, and say where it is, and whether it takes the place of another one."""
    notes = [about] if about else []
    notes += ["in place of an older one"] if path.exists() else []
    write(path)
    say(f"{kind}: {path}" + (f" ({'; '.join(notes)})" if notes else ""))


def write_table(picture: Path, columns: Mapping[str, Any]) -> None:
    """Write columns beside their picture as CSV, whose 17 digits give every number back exactly."""
    import numpy as np

    rows, header = np.column_stack(list(columns.values())), ",".join(columns)
    saved(
        "Data",
        picture.with_suffix(".csv"),
        lambda path: np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=header, comments=""),
    )


def start_values(given: Mapping[str, Any], axes: tuple[str, ...] = ()) -> dict[str, float]:
    """The quantities that fix δ and ω₀, as given or by default, without the `axes` of a map.

    Raises:
        Refusal: an axis that is given, or ω⊥ or ω₃ with |ω| or ϑ.
        ValueError: a value that cannot be.
    """
    fixed = those_given(given, *QUANTITIES)
    for name in axes:
        if name in fixed:
            use = f"use --range {spelled(name)} LOW HIGH"
            raise Refusal(f"--{spelled(name)} would fix an axis of the map; {use}.")
    named = {*axes, *fixed}
    if named & SPHERICAL and named & CYLINDRICAL:
        mixed = sorted(map(spelled, named & (SPHERICAL | CYLINDRICAL)))
        raise Refusal(
            f"{' and '.join(mixed)} cannot be mixed: "
            "the start is given by w-perp and w3, or by amplitude and theta."
        )
    left_out = {*axes, *(CYLINDRICAL if named & SPHERICAL else SPHERICAL)}
    return {
        name: checked(name, fixed.get(name, quantity.default), quantity)
        for name, quantity in QUANTITIES.items()
        if name not in left_out
    }


def grid_over(
    axes: tuple[str, str],
    ranges: Mapping[str, Any],
    size: tuple[int, int],
    given: Mapping[str, Any],
) -> "tuple[Grid, str]":
    """The grid over two quantities, and a line that describes it.

    A quantity that is fixed is an axis of length 1, so that the data hold all of them. The axes
    x and y of the map come last, x after y.

    Raises:
        Refusal: axes, ranges or values that do not go together.
        ValueError: a value that cannot be.
    """
    import numpy as np

    from .._maps.grids import Grid

    x, y = map(spelled, axes)
    if x == y:
        raise Refusal(f"--x and --y must be two different quantities, but are both {x}.")
    for name in ranges:
        if name not in axes:
            raise Refusal(f"--range {spelled(name)}: the axes of this map are {x} and {y}.")
    fixed, swept, spans = start_values(given, axes), {}, []
    for name, n in zip(axes, size, strict=True):
        quantity = QUANTITIES[name]
        low, high = (checked(name, end, quantity) for end in ranges.get(name, quantity[3:5]))
        if not low < high:
            raise Refusal(f"--range {spelled(name)}: {low:g} must be less than {high:g}.")
        swept[name] = np.linspace(low, high, n, endpoint=not _repeats(name, low, high))
        spans.append(f"{quantity.symbol} from {as_text(low)} to {as_text(high)}")
    text = f"{size[0]} × {size[1]} starts: {', '.join(spans)}, at {describe(fixed)}"
    return Grid(**fixed, **dict(reversed(swept.items()))), text


def _repeats(name: str, low: float, high: float) -> bool:
    """Whether outcomes at both ends of a range are the same: they repeat after φ → φ + π."""
    half_turns = (high - low) / math.pi
    return name == "phi" and math.isclose(half_turns, round(half_turns), abs_tol=1e-9)
