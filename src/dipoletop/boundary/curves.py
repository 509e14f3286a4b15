"""The boundary curve in a plane of two coordinates, by pseudo-arclength continuation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .._base.checks import finite, instance, refuse
from .._base.tolerances import budget
from .crossings import DISTANCE, Crossings, backed, columns_of_ends, cut, gradient_inwards, segments

FINE = 1e-10  # of the points of a curve, in units of the box
GOOD_TURN, MOST_TURN = 0.35, 0.5  # radians from one point of a curve to the next
TINY = 1e-9  # radians: as good as straight
LEAST_STEP = 2.0**-16  # in units of the longest: else the curve is lost


class Curve(NamedTuple):
    """A piece of the boundary in a plane of two coordinates."""

    points: Float[np.ndarray, "n 2"]
    """Boundary points in order; a closed curve ends where it began."""
    normals: Float[np.ndarray, "n 2"]
    """Unit normals, from the fate of a to that of b of the start."""
    shift: Float[np.ndarray, "n 2"] | None
    """How the boundary moves along its normal (in the plane scaled by `bounds`) with `by`."""
    end: str
    """Why it ends: "closed", "bounds", "points" (as many as asked for) or "lost"."""


@dataclass(frozen=True)
class _Foot:
    """A boundary point, in coordinates of the plane that are scaled by the box."""

    point: Float[np.ndarray, "2"]
    normal: Float[np.ndarray, "2"]
    shift: Float[np.ndarray, "2"]


def trace(
    start: Crossings,
    bounds: Mapping[str, Any],
    *,
    step: float = 0.02,
    n: int = 200,
    by: str | None = None,
) -> Curve:
    """The boundary curve through a crossing, in the plane of two coordinates, by pseudo-arclength.

    From point to point: a step along the tangent, then the boundary is sought across it, between
    the same two fates, to 1e-10 of the box. A step is halved if that fails or if the curve turns
    by more than half a radian; so folds are passed, and tongues followed until they are too thin.
    Where neither side is of residual rotation, the tangent is that of the last two points.

    Args:
        start: one crossing, as `bisect` finds it. All other coordinates are held.
        bounds: the plane and its box: two coordinates, name = (least, largest).
        step: the longest step, in units of the box. For positive steps the fate of b is on the
            right (the first coordinate to the right, the second upwards); for negative, left.
        n: how many points at most.
        by: a coordinate of the problem, such as "delta", with which the shift of the boundary is
            asked for.

    Returns:
        A `Curve`.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import bisect, trace
        >>> def problem(phi, z):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(1e-3, z * 1e-6, phi)
        >>> start = bisect(problem, {"phi": 0.0, "z": 4.0}, {"phi": 0.0, "z": 4.5})
        >>> curve = trace(start, {"phi": (-1.0, 1.0), "z": (0.0, 8.0)}, n=3)
        >>> curve.points.shape, curve.end
        ((3, 2), 'points')
    """
    low, size = _box(start, bounds)
    step = float(finite("step", step, batch=False))
    if step == 0:
        refuse("step", "not be 0", "is 0")
    if by is not None and (by not in start.a or by in bounds):
        refuse("by", "name another coordinate of the crossing", f"is {by!r}")
    scaled = _scaled(start, tuple(bounds), size)
    feet, end = _walk(scaled, (low, low + 1), step, budget("n", n), by)
    points, normals, shift = (
        np.stack([getattr(f, k) for f in feet]) for k in ("point", "normal", "shift")
    )
    normals = normals / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Curve(points * size, normals, None if by is None else shift * size, end)


def _walk(
    start: Crossings, box: tuple, step: float, n: int, by: str | None
) -> tuple[list[_Foot], str]:
    """From foot to foot, until the curve closes, leaves the box, is lost, or has n of them."""
    feet = [_first_foot(start, by)]
    turn, h, bend = np.sign(step), abs(step), 0.0
    while len(feet) < n:
        foot = feet[-1]
        if len(feet) > 3 and _reaches(foot, feet[0], turn, h):
            return [*feet, feet[0]], "closed"
        new = _next_foot(start, foot, turn * h, bend * h, by)
        angle = np.pi if new is None else _angle(foot.normal, new.normal)
        if new is None or abs(angle) > MOST_TURN:
            h /= 2
            if h > LEAST_STEP * abs(step):
                continue
            return feet, "lost"
        if np.any((new.point < box[0]) | (new.point > box[1])):
            return feet, "bounds"
        feet.append(new)
        bend = angle / h
        h = min(abs(step), h * min(1.5, GOOD_TURN / max(abs(angle), TINY)))
    return feet, "points"


def _reaches(foot: _Foot, goal: _Foot, turn: float, h: float) -> bool:
    """Whether the next step would come to the goal, along the same piece of the curve."""
    ahead = goal.point - foot.point
    along, across = turn * _left(foot.normal) @ ahead, foot.normal @ ahead
    return bool(0 < along <= h and abs(across) < h * MOST_TURN and foot.normal @ goal.normal > 0)


def _box(start: Crossings, bounds: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The least corner of the box in units of its size, and that size."""
    instance("start", start, Crossings)
    instance("bounds", bounds, Mapping, "be a dict of pairs (least, largest)")
    if len(start.s) != 1 or not start.found.all():
        refuse("start", "be a single crossing that was found", f"holds {start.found.sum()}")
    if len(bounds) != 2 or any(name not in start.a for name in bounds):
        refuse("bounds", f"name two of {', '.join(start.a)}", f"names {', '.join(bounds)}")
    corners = np.stack([np.asarray(finite(k, x, (2,), batch=False)) for k, x in bounds.items()])
    size = corners[:, 1] - corners[:, 0]
    if np.any(size <= 0):
        refuse("bounds", "be pairs (least, largest)", f"are {dict(bounds)}")
    return corners[:, 0] / size, size


def _scaled(start: Crossings, plane: tuple[str, ...], size: np.ndarray) -> Crossings:
    """The same crossing with the coordinates of the plane in front and in units of the box."""
    scale = dict(zip(plane, size, strict=True))
    names = [*plane, *(name for name in start.a if name not in scale)]

    def problem(**point: Any) -> Any:
        return start.problem(**{name: x * scale.get(name, 1.0) for name, x in point.items()})

    a, b = ({k: end[k] / scale.get(k, 1.0) for k in names} for end in (start.a, start.b))
    return replace(start, problem=jax.jit(problem), a=a, b=b)


def _first_foot(start: Crossings, by: str | None) -> _Foot:
    across = np.concatenate(list(start.b.values())[:2]) - np.concatenate(list(start.a.values())[:2])
    length = np.linalg.norm(across)
    if length == 0:
        refuse("bounds", "name coordinates along which the segment of `start` lies", "it does not")
    return _foot(start, by, across / length, length)


def _next_foot(start: Crossings, foot: _Foot, step: Any, bend: Any, by: str | None) -> _Foot | None:
    """The boundary point a step further on; None if it is not between the same fates."""
    way = step * _left(_turned(foot.normal, bend / 2))  # an arc as curved as the last
    normal = _turned(foot.normal, bend)
    plane, held = list(start.a)[:2], {name: x[0] for name, x in start.at(start.s).items()}
    for reach in (abs(step) / 8, abs(step) / 2):
        ends = (foot.point + way - reach * normal, foot.point + way + reach * normal)
        a, b = (held | dict(zip(plane, end, strict=True)) for end in ends)
        found = cut(segments(start.problem, *columns_of_ends(a, b), start.settings), FINE / reach)
        if found.found[0] and np.array_equal(found.fates, start.fates):
            new = _foot(found, by, normal, 2 * reach)
            if not np.any(np.isnan(new.shift)):
                return new
            chord = new.point - foot.point
            return replace(new, normal=-np.sign(step) * _left(chord / np.linalg.norm(chord)))
    return None


def _foot(found: Crossings, by: str | None, across: np.ndarray, length: Any) -> _Foot:
    """Position, normal and shift at a crossing whose segment has this direction and length."""
    names = (*list(found.a)[:2], *(() if by is None else (by,)))
    distance = DISTANCE * float(found.settings["rtol"]) / length
    gradient = gradient_inwards(found, names, distance)[0]
    point = np.concatenate(list(found.at(found.s).values())[:2])
    steep = np.linalg.norm(gradient[:2])
    if not steep > 0:
        return _Foot(point, across, np.full(2, np.nan))
    normal = gradient[:2] / steep * (-1 if backed(found)[0] else 1)
    speed = 0.0 if by is None else gradient[2] / steep**2
    return _Foot(point, normal, -speed * gradient[:2])


def _left(v: np.ndarray) -> np.ndarray:
    """A quarter turn."""
    return np.array([-v[1], v[0]])


def _turned(v: np.ndarray, angle: Any) -> np.ndarray:
    return np.cos(angle) * v + np.sin(angle) * _left(v)


def _angle(v: np.ndarray, w: np.ndarray) -> Any:
    """From v to w, in (−π, π]."""
    return np.arctan2(_left(v) @ w, v @ w)
