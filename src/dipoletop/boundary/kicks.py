"""The smallest kick that changes how a start ends: its distance to the basin boundary."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._base.checks import finite, refuse
from .._base.tolerances import budget
from .._base.types import Equation
from .crossings import UNDECIDED, Crossings, cut, fates_at, first_change, normal, segments
from .edge_states import NAMES, starts_of, to_array, to_coordinates

SHORTLIST, COARSE = 64, 1e-4  # rays whose distances are compared, and their precision
BEST, ALIKE = 6, np.cos(0.3)  # of these the best go on, so far apart
REACH = 1.5  # rays are looked along up to this multiple of the distance known
FINE = 1e-12  # of the distances, in units of that
NEWTON = 12  # steps of Newton's method at most
PROBE = 1e-4  # radians, for second derivatives
FLATTEST = 1e-3  # least curvature of log r that is believed
LONGEST = 0.5  # radians in a step
FRACTIONS = np.array([1.0, 0.5, 0.125, 1 / 64])  # of a step that are tried
SETTLED = 1e-8  # radians


class Kick(NamedTuple):
    """The smallest change of a start that changes its fate."""

    kick: Float[np.ndarray, "3"]
    """The change of ω₀, to just beyond the boundary; NaN if no other fate was met."""
    size: float
    """|kick|: the distance of ω₀ from the boundary; inf if no other fate was met."""
    fates: Int[np.ndarray, "2"]
    """Those of ω₀ and of ω₀ + kick, as `fate` numbers them; 0 if no other fate was met."""
    defect: float
    """The sine of the angle between the kick and the normal of the boundary, 0 at a minimum; NaN
    if neither side is of residual rotation."""


def minimal_kick(
    equation: Equation,
    omega0: Any,
    *,
    largest: Any = None,
    directions: int = 512,
    radii: int = 32,
    along: Sequence[int] = (1, 2, 3),
    **settings: Any,
) -> Kick:
    """The smallest |κ| such that ω₀ + κ has another fate than ω₀: its distance to the boundary.

    Rays in many directions are looked along, all in one sweep, for the first change of fate. From
    the nearest of them the distance r(direction) is minimised by Newton's method with the
    gradient −r n_⊥/(n·direction), n being the normal of the boundary. So it is the global minimum
    but for what lies between the rays, such as a tongue that is thinner than their spacing.

    Args:
        equation: an equation of motion with a `verdict`.
        omega0: the start ω₀, shape (3,), dimensionless, body axes.
        largest: the largest kick that is looked at; None means |ω₀|, which can stop any top if
            all components may be changed.
        directions: how many rays.
        radii: how many points on each.
        along: numbers of the components of ω₀ that may be changed.
        settings: of the sweeps, as in `bisect`.

    Returns:
        A `Kick`.

    Raises:
        ValueError: bad arguments, or a start without a fate.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import minimal_kick
        >>> start = dt.cylindrical(0.2, 0.1, 0.0)
        >>> found = minimal_kick(dt.TransverseReduced(-0.2), start, directions=100, radii=9)
        >>> bool(found.size < 0.2), found.fates.tolist()
        (True, [1, 5])
    """
    rays = _Rays(starts_of(equation), *_checked(omega0, largest, along), settings)
    spread = _directions(len(rays.basis), budget("directions", directions))
    d, r = rays.nearest(spread, budget("radii", radii))
    if not len(r):
        return Kick(np.full(3, np.nan), np.inf, np.full(2, UNDECIDED), np.nan)
    for _ in range(NEWTON):
        d, r, moved = _distinct(*_improved(rays, d, r))
        if not np.any(moved > SETTLED):
            break
    best = np.argmin(r)
    found, across = rays.look(d[best][None], r[best : best + 1])
    kick = to_array(found.after)[0] - rays.omega0
    tangential = across[0] - (across[0] @ d[best]) * d[best]
    return Kick(
        kick, float(np.linalg.norm(kick)), found.fates[0], float(np.linalg.norm(tangential))
    )


def _checked(
    omega0: Any, largest: Any, along: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The start, the unit vectors of the components that may change, and the largest kick."""
    start = np.asarray(finite("omega0", omega0, (3,), batch=False))
    some = isinstance(along, Sequence) and len(along) > 0
    if not (some and len(set(along)) == len(along) and set(along) <= {1, 2, 3}):
        refuse("along", "hold different numbers among 1, 2 and 3", f"is {along!r}")
    size = np.linalg.norm(start) if largest is None else finite("largest", largest, batch=False)
    if not size > 0:
        refuse("largest", "be positive", f"is {float(size):g}")
    return start, np.eye(3)[np.array(along) - 1], np.asarray(size)


def _directions(m: int, count: int) -> Float[np.ndarray, "n m"]:
    """Unit vectors spread evenly: on a line, a circle or a sphere (a Fibonacci spiral)."""
    if m == 1:
        return np.array([[1.0], [-1.0]])
    k = np.arange(count) + 0.5
    turn = 2 * np.pi * (k / count if m == 2 else k * (np.sqrt(5.0) - 1) / 2)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if m == 2:
        return circle
    height = 1 - 2 * k[:, None] / count
    return np.concatenate([np.sqrt(1 - height**2) * circle, height], axis=1)


@dataclass(frozen=True)
class _Rays:
    """Rays from a start; their directions v are in the components that may change."""

    problem: Any
    omega0: Float[np.ndarray, "3"]
    basis: Float[np.ndarray, "m 3"]
    largest: Float[np.ndarray, ""]
    settings: dict[str, Any]

    def to(self, kicks: Float[np.ndarray, "n m"]) -> Crossings:
        """Segments from ω₀ to ω₀ + kick."""
        ends = self.omega0 + kicks @ self.basis
        starts = np.broadcast_to(self.omega0, ends.shape)
        return segments(self.problem, to_coordinates(starts), to_coordinates(ends), self.settings)

    def nearest(self, d: Float[np.ndarray, "n m"], radii: int) -> tuple[np.ndarray, np.ndarray]:
        """Directions, well apart, in which the boundary is near, and its distances there."""
        rays = self.to(self.largest * d)
        s = np.tile(np.linspace(0, 1, radii + 1), (len(d), 1))
        fates = fates_at(rays, s)
        if fates[0, 0] <= UNDECIDED:
            refuse("omega0", "be a start whose fate is decided", "its fate is not")
        first, there = first_change(fates)
        order = np.argsort(np.where(there, first[:, 1], radii + 1), kind="stable")
        some = order[: min(SHORTLIST, there.sum())]
        if not len(some):
            return d[some], np.zeros(0)
        bracket = np.take_along_axis(s, first, axis=1)[some]
        found = cut(replace(self.to(self.largest * d[some]), bracket=bracket), COARSE)
        d, r = d[some], found.s * self.largest
        d, r, _ = _distinct(d, r, r)
        return d[:BEST], r[:BEST]

    def look(self, v: Any, r: Any) -> tuple[Crossings, Any]:
        """The first crossing in the directions v near the distances r, and its unit normals."""
        found = cut(self.to(REACH * r[:, None] * v), FINE, scan=True)
        across = normal(found, NAMES) @ self.basis.T
        return found, across / np.linalg.norm(across, axis=1, keepdims=True)

    def distance(self, v: Float[np.ndarray, "n m"], r: Float[np.ndarray, "n"]) -> np.ndarray:
        """Distances of the boundary in the directions v, near r; inf where it is not met."""
        found = cut(self.to(REACH * r[:, None] * v), FINE, scan=True)
        return np.where(found.found, found.s * REACH * r, np.inf)


def _distinct(d: Any, r: Any, moved: Any) -> tuple[Any, Any, Any]:
    """The nearest first, without those beside a nearer one."""
    chosen: list[int] = []
    for i in np.argsort(r):
        if np.all(d[chosen] @ d[i] < ALIKE):
            chosen.append(int(i))
    return d[chosen], r[chosen], moved[chosen]


def _improved(rays: _Rays, d: Any, r: Any) -> tuple[Any, Any, Any]:
    """One step of Newton's method for every direction, not longer than it makes r smaller.

    In the plane v = d + qE that touches the sphere, log r has the gradient
    −(n·E)/(n·v) + q/(1 + q²); its differences give the second derivatives.
    """
    (count, m), free = d.shape, d.shape[1] - 1
    if free == 0:
        return d, r, np.zeros(count)
    plane = np.linalg.svd(d[:, None, :])[2][:, 1:]  # (K, free, m), across d
    q = np.concatenate([np.zeros((1, free)), PROBE * np.eye(free)])
    v = d[:, None] + q @ plane
    _, n = rays.look(v.reshape(-1, m), np.repeat(r, m))
    n = n.reshape(v.shape)
    across = np.einsum("kpm,kfm->kpf", n, plane) / np.sum(n * v, axis=2, keepdims=True)
    slope = np.nan_to_num(q / (1 + np.sum(q**2, axis=1, keepdims=True)) - across)
    curvature = (slope[:, 1:] - slope[:, :1]) / PROBE
    size, axes = np.linalg.eigh((curvature + np.swapaxes(curvature, 1, 2)) / 2)
    part = np.einsum("kfi,kf->ki", axes, slope[:, 0]) / np.maximum(np.abs(size), FLATTEST)
    step = -np.einsum("kfi,ki->kf", axes, part)
    step /= np.maximum(1, np.linalg.norm(step, axis=1, keepdims=True) / LONGEST)
    trial = d[:, None] + FRACTIONS[:, None] * np.einsum("kf,kfm->km", step, plane)[:, None]
    trial /= np.linalg.norm(trial, axis=2, keepdims=True)
    size = len(FRACTIONS)
    found = rays.distance(trial.reshape(-1, m), np.repeat(r, size)).reshape(count, size)
    best = np.argmin(found, axis=1)
    rows = np.arange(count)
    nearer = found[rows, best] < r
    moved = np.where(nearer, FRACTIONS[best] * np.linalg.norm(step, axis=1), 0.0)
    d = np.where(nearer[:, None], trial[rows, best], d)
    return d, np.where(nearer, found[rows, best], r), moved
