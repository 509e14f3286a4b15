"""The boundary curve in a plane of two coordinates, by pseudo-arclength continuation.

From a boundary point with unit normal n the next point is sought near

    point + h R(β/2) t,        t ⊥ n,

where h is the step, t the tangent, β the angle by which the curve turned over the last step and R
a rotation: an arc with the last curvature. Across it, along R(β)n, the boundary is bisected between
the same two fates. The gradient of ω∞ there gives the new normal (see `crossings`).
"""

import enum
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .._base.checks import corners_of_box, finite, instance
from .._base.refusals import refuse
from .._base.summaries import summary
from .._base.tolerances import budget
from .._base.types import Equation
from .._maps.sweep import PointSweeps
from .crossings import DISTANCE, Crossings, narrow, residual_at_a, residual_gradient, unsearched

PRECISION = 1e-10  # error of the points of a curve, in units of the box
GOOD_TURN, MOST_TURN = 0.35, 0.5  # radians from one point of a curve to the next
LEAST_TURN = 1e-9  # radians: a lower bound, so that a step never grows without bound
LEAST_STEP = 2.0**-16  # in units of the longest step; below it the curve counts as lost
GROWTH = 1.5  # largest factor from one step to the next
REACHES = (1 / 8, 1 / 2)  # half lengths of the segments across the curve, in units of the step

Vector = Float[np.ndarray, "2"]


class CurveEnd(enum.StrEnum):
    """Why a boundary curve ends."""

    CLOSED = "closed"
    """The curve came back to its first point."""
    BOUNDS = "bounds"
    """The curve leaves the box."""
    POINTS = "points"
    """The curve has as many points as asked for."""
    LOST = "lost"
    """No next point was found with the smallest step, as in a tongue that becomes too thin."""


class Curve(NamedTuple):
    """A piece of the boundary in a plane of two coordinates."""

    points: Float[np.ndarray, "n 2"]
    """Boundary points in order; a closed curve ends at its first point."""
    normals: Float[np.ndarray, "n 2"]
    """Unit normals, from the side of a to the side of b of the crossing."""
    shift: Float[np.ndarray, "n 2"] | None
    """How the boundary moves along its normal (in the plane scaled by `bounds`) with `by`."""
    end: CurveEnd
    """The reason why it ends; a member equals its word "closed", "bounds", "points" or "lost"."""

    def __repr__(self) -> str:
        return summary(self, "normals", "shift")


@dataclass(frozen=True)
class _BoundaryPoint:
    """A boundary point, in coordinates of the plane that are scaled by the box."""

    point: Vector
    normal: Vector
    shift: Vector


def trace(
    crossing: Crossings,
    bounds: Mapping[str, Any],
    *,
    step: float = 0.02,
    n: int = 200,
    by: str | None = None,
) -> Curve:
    """Follow the boundary curve through a crossing in a plane of two coordinates.

    The method is pseudo-arclength continuation. After a step along the tangent the boundary is
    sought across it, between the same two fates, to 1e-10 of the box. A step is halved if that
    fails or if the curve turns by more than half a radian; so folds are passed, and tongues are
    followed until they are too thin. Where neither side is of residual rotation, the tangent runs
    through the last two points.

    Args:
        crossing: one crossing by `bisect`. All other coordinates are fixed.
        bounds: the plane and its box: two coordinates, name = (least, largest).
        step: the longest step, in units of the box. For positive steps the fate of b is on the
            right (the first coordinate to the right, the second upwards); for negative, left.
        n: the largest number of points.
        by: a coordinate of the problem, such as "delta", for which the derivative `shift` of the
            boundary is computed.

    Returns:
        A `Curve`.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect, trace
        >>> def problem(phi, z):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(1e-3, z * 1e-6, phi)
        >>> crossing = bisect(problem, {"phi": 0.0, "z": 4.0}, {"phi": 0.0, "z": 4.5})
        >>> curve = trace(crossing, {"phi": (-1.0, 1.0), "z": (0.0, 8.0)}, n=3)
        >>> curve.points.shape, curve.end == "points"
        ((3, 2), True)
    """
    low, size = _box(crossing, bounds)
    step = float(finite("step", step, batch=False))
    if step == 0:
        refuse("step", "not be 0", "is 0")
    if by is not None and (by not in crossing.a or by in bounds):
        refuse("by", "name another coordinate of the crossing", f"is {by!r}")
    scaled = _in_units_of_box(crossing, tuple(bounds), size)
    followed, end = _follow(scaled, low, step, budget("n", n), by)
    points = np.stack([each.point for each in followed]) * size
    normals = np.stack([each.normal for each in followed]) / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shift = None if by is None else np.stack([each.shift for each in followed]) * size
    return Curve(points, normals, shift, end)


def _follow(
    start: Crossings, low: Vector, step: float, n: int, by: str | None
) -> tuple[list[_BoundaryPoint], CurveEnd]:
    """Step along the curve until it closes, leaves the box, is lost, or has n points."""
    points = [_first_point(start, by)]
    side, h, curvature = np.sign(step), abs(step), 0.0
    while len(points) < n:
        last = points[-1]
        if len(points) > 3 and _reaches(last, points[0], side, h):
            return [*points, points[0]], CurveEnd.CLOSED
        new = _next_point(start, last, side * h, curvature * h, by)
        angle = np.pi if new is None else _angle(last.normal, new.normal)
        if new is None or abs(angle) > MOST_TURN:
            h /= 2
            if h > LEAST_STEP * abs(step):
                continue
            return points, CurveEnd.LOST
        if np.any((new.point < low) | (new.point > low + 1)):
            return points, CurveEnd.BOUNDS
        points.append(new)
        curvature = angle / h
        h = min(abs(step), h * min(GROWTH, GOOD_TURN / max(abs(angle), LEAST_TURN)))
    return points, CurveEnd.POINTS


def _reaches(point: _BoundaryPoint, goal: _BoundaryPoint, side: float, h: float) -> bool:
    """Return whether the next step would come to the goal, along the same piece of the curve."""
    ahead = goal.point - point.point
    along, across = side * _quarter_turn(point.normal) @ ahead, point.normal @ ahead
    same_side = point.normal @ goal.normal > 0
    return bool(0 < along <= h and abs(across) < h * MOST_TURN and same_side)


def _box(crossing: Crossings, bounds: Mapping[str, Any]) -> tuple[Vector, Vector]:
    """Return the least corner of the box in units of its size, and that size."""
    instance("crossing", crossing, Crossings)
    low, high = corners_of_box("bounds", bounds)
    if len(crossing.s) != 1 or not crossing.found.all():
        refuse("crossing", "be a single crossing that was found", f"holds {crossing.found.sum()}")
    if len(bounds) != 2 or any(name not in crossing.a for name in bounds):
        refuse("bounds", f"name two of {', '.join(crossing.a)}", f"names {', '.join(bounds)}")
    size = high - low
    return low / size, size


def _in_units_of_box(crossing: Crossings, plane: tuple[str, ...], size: Vector) -> Crossings:
    """Return the crossing with the coordinates of the plane first, in units of the box."""
    units = dict(zip(plane, size, strict=True))
    names = [*plane, *(name for name in crossing.a if name not in units)]

    def problem(**point: Any) -> tuple[Equation, Any]:
        return crossing.sweeps.problem(
            **{name: x * units.get(name, 1.0) for name, x in point.items()}
        )

    a = {name: crossing.a[name] / units.get(name, 1.0) for name in names}
    b = {name: crossing.b[name] / units.get(name, 1.0) for name in names}
    sweeps = PointSweeps(jax.jit(problem), crossing.sweeps.settings)
    return replace(crossing, sweeps=sweeps, a=a, b=b)


def _in_plane(point: dict[str, np.ndarray]) -> Vector:
    """Return the first two coordinates of a single point."""
    return np.concatenate(list(point.values())[:2])


def _first_point(start: Crossings, by: str | None) -> _BoundaryPoint:
    across = _in_plane(start.b) - _in_plane(start.a)
    length = np.linalg.norm(across)
    if length == 0:
        must = "name coordinates along which the segment of `crossing` lies"
        refuse("bounds", must, "it does not")
    return _boundary_point(start, by, across / length, length)


def _next_point(
    start: Crossings, last: _BoundaryPoint, step: Any, bend: Any, by: str | None
) -> _BoundaryPoint | None:
    """Return the boundary point a step further on; None if it is not between the same fates."""
    ahead = last.point + step * _quarter_turn(_rotated(last.normal, bend / 2))
    normal = _rotated(last.normal, bend)
    fixed, (first, second, *_) = start.at(start.s), start.a
    for reach in (fraction * abs(step) for fraction in REACHES):
        low, high = ahead - reach * normal, ahead + reach * normal
        a = fixed | {first: low[:1], second: low[1:]}
        b = fixed | {first: high[:1], second: high[1:]}
        segment = unsearched(start.sweeps, a, b)
        crossing = narrow(segment, PRECISION / reach)
        if crossing.found[0] and np.array_equal(crossing.fates, start.fates):
            new = _boundary_point(crossing, by, normal, 2 * reach)
            if not np.any(np.isnan(new.shift)):
                return new
            chord = new.point - last.point
            normal = -np.sign(step) * _quarter_turn(chord / np.linalg.norm(chord))
            return replace(new, normal=normal)
    return None


def _boundary_point(
    crossing: Crossings, by: str | None, across: Vector, length: Any
) -> _BoundaryPoint:
    """Return position, normal and shift at a crossing, given its segment's direction and length.

    Without a side of residual rotation there is no gradient: the normal is then the direction of
    the segment, and the shift is NaN.
    """
    names = (*list(crossing.a)[:2], *(() if by is None else (by,)))
    distance = DISTANCE * float(crossing.sweeps.rtol) / length
    gradient = residual_gradient(crossing, names, distance)[0]
    point = _in_plane(crossing.at(crossing.s))
    steepness = np.linalg.norm(gradient[:2])
    if not steepness > 0:
        return _BoundaryPoint(point, across, np.full(2, np.nan))
    normal = gradient[:2] / steepness * (-1 if residual_at_a(crossing)[0] else 1)
    speed = 0.0 if by is None else gradient[2] / steepness**2
    return _BoundaryPoint(point, normal, -speed * gradient[:2])


def _quarter_turn(v: Vector) -> Vector:
    """Rotate by π/2, to the left."""
    return np.array([-v[1], v[0]])


def _rotated(v: Vector, angle: Any) -> Vector:
    return np.cos(angle) * v + np.sin(angle) * _quarter_turn(v)


def _angle(v: Vector, w: Vector) -> Any:
    """Return the angle from v to w, in (−π, π]."""
    return np.arctan2(_quarter_turn(v) @ w, v @ w)
