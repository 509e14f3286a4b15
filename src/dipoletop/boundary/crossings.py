"""Where segments cross a basin boundary, to rounding, and its normals and derivatives there.

Starts have the same fate if they end in the same way: the same outcome, sign of ω∞ and kind of
stop. The boundary between two fates is found from labels alone, by cutting segments into many
parts, sweep by sweep. On its residual side ω∞ itself knows the boundary: there

    |ω∞| ~ distance^α × (a smooth function),        α > 0,

so as the distance → 0 the gradient of |ω∞| is along the normal, and the boundary's derivatives
follow by the implicit function theorem, dx/dp = −(∂ω∞/∂p)/(∂ω∞/∂x), with an error ~ distance.

The *computed* boundary is itself uncertain by about `rtol`, however closely it is enclosed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from .._base.checks import finite, instance, names_of, refuse
from .._base.tolerances import check_settings
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.grids import Points
from .._maps.problems import check_problem
from .._maps.sweep import Problem, sweep
from .._runs.classification import UNCHECKED

RTOL = 1e-10  # of the runs, unless the user has his own
UNDECIDED = 0  # fates from here down are none
POSITIVE, NEGATIVE = 1, 2  # fates with a residual rotation
STOPPED = 3  # plus the kind of stop
ROUNDING = 2.0**-52  # of the fraction of a segment
TILE = 128  # points that a sweep takes at once at the same cost as one
DISTANCE = 10.0  # from the boundary, where its normal is read off, in units of rtol


def fate(basin: Basin) -> Int[np.ndarray, "*shape"]:
    """How every start ends, as one number: two starts have the same fate iff theirs agree.

    Args:
        basin: what `sweep` found, with `value=True`.

    Returns:
        −1 FAILED; 0 UNDECIDED, also if the sign of ω∞ is not known; 1 or 2 RESIDUAL with ω∞ > 0
        or ω∞ < 0; 3 + kind for STOP, the kind being a member of `Stop`. Shape of the basin.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import fate
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> fate(dt.sweep(problem, dt.Points(phi=[0.1, 1.0, 3.2])))
        array([1, 5, 2])
    """
    instance("basin", basin, Basin)
    outcome, value = basin.outcome.astype(int), basin.omega_inf
    residual = np.select([value > 0, value < 0], [POSITIVE, NEGATIVE], UNDECIDED)
    ended = [outcome == Outcome.RESIDUAL, outcome == Outcome.STOP]
    return np.select(ended, [residual, STOPPED + basin.stop.astype(int)], outcome)


@dataclass(frozen=True)
class Crossings:
    """Where N segments a → b cross a basin boundary; NaN where none was found.

    Attributes:
        problem: the problem whose boundary it is.
        a: the coordinates of one end of each segment, name = values of shape (N,).
        b: those of the other end.
        bracket: fractions of the segments between which the fate changes, shape (N, 2).
        fates: those at the two sides of the bracket, shape (N, 2).
        settings: of the sweeps.
    """

    problem: Problem
    a: dict[str, Float[np.ndarray, "N"]]
    b: dict[str, Float[np.ndarray, "N"]]
    bracket: Float[np.ndarray, "N 2"]
    fates: Int[np.ndarray, "N 2"]
    settings: dict[str, Any]

    def at(self, s: Float[np.ndarray, "N *m"]) -> dict[str, Float[np.ndarray, "N *m"]]:
        """The coordinates at fractions s of the segments: a + s(b − a)."""
        shape = (-1,) + (1,) * (s.ndim - 1)
        ends = {name: (x.reshape(shape), self.b[name].reshape(shape)) for name, x in self.a.items()}
        return {name: a + s * (b - a) for name, (a, b) in ends.items()}

    @property
    def found(self) -> Bool[np.ndarray, "N"]:
        """Whether the ends of the segment had different fates."""
        return np.isfinite(self.s)

    @property
    def s(self) -> Float[np.ndarray, "N"]:
        """The fraction of the segment at which it is crossed, in [0, 1]."""
        return self.bracket.mean(axis=1)

    @property
    def width(self) -> Float[np.ndarray, "N"]:
        """Of the bracket, as a fraction of the segment: about 2e-16 if all runs were decided."""
        return self.bracket[:, 1] - self.bracket[:, 0]

    @property
    def before(self) -> dict[str, Float[np.ndarray, "N"]]:
        """The last point with the fate of a."""
        return self.at(self.bracket[:, 0])

    @property
    def after(self) -> dict[str, Float[np.ndarray, "N"]]:
        """The first point with another fate."""
        return self.at(self.bracket[:, 1])


def bisect(
    problem: Problem, a: Mapping[str, Any], b: Mapping[str, Any], **settings: Any
) -> Crossings:
    """The boundary between the fates of a and b on the segments a + s(b − a), to rounding.

    All segments are cut at once, each into many parts, and of the parts in which the fate changes
    the first is cut again. So the change is that nearest to a, among those that the parts showed.
    A point inside that is undecided or failed stands for nothing: the bracket stays between the
    last decided points, and its `width` tells.

    Args:
        problem: a problem as for `sweep`.
        a: coordinates of one end, name = a number or shape (N,): the arguments of `problem`.
        b: those of the other end.
        settings: rtol, here 1e-10, atol, max_steps, devices and engine, as in `sweep`. The
            computed boundary is itself uncertain by about `rtol`.

    Returns:
        `Crossings`; NaN where the ends have the same fate or one has none.

    Raises:
        ValueError: bad arguments, or no segment whose ends have different fates.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect
        >>> def problem(z):  # the limit of small amplitudes has its boundary at 4.25533557…
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(1e-3, z * 1e-6, 0.0)
        >>> cross = bisect(problem, {"z": 4.0}, {"z": 4.5})
        >>> cross.fates.tolist(), cross.before["z"].round(3).tolist()
        ([[1, 5]], [4.255])
    """
    crossings = cut(asked(problem, a, b, settings))
    if not crossings.found.any():
        for end in (crossings.a, crossings.b):
            problem(**{name: x[0] for name, x in end.items()})  # says why, if it cannot be made
        fates = crossings.fates[0].tolist()
        refuse("b", "end otherwise than `a` in some segment", f"the fates are {fates} in the first")
    return crossings


def asked(
    problem: Problem, a: Mapping[str, Any], b: Mapping[str, Any], settings: dict[str, Any]
) -> Crossings:
    """Segments as a user asks for them, that nothing is known of yet."""
    check_problem(problem)
    return segments(jax.jit(problem), *columns_of_ends(a, b), settings)


def columns_of_ends(
    a: Mapping[str, Any], b: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Both ends as arrays of one length."""
    if not (isinstance(a, Mapping) and a):
        refuse("a", "map the names of coordinates to values", f"is {a!r}")
    if not (isinstance(b, Mapping) and set(b) == set(a)):
        names = ", ".join(map(str, a))
        refuse("b", f"name the coordinates of `a` ({names})", f"is {b!r}")
    columns = [{name: np.asarray(finite(name, x[name])) for name in a} for x in (a, b)]
    lengths = {x.size for column in columns for x in column.values() if x.ndim}
    if len(lengths) > 1 or 0 in lengths:
        refuse("a", "have, with `b`, one length of at least 1", f"has lengths {sorted(lengths)}")
    length = max(lengths, default=1)
    start, end = ({k: np.broadcast_to(x, length) for k, x in column.items()} for column in columns)
    return start, end


def segments(problem: Problem, a: dict, b: dict, settings: dict[str, Any]) -> Crossings:
    """Segments that nothing is known of yet."""
    check_settings(settings)
    length = len(next(iter(a.values())))
    bracket = np.tile([0.0, 1.0], (length, 1))
    fates = np.full((length, 2), UNDECIDED)
    return Crossings(problem, a, b, bracket, fates, {"rtol": RTOL} | settings)


def _swept(crossings: Crossings, s: Float[np.ndarray, "N *m"], **options: Any) -> Basin:
    """What becomes of the points at these fractions, in C order."""
    points = Points(**{name: x.ravel() for name, x in crossings.at(s).items()})
    # The boundary of the computed map is looked for, up to where the sign of ω∞ is not certain.
    return sweep(crossings.problem, points, value=UNCHECKED, **crossings.settings, **options)


def fates_at(crossings: Crossings, s: Float[np.ndarray, "N m"]) -> Int[np.ndarray, "N m"]:
    """The fates of the points at these fractions."""
    return fate(_swept(crossings, np.nan_to_num(s))).reshape(s.shape)


def cut(crossings: Crossings, to: float = ROUNDING, *, scan: bool = False) -> Crossings:
    """Cut the brackets until they are as narrow; with `scan` the ends may have the same fate."""
    bracket, fates = crossings.bracket, crossings.fates
    parts = int(np.clip(TILE // len(bracket), 16, TILE)) - 1  # at least 4 bits a sweep, nearly
    known = False
    for _ in range(int(np.ceil(np.log(to) / -np.log(parts)))):
        s = bracket[:, :1] + (bracket[:, 1:] - bracket[:, :1]) * np.linspace(0, 1, parts + 1)
        s[:, -1] = bracket[:, 1]
        seen = fates_at(crossings, s)
        if known:
            seen[:, [0, -1]] = fates
        first, there = first_change(seen)
        rows = np.arange(len(s))[:, None]
        if not known:
            there &= scan | ((seen[:, 0] != seen[:, -1]) & (seen[:, -1] > UNDECIDED))
            fates = np.where(there[:, None], fates, seen[:, [0, -1]])
        bracket = np.where(there[:, None], s[rows, first], np.nan)
        fates = np.where(there[:, None], seen[rows, first], fates)
        known = True
        if not np.any(bracket[:, 1] - bracket[:, 0] > to):
            break
    return replace(crossings, bracket=bracket, fates=fates)


def first_change(
    fates: Int[np.ndarray, "N m"],
) -> tuple[Int[np.ndarray, "N 2"], Bool[np.ndarray, "N"]]:
    """The first place with another fate than that of place 0, the last before; whether there is."""
    decided = fates > UNDECIDED
    other = decided & (fates != fates[:, :1])
    after = np.argmax(other, axis=1)
    same = decided & (np.arange(fates.shape[1]) < after[:, None])
    before = fates.shape[1] - 1 - np.argmax(same[:, ::-1], axis=1)
    return np.stack([before, after], axis=1), decided[:, 0] & other.any(axis=1)


def normal(
    crossings: Crossings, names: Sequence[str], *, distance: float | None = None
) -> Float[np.ndarray, "N k"]:
    """The unit normal ∇|ω∞| / |∇|ω∞|| of the boundary in these coordinates, at each crossing.

    It points into the side of residual rotation; between two of opposite senses, into that of a.

    Args:
        crossings: what `bisect` found.
        names: coordinates of the problem, k of them, parameters such as δ among them.
        distance: from the boundary, in units of the segment, where ω∞ is differentiated; None
            means 10 rtol. The error of the direction is of this size; but nearer than rtol the
            runs may find themselves on the other side.

    Returns:
        Shape (N, k); NaN where neither side is one of residual rotation, or where that is
        thinner than `distance`.

    Raises:
        ValueError: a name that is no coordinate; a distance that is not positive.
    """
    instance("crossings", crossings, Crossings)
    if not names_of("names", names):
        refuse("names", "hold at least one name", "holds none")
    gradient = gradient_inwards(crossings, names_of("names", names), distance)
    return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


def gradient_inwards(
    crossings: Crossings, names: Sequence[str], distance: float | None
) -> Float[np.ndarray, "N k"]:
    """∇|ω∞| a little way into the side of residual rotation."""
    for name in names:
        if name not in crossings.a:
            refuse("names", f"be among {', '.join(crossings.a)}", f"one is {name!r}")
    if distance is None:
        distance = DISTANCE * float(crossings.settings["rtol"])
    distance = float(finite("distance", distance, batch=False))
    if distance <= 0:
        refuse("distance", "be positive, or None", f"is {distance:g}")
    first = backed(crossings)
    s = np.where(first, crossings.bracket[:, 0] - distance, crossings.bracket[:, 1] + distance)
    basin = _swept(crossings, np.nan_to_num(s), derivatives=tuple(names))
    gradient = np.stack([basin.derivative(name) for name in names], axis=1)
    wanted = np.where(first, crossings.fates[:, 0], crossings.fates[:, 1])
    inside = crossings.found & np.isin(wanted, (POSITIVE, NEGATIVE)) & (fate(basin) == wanted)
    return np.where(inside[:, None], gradient * np.sign(basin.omega_inf)[:, None], np.nan)


def backed(crossings: Crossings) -> Bool[np.ndarray, "N"]:
    """Whether the side of a is one of residual rotation."""
    return np.isin(crossings.fates[:, 0], (POSITIVE, NEGATIVE))


def derivative(
    crossings: Crossings, of: str, by: str | Sequence[str], *, distance: float | None = None
) -> Float[np.ndarray, "N *k"]:
    """dx/dp = −(∂ω∞/∂p)/(∂ω∞/∂x): how the boundary moves along x = `of` with p = `by`.

    Args:
        crossings: what `bisect` found; both names are among its coordinates.
        of: the coordinate of the boundary point, the others being held.
        by: another coordinate or a parameter, such as "delta", or k of them.
        distance: as in `normal`.

    Returns:
        Shape (N,), or (N, k) for a list; infinite where the boundary is parallel to x; NaN as in
        `normal`.

    Raises:
        ValueError: a name that is no coordinate, or twice the same; a distance not positive.

    Example:
        The universal boundary of slow tops moves by dz_s/dδ = 32.6859 at φ = 0:

        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect, derivative
        >>> def problem(delta, z):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(1e-3, z * 1e-6, 0.0)
        >>> cross = bisect(problem, {"delta": -0.2, "z": 4.0}, {"delta": -0.2, "z": 4.5})
        >>> derivative(cross, "z", "delta").round(2)
        array([32.69])
    """
    instance("of", of, str, "be a name")
    several = names_of("by", by)
    if not several or len({of, *several}) <= len(several):
        refuse("by", f"name coordinates other than {of!r}, each once", f"is {by!r}")
    across, *along = normal(crossings, (of, *several), distance=distance).T
    slopes = -np.stack(along, axis=1) / across[:, None]
    return slopes[:, 0] if isinstance(by, str) else slopes
