"""The scene of an explorer: quantities, levels to choose from, and the problem that is swept."""

import inspect
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import check_single, check_verdict, instance
from .._base.refusals import refuse
from .._base.types import Equation
from .._maps.problems import Problem, check_problem
from .._maps.top_parameters import QUANTITIES, Quantity, checked, checked_range
from .._maps.top_problems import initial_condition, problem_of_top
from ..equations._families import RIGID, TRANSVERSE
from ..equations.levels import Level
from . import source_code

MAPPED = tuple(level for level in Level if level is not Level.FULL)
"""The levels of maps; not the full equation, which takes milliseconds for each start."""
CYLINDRICAL = "w_perp", "w3", "phi"
SPHERICAL = "amplitude", "theta", "phi"
WHOLE = {"phi": (0.0, 2 * math.pi), "w3": (-0.6, 0.6), "theta": (0.0, math.pi)}
"""Ranges that show all starts, rather than one symmetry cell."""

Over = Mapping[str, Any]
"""For each quantity a number, its first value, or a pair, its range."""


class Source(NamedTuple):
    """The definition of the problem in a script that reproduces a view."""

    before: tuple[str, ...]
    """Lines that precede the definition."""
    problem: Callable[[Level | None, tuple[str, ...]], tuple[str, ...]]
    """Lines that define `problem` of these quantities at a level."""


@dataclass(frozen=True)
class Scene:
    """A problem with its quantities.

    Attributes:
        quantities: quantities by name; the sliders begin at their defaults.
        systems: sets of quantities, each of which fixes equation and start.
        levels: the levels to choose from, the level of a given equation first; () if there is no
            choice.
        problem_at: function from a level (None if there is no choice) to the problem.
        source: the code of the problem.
        symmetric: whether the dipole lies along axis 1 and the axes are principal, so that maps
            over φ and ω₃ have the symmetries of `plots.unfold`.
    """

    quantities: dict[str, Quantity]
    systems: tuple[tuple[str, ...], ...]
    levels: tuple[Level, ...]
    problem_at: Callable[[Any], Problem]
    source: Source
    symmetric: bool

    @property
    def at_first(self) -> tuple[Level, ...]:
        """The level of a page by default."""
        return self.levels[:1]

    @property
    def is_top(self) -> bool:
        """Whether it is the transverse top at any shape and level."""
        return bool(self.levels) and "delta" in self.free

    @property
    def symbols(self) -> dict[str, str]:
        """The symbol of each quantity by its name."""
        return {name: quantity.symbol for name, quantity in self.quantities.items()}

    @property
    def free(self) -> tuple[str, ...]:
        """The quantities that may be varied."""
        return tuple(name for name, x in self.quantities.items() if x.low < x.high)

    def system_of(self, *names: str) -> tuple[str, ...]:
        """Return the first system that has all of these quantities.

        Raises:
            ValueError: no system has them all.
        """
        return _ordered(self.systems, names)[0]


def scene_of(problem: Any, over: Any) -> Scene:
    """Return the scene of what `explore` was given.

    Raises:
        ValueError: it is neither an equation nor a problem, or `over` does not suit it.
    """
    if over is None:
        over = {}
    instance("over", over, Mapping, "map names of quantities to numbers or to ranges")
    if problem is None:
        return scene_of_top(over)
    if isinstance(problem, TRANSVERSE) and Level.labelled(problem.level) in MAPPED:
        check_single(problem)
        given = {"delta": float(problem.delta)} | dict(over)
        return scene_of_top(given, Level.labelled(problem.level))
    if not isinstance(problem, type) and isinstance(problem, Equation):
        return scene_of_equation(problem, over)
    return scene_of_problem(problem, over)


def scene_of_top(over: Over, first: Level = Level.SEMI) -> Scene:
    """Return the scene of the transverse top at any δ and level; pages begin with level `first`."""
    quantities = _quantities(tuple(QUANTITIES), over)
    systems = _ordered((("delta", *CYLINDRICAL), ("delta", *SPHERICAL)), over)
    levels = first, *(level for level in MAPPED if level is not first)
    equation = 'dt.equation_at("{}", delta)'.format
    source = Source((), lambda level, names: source_code.of_starts(names, equation(level)))
    return Scene(quantities, systems, levels, problem_of_top, source, True)


def scene_of_equation(equation: Any, over: Over) -> Scene:
    """Return the scene of the starts of one equation."""
    check_verdict(equation)
    check_single(equation)
    quantities = _quantities(tuple(dict.fromkeys(CYLINDRICAL + SPHERICAL)), over)

    def problem(**point: Any) -> tuple[Equation, Any]:
        return equation, initial_condition(point)

    systems = _ordered((CYLINDRICAL, SPHERICAL), over)
    lines = source_code.of_equation(equation)
    source = Source(lines, lambda _, names: source_code.of_starts(names))
    return Scene(quantities, systems, (), lambda _: problem, source, _is_symmetric(equation))


def scene_of_problem(problem: Any, over: Over) -> Scene:
    """Return the scene of a problem as for `sweep`, over the given ranges of its arguments."""
    check_problem(problem)
    names = tuple(inspect.signature(problem).parameters)
    for name in over:
        if name not in names:
            refuse("over", f"name arguments of `problem` ({', '.join(names)})", f"names {name!r}")
    for name in names:
        if name not in over:
            must = "give a number or a range (low, high) for every argument of `problem`"
            refuse("over", must, f"gives none for `{name}`")
    quantities = {name: _quantity(name, _plain(name), over[name]) for name in names}
    source = Source(source_code.of_function(problem), lambda _, names: ())
    scene = Scene(quantities, (names,), (), lambda _: problem, source, False)
    if len(scene.free) < 2:
        refuse("over", "give a range for at least two arguments", f"gives {len(scene.free)}")
    return scene


def _ordered(
    systems: tuple[tuple[str, ...], ...], names: Collection[str]
) -> tuple[tuple[str, ...], ...]:
    """Return the systems, first those that have all of these quantities; refuse if none has."""
    found = sorted(systems, key=lambda system: not set(names) <= set(system))
    if not set(names) <= set(found[0]):
        ways = " or ".join(", ".join(system) for system in systems)
        refuse("start", f"be given by {ways}", f"is given by {', '.join(names)}")
    return tuple(found)


def _is_symmetric(equation: Any) -> bool:
    """Return whether the symmetries of `plots.unfold` are known to hold."""
    if type(equation) in TRANSVERSE:
        return True
    if type(equation) not in RIGID:
        return False
    inertia, dipole = np.asarray(equation.body.inertia), np.asarray(equation.body.dipole)
    return bool(np.all(inertia == np.diag(np.diag(inertia))) and np.all(dipole[1:] == 0))


def _quantities(names: tuple[str, ...], over: Over) -> dict[str, Quantity]:
    """Return the named quantities, with the ranges or values in `over` in place of the usual."""
    for name in over:
        if name not in names:
            refuse("over", f"name quantities ({', '.join(names)})", f"names {name!r}")
    known = {}
    for name in names:
        low, high = WHOLE.get(name, QUANTITIES[name][3:5])
        usual = QUANTITIES[name]._replace(low=low, high=high)
        known[name] = _quantity(name, usual, over[name]) if name in over else usual
    return known


def _plain(name: str) -> Quantity:
    """Return the quantity of this name without a range (NaN), with symbol and bounds if known."""
    custom = QUANTITIES.get(name, Quantity(name, "", math.nan, math.nan, math.nan))
    return custom._replace(low=math.nan, high=math.nan)


def _quantity(name: str, usual: Quantity, given: Any) -> Quantity:
    """Return a quantity with the given number as its value, or with the given range."""
    if isinstance(given, tuple | list) and len(given) == 2:
        low, high = checked_range(name, given, usual)
        inside = low <= usual.default <= high
        default = usual.default if inside else (low + high) / 2
        return usual._replace(low=low, high=high, default=default)
    value = checked(name, given, usual)
    if math.isnan(usual.low):  # a problem's argument that stays fixed
        return usual._replace(low=value, high=value, default=value)
    low, high = min(usual.low, value), max(usual.high, value)
    return usual._replace(low=low, high=high, default=value)
