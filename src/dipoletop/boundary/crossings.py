"""Where segments cross a basin boundary, to rounding, and its normals and derivatives there.

The boundary between two fates is found from labels alone: sweep after sweep divides segments into
many parts. On its residual side ω∞ itself determines the boundary: there

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

from .._base.checks import finite, instance, names_of, positive
from .._base.refusals import refuse
from .._base.summaries import span
from .._base.tolerances import check_settings
from .._base.types import Fate
from .._maps.basin import Basin
from .._maps.grids import Points
from .._maps.problems import Problem, check_problem
from .._maps.sweep import PointSweeps
from .._runs.classification import UNCHECKED
from .fates import fate, is_residual

RTOL = 1e-10  # default relative tolerance of the runs
ROUNDING = 2.0**-52  # smallest width of a bracket, as a fraction of its segment
TILE = 128  # points that a sweep integrates at about the cost of one
DISTANCE = 10.0  # distance from the boundary at which its normal is taken, in units of rtol

Coordinates = dict[str, Float[np.ndarray, "N"]]
"""The coordinates of N points, by the names of the arguments of a problem."""


@dataclass(frozen=True)
class Crossings:
    """Where N segments a → b cross a basin boundary; NaN where they do not.

    Attributes:
        sweeps: the sweeps of the problem whose boundary it is.
        a: the coordinates of one end of each segment, name = values of shape (N,).
        b: the coordinates of the other end.
        bracket: fractions of the segments between which the fate changes, shape (N, 2).
        fates: members of `Fate` at the two sides of the bracket, shape (N, 2).

    Properties: `found`, whether a segment crosses the boundary; `s`, the fraction at which it does;
    `width` of the bracket; `before` and `after`, the coordinates of its two sides; and `at(s)`,
    the coordinates at any fractions.
    """

    sweeps: PointSweeps
    a: Coordinates
    b: Coordinates
    bracket: Float[np.ndarray, "N 2"]
    fates: Int[np.ndarray, "N 2"]

    def at(self, s: Float[np.ndarray, "N *m"]) -> dict[str, Float[np.ndarray, "N *m"]]:
        """Return the coordinates at fractions s of the segments: a + s(b − a)."""
        shape = (-1,) + (1,) * (s.ndim - 1)
        a = {name: values.reshape(shape) for name, values in self.a.items()}
        return {name: a[name] + s * (self.b[name].reshape(shape) - a[name]) for name in a}

    @property
    def found(self) -> Bool[np.ndarray, "N"]:
        """Whether the ends of the segment have different fates."""
        return np.isfinite(self.s)

    @property
    def s(self) -> Float[np.ndarray, "N"]:
        """The fraction of the segment at which it crosses the boundary, in [0, 1]."""
        return self.bracket.mean(axis=1)

    @property
    def width(self) -> Float[np.ndarray, "N"]:
        """The width of the bracket over the segment: about 2e-16 if all runs were decided."""
        return self.bracket[:, 1] - self.bracket[:, 0]

    @property
    def before(self) -> Coordinates:
        """The last point with the fate of a."""
        return self.at(self.bracket[:, 0])

    @property
    def after(self) -> Coordinates:
        """The first point with another fate."""
        return self.at(self.bracket[:, 1])

    def __repr__(self) -> str:
        counts = f"{len(self.bracket)} segments, {self.found.sum()} crossed"
        return f"Crossings({counts}, s={span(self.s)}, width={span(self.width)})"


def bisect(
    problem: Problem, a: Mapping[str, Any], b: Mapping[str, Any], **settings: Any
) -> Crossings:
    """Find the boundary between the fates of a and b on the segments a + s(b − a), to rounding.

    All segments are divided at once, each into many parts. The first part in which the fate changes
    is divided again. So the crossing is the one nearest to a, among the changes that the parts
    show. A point that is undecided or failed is ignored: the bracket stays between the last
    decided points, and its `width` shows it.

    Args:
        problem: a problem as for `sweep`.
        a: coordinates of one end, name = a number or shape (N,): the arguments of `problem`.
        b: coordinates of the other end.
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
        >>> crossings = bisect(problem, {"z": 4.0}, {"z": 4.5})
        >>> [dt.Fate(number).name for number in crossings.fates[0]]
        ['POSITIVE', 'ROTATING']
        >>> crossings.before["z"].round(3).tolist()
        [4.255]
    """
    crossings = narrow(new_crossings(problem, a, b, settings))
    if not crossings.found.any():
        for end in (crossings.a, crossings.b):
            problem(**{name: x[0] for name, x in end.items()})  # raises if the arguments are bad
        first = " and ".join(Fate(number).name for number in crossings.fates[0])
        refuse("b", "end otherwise than `a` in some segment", f"the first one ends in {first}")
    return crossings


def new_crossings(
    problem: Problem, a: Mapping[str, Any], b: Mapping[str, Any], settings: dict[str, Any]
) -> Crossings:
    """Check a user's segments, and return them with the whole segment as the bracket."""
    check_problem(problem)
    return unsearched(sweeps_of(jax.jit(problem), settings), *_broadcast_ends(a, b))


def sweeps_of(problem: Problem, settings: dict[str, Any]) -> PointSweeps:
    """Return the sweeps that find the boundary of a problem."""
    check_settings(settings)
    # Unchecked, since near the computed boundary the sign of ω∞ is not certain.
    return PointSweeps(problem, {"rtol": RTOL} | settings | {"value": UNCHECKED})


def _broadcast_ends(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Coordinates, Coordinates]:
    """Return both ends as arrays of one length."""
    if not (isinstance(a, Mapping) and a):
        refuse("a", "map the names of coordinates to values", f"is {a!r}")
    if not (isinstance(b, Mapping) and set(b) == set(a)):
        names = ", ".join(map(str, a))
        refuse("b", f"name the coordinates of `a` ({names})", f"is {b!r}")
    ends = [{name: np.asarray(finite(name, end[name])) for name in a} for end in (a, b)]
    lengths = {x.size for end in ends for x in end.values() if x.ndim}
    if len(lengths) > 1 or 0 in lengths:
        refuse("a", "have, with `b`, one length of at least 1", f"has lengths {sorted(lengths)}")
    length = max(lengths, default=1)
    first, last = ({k: np.broadcast_to(x, length) for k, x in end.items()} for end in ends)
    return first, last


def unsearched(sweeps: PointSweeps, a: Coordinates, b: Coordinates) -> Crossings:
    """Return segments whose bracket is the whole segment."""
    length = len(next(iter(a.values())))
    bracket = np.tile([0.0, 1.0], (length, 1))
    fates = np.full((length, 2), Fate.UNDECIDED)
    return Crossings(sweeps, a, b, bracket, fates)


def unsearched_rows(crossings: Crossings, rows: Int[np.ndarray, "n"]) -> Crossings:
    """Return the segments of the given rows, with the whole segment as the bracket."""
    a = {name: values[rows] for name, values in crossings.a.items()}
    b = {name: values[rows] for name, values in crossings.b.items()}
    return unsearched(crossings.sweeps, a, b)


def _sweep_at(
    crossings: Crossings, s: Float[np.ndarray, "N *m"], derivatives: tuple[str, ...] = ()
) -> Basin:
    """Sweep over the points at the given fractions, in C order."""
    points = Points(**{name: x.ravel() for name, x in crossings.at(s).items()})
    return crossings.sweeps(points, derivatives)


def fates_at(crossings: Crossings, s: Float[np.ndarray, "N m"]) -> Int[np.ndarray, "N m"]:
    """Return the fates of the points at the given fractions."""
    return fate(_sweep_at(crossings, np.nan_to_num(s))).reshape(s.shape)


def narrow(
    crossings: Crossings, width: float = ROUNDING, *, ends_may_agree: bool = False
) -> Crossings:
    """Divide the brackets until they are as narrow as `width`.

    A segment whose ends have the same fate has no crossing, unless `ends_may_agree`: then its
    first part with another fate counts.
    """
    bracket, fates = crossings.bracket, crossings.fates
    parts = int(np.clip(TILE // len(bracket), 16, TILE)) - 1  # at least 4 bits a sweep, nearly
    rows = np.arange(len(bracket))[:, None]
    for division in range(int(np.ceil(np.log(width) / -np.log(parts)))):
        s = bracket[:, :1] + (bracket[:, 1:] - bracket[:, :1]) * np.linspace(0, 1, parts + 1)
        s[:, -1] = bracket[:, 1]
        seen = fates_at(crossings, s)
        if division > 0:  # the fates of the ends are known from the division before
            seen[:, [0, -1]] = fates
        change, crossed = first_change(seen)
        ends_differ = (seen[:, 0] != seen[:, -1]) & (seen[:, -1] > Fate.UNDECIDED)
        crossed &= ends_may_agree | ends_differ
        bracket = np.where(crossed[:, None], s[rows, change], np.nan)
        fates = np.where(crossed[:, None], seen[rows, change], seen[:, [0, -1]])
        if not np.any(bracket[:, 1] - bracket[:, 0] > width):
            break
    return replace(crossings, bracket=bracket, fates=fates)


def first_change(
    fates: Int[np.ndarray, "N m"],
) -> tuple[Int[np.ndarray, "N 2"], Bool[np.ndarray, "N"]]:
    """Return the last place before a change of fate and the first after it, and whether it exists.

    Places without a fate are skipped.
    """
    decided = fates > Fate.UNDECIDED
    other = decided & (fates != fates[:, :1])
    after = np.argmax(other, axis=1)
    same = decided & (np.arange(fates.shape[1]) < after[:, None])
    before = fates.shape[1] - 1 - np.argmax(same[:, ::-1], axis=1)
    return np.stack([before, after], axis=1), decided[:, 0] & other.any(axis=1)


def normal(
    crossings: Crossings, names: str | Sequence[str], *, distance: float | None = None
) -> Float[np.ndarray, "N k"]:
    """Compute ∇|ω∞| / |∇|ω∞||, the unit normal of the boundary, at each crossing.

    It points to the side of residual rotation; between two opposite senses, to the side of a.

    Args:
        crossings: a result of `bisect`.
        names: coordinates of the problem, k of them, parameters such as δ among them.
        distance: the distance from the boundary, in units of the segment, at which ω∞ is
            differentiated; None means 10 rtol. The error of the direction is of this size; but
            nearer than rtol the runs may lie on the other side.

    Returns:
        Shape (N, k); NaN where neither side is of residual rotation, or where that side is thinner
        than `distance`.

    Raises:
        ValueError: a name that is not a coordinate; a distance that is not positive.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect, normal
        >>> def problem(w3, phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
        >>> crossings = bisect(problem, {"w3": 0.2, "phi": 0.0}, {"w3": 0.2, "phi": 1.0})
        >>> normal(crossings, ["w3", "phi"]).shape
        (1, 2)
    """
    instance("crossings", crossings, Crossings)
    names = names_of("names", names)
    if not names:
        refuse("names", "hold at least one name", "holds none")
    gradient = residual_gradient(crossings, names, distance)
    return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


def residual_gradient(
    crossings: Crossings, names: tuple[str, ...], distance: float | None
) -> Float[np.ndarray, "N k"]:
    """Compute ∇|ω∞| at a small distance from the boundary, on the side of residual rotation."""
    for name in names:
        if name not in crossings.a:
            refuse("names", f"be among {', '.join(crossings.a)}", f"one is {name!r}")
    if distance is None:
        distance = DISTANCE * float(crossings.sweeps.rtol)
    distance = float(positive("distance", distance, batch=False))
    at_a = residual_at_a(crossings)
    s = np.where(at_a, crossings.bracket[:, 0] - distance, crossings.bracket[:, 1] + distance)
    basin = _sweep_at(crossings, np.nan_to_num(s), derivatives=names)
    gradient = np.stack([basin.derivative(name) for name in names], axis=1)
    expected = np.where(at_a, crossings.fates[:, 0], crossings.fates[:, 1])
    inside = crossings.found & is_residual(expected) & (fate(basin) == expected)
    return np.where(inside[:, None], gradient * np.sign(basin.omega_inf)[:, None], np.nan)


def residual_at_a(crossings: Crossings) -> Bool[np.ndarray, "N"]:
    """Return whether the side of a is of residual rotation."""
    return is_residual(crossings.fates[:, 0])


def derivative(
    crossings: Crossings, of: str, by: str | Sequence[str], *, distance: float | None = None
) -> Float[np.ndarray, "N *k"]:
    """Compute dx/dp = −(∂ω∞/∂p)/(∂ω∞/∂x), by which the boundary moves along x = `of` with p = `by`.

    Args:
        crossings: a result of `bisect`; both names are among its coordinates.
        of: the coordinate of the boundary point, the others being fixed.
        by: another coordinate or a parameter, such as "delta", or k of them.
        distance: as in `normal`.

    Returns:
        Shape (N,), or (N, k) for a list; infinite where the boundary is parallel to x; NaN as in
        `normal`.

    Raises:
        ValueError: a name that is not a coordinate, or twice the same; a distance not positive.

    Example:
        The universal boundary of slow tops moves by dz_s/dδ = 32.6859 at φ = 0:

        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect, derivative
        >>> def problem(delta, z):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(1e-3, z * 1e-6, 0.0)
        >>> ends = {"delta": -0.2, "z": 4.0}, {"delta": -0.2, "z": 4.5}
        >>> derivative(bisect(problem, *ends), "z", "delta").round(2)
        array([32.69])
    """
    instance("of", of, str, "be a name")
    several = names_of("by", by)
    if not several or len({of, *several}) <= len(several):
        refuse("by", f"name coordinates other than {of!r}, each once", f"is {by!r}")
    normals = normal(crossings, (of, *several), distance=distance)
    slopes = -normals[:, 1:] / normals[:, :1]
    return slopes[:, 0] if isinstance(by, str) else slopes
