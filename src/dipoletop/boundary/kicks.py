"""The smallest kick that changes how a start ends: its distance to the basin boundary.

Rays in many directions are searched in one sweep. From the nearest crossings the distance r along
a direction v is minimised by Newton's method. With n the normal of the boundary, E a basis of the
plane across the unit vector d, and directions v = d + qE of that plane, log r has the gradient

    ∂ log r/∂q = −(n·E)/(n·v) + q/(1 + q²),

the second term because |v| > 1; its differences give the matrix of second derivatives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._base.checks import finite
from .._base.refusals import refuse
from .._base.summaries import summary
from .._base.tolerances import budget
from .._base.types import Equation, Fate
from .._maps.sweep import PointSweeps
from .crossings import (
    Crossings,
    fates_at,
    first_change,
    narrow,
    normal,
    sweeps_of,
    unsearched,
)
from .edge_states import NAMES, problem_of_starts, to_array, to_coordinates

SHORTLIST, COARSE = 64, 1e-4  # nearest rays that are bisected, and the width of their brackets
BEST, ALIKE = 6, np.cos(0.3)  # starts of Newton's method, and the cosine of their least distance
REACH = 1.5  # rays are then searched up to this multiple of the known distance
FINE = 1e-12  # width of the brackets of these rays
NEWTON = 12  # largest number of steps of Newton's method
PROBE = 1e-4  # radians of a difference for second derivatives
FLATTEST = 1e-3  # least curvature of log r in a step, which would be too long otherwise
LONGEST = 0.5  # radians of the longest step
FRACTIONS = np.array([1.0, 0.5, 0.125, 1 / 64])  # fractions of a step that are tried
SETTLED = 1e-8  # radians: a shorter step ends the search

Directions = Float[np.ndarray, "n m"]
"""Unit vectors in the m components of ω₀ that may be changed."""
Lengths = Float[np.ndarray, "n"]
Chosen = tuple[Float[np.ndarray, "chosen m"], Float[np.ndarray, "chosen"]]
"""Some of the directions, and the distances of the boundary along them."""


class Kick(NamedTuple):
    """The smallest change of a start that changes its fate."""

    kick: Float[np.ndarray, "3"]
    """The change of ω₀, to just beyond the boundary; NaN if no other fate was met."""
    size: float
    """|kick|: the distance of ω₀ from the boundary; inf if no other fate was met."""
    fates: Int[np.ndarray, "2"]
    """The fates of ω₀ and of ω₀ + kick, members of `Fate`; UNDECIDED if no other fate was met."""
    defect: float
    """The sine of the angle between the kick and the normal of the boundary, 0 at a minimum; NaN
    if neither side is of residual rotation."""

    def __repr__(self) -> str:
        return summary(self)


def minimal_kick(
    equation: Equation,
    omega0: Any,
    *,
    largest: Any = None,
    directions: int = 512,
    radii: int = 32,
    components: Sequence[int] = (1, 2, 3),
    **settings: Any,
) -> Kick:
    """Compute the smallest |κ| such that ω₀ + κ has another fate than ω₀.

    This is the distance of ω₀ to the boundary. Rays in many directions are searched, all in one
    sweep, for the first change of fate. From the nearest of them the distance r(direction) is
    minimised by Newton's method with the gradient −r n_⊥/(n·direction), n being the normal of the
    boundary. So it is the global minimum, unless a tongue is thinner than the spacing of the rays.

    Args:
        equation: an equation of motion with a `verdict`.
        omega0: the start ω₀, shape (3,), dimensionless, body axes.
        largest: the largest kick that is tried; None means |ω₀|, which can stop any top if all
            components may be changed.
        directions: the number of rays.
        radii: the number of points on each ray.
        components: the components of ω₀ that may be changed, among 1, 2 and 3.
        settings: the settings of the sweeps, as in `bisect`.

    Returns:
        A `Kick`.

    Raises:
        ValueError: bad arguments, or a start without a fate.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import minimal_kick
        >>> omega0 = dt.cylindrical(0.2, 0.1, 0.0)
        >>> kick = minimal_kick(dt.TransverseReduced(-0.2), omega0, directions=100, radii=9)
        >>> bool(kick.size < 0.2), [dt.Fate(number).name for number in kick.fates]
        (True, ['POSITIVE', 'ROTATING'])
    """
    sweeps = sweeps_of(problem_of_starts(equation), settings)
    rays = _Rays(sweeps, *_checked(omega0, largest, components))
    spread = _directions(len(rays.basis), budget("directions", directions))
    d, r = rays.nearest(spread, budget("radii", radii))
    if not len(r):
        return Kick(np.full(3, np.nan), np.inf, np.full(2, Fate.UNDECIDED), np.nan)
    for _ in range(NEWTON):
        d, r, angles = _newton_step(rays, d, r)
        distinct = _distinct(d, r)
        d, r, angles = d[distinct], r[distinct], angles[distinct]
        if not np.any(angles > SETTLED):
            break
    direction, r = d[np.argmin(r)], np.min(r, keepdims=True)
    crossing, normals = rays.crossings_and_normals(direction[None], r)
    kick = to_array(crossing.after)[0] - rays.omega0
    tangential = normals[0] - (normals[0] @ direction) * direction
    defect = float(np.linalg.norm(tangential))
    return Kick(kick, float(np.linalg.norm(kick)), crossing.fates[0], defect)


def _checked(
    omega0: Any, largest: Any, components: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Check and return the start, the unit vectors of the components, and the largest kick."""
    start = np.asarray(finite("omega0", omega0, (3,), batch=False))
    filled = isinstance(components, Sequence) and len(components) > 0
    if not (filled and len(set(components)) == len(components) and set(components) <= {1, 2, 3}):
        refuse("components", "hold different numbers among 1, 2 and 3", f"is {components!r}")
    size = np.linalg.norm(start) if largest is None else finite("largest", largest, batch=False)
    if not size > 0:
        refuse("largest", "be positive", f"is {float(size):g}")
    return start, np.eye(3)[np.array(components) - 1], np.asarray(size)


def _directions(m: int, count: int) -> Directions:
    """Return unit vectors spread evenly: on a line, a circle or a sphere (a Fibonacci spiral)."""
    if m == 1:
        return np.array([[1.0], [-1.0]])
    k = np.arange(count) + 0.5
    angle = 2 * np.pi * (k / count if m == 2 else k * (np.sqrt(5.0) - 1) / 2)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if m == 2:
        return circle
    height = 1 - 2 * k[:, None] / count
    return np.concatenate([np.sqrt(1 - height**2) * circle, height], axis=1)


@dataclass(frozen=True)
class _Rays:
    """Rays from a start; their directions are in the components that may change."""

    sweeps: PointSweeps
    omega0: Float[np.ndarray, "3"]
    basis: Float[np.ndarray, "m 3"]
    largest: Float[np.ndarray, ""]

    def segments(self, kicks: Directions) -> Crossings:
        """Return segments from ω₀ to ω₀ + kick."""
        ends = self.omega0 + kicks @ self.basis
        starts = np.broadcast_to(self.omega0, ends.shape)
        return unsearched(self.sweeps, to_coordinates(starts), to_coordinates(ends))

    def nearest(self, d: Directions, radii: int) -> Chosen:
        """Return well-separated directions in which the boundary is near, and its distances."""
        s = np.tile(np.linspace(0, 1, radii + 1), (len(d), 1))
        fates = fates_at(self.segments(self.largest * d), s)
        if fates[0, 0] <= Fate.UNDECIDED:
            refuse("omega0", "be a start whose fate is decided", "its fate is not")
        change, crossed = first_change(fates)
        order = np.argsort(np.where(crossed, change[:, 1], radii + 1), kind="stable")
        chosen = order[: min(SHORTLIST, crossed.sum())]
        if not len(chosen):
            return d[chosen], np.zeros(0)
        d = d[chosen]
        bracket = np.take_along_axis(s, change, axis=1)[chosen]
        crossings = narrow(replace(self.segments(self.largest * d), bracket=bracket), COARSE)
        r = crossings.s * self.largest
        distinct = _distinct(d, r)[:BEST]
        return d[distinct], r[distinct]

    def crossings(self, v: Directions, r: Lengths) -> Crossings:
        """Return the first crossings in the directions v, near the distances r."""
        return narrow(self.segments(REACH * r[:, None] * v), FINE, ends_may_agree=True)

    def crossings_and_normals(self, v: Directions, r: Lengths) -> tuple[Crossings, Directions]:
        """Return the first crossings, and the unit normals in the components that may change."""
        crossings = self.crossings(v, r)
        normals = normal(crossings, NAMES) @ self.basis.T
        return crossings, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def distances(self, v: Directions, r: Lengths) -> Lengths:
        """Return the distances of the boundary along v, near r; inf where it is not met."""
        crossings = self.crossings(v, r)
        return np.where(crossings.found, crossings.s * REACH * r, np.inf)


def _distinct(d: Directions, r: Lengths) -> list[int]:
    """Return indices by distance, without directions that are close to a nearer one."""
    chosen: list[int] = []
    for i in np.argsort(r).tolist():
        if np.all(d[chosen] @ d[i] < ALIKE):
            chosen.append(i)
    return chosen


def _newton_step(rays: _Rays, d: Directions, r: Lengths) -> tuple[Directions, Lengths, Lengths]:
    """Make one step of Newton's method; return new directions, distances and angles.

    Line search: take the fraction of the step with the smallest r; stay if none decreases r.
    """
    if d.shape[1] == 1:
        return d, r, np.zeros(len(d))
    plane = np.linalg.svd(d[:, None, :])[2][:, 1:]  # basis across d, shape (n, m − 1, m)
    step = _step_in_plane(*_derivatives(rays, d, r, plane))
    trials = d[:, None] + FRACTIONS[:, None] * np.einsum("kf,kfm->km", step, plane)[:, None]
    trials /= np.linalg.norm(trials, axis=2, keepdims=True)
    distances = rays.distances(trials.reshape(-1, d.shape[1]), np.repeat(r, len(FRACTIONS)))
    distances = distances.reshape(trials.shape[:2])
    best, rows = np.argmin(distances, axis=1), np.arange(len(d))
    nearer = distances[rows, best] < r
    angles = np.where(nearer, FRACTIONS[best] * np.linalg.norm(step, axis=1), 0.0)
    d = np.where(nearer[:, None], trials[rows, best], d)
    return d, np.where(nearer, distances[rows, best], r), angles


def _derivatives(
    rays: _Rays, d: Directions, r: Lengths, plane: Float[np.ndarray, "n f m"]
) -> tuple[Float[np.ndarray, "n f"], Float[np.ndarray, "n f f"]]:
    """Compute gradient and Hessian of log r at q = 0, for directions v = d + q·plane."""
    free, m = plane.shape[1:]
    q = np.concatenate([np.zeros((1, free)), PROBE * np.eye(free)])
    v = d[:, None] + q @ plane
    _, normals = rays.crossings_and_normals(v.reshape(-1, m), np.repeat(r, m))
    n = normals.reshape(v.shape)
    across = np.einsum("kpm,kfm->kpf", n, plane) / np.sum(n * v, axis=2, keepdims=True)
    gradient = np.nan_to_num(q / (1 + np.sum(q**2, axis=1, keepdims=True)) - across)
    return gradient[:, 0], (gradient[:, 1:] - gradient[:, :1]) / PROBE


def _step_in_plane(
    gradient: Float[np.ndarray, "n f"], second: Float[np.ndarray, "n f f"]
) -> Float[np.ndarray, "n f"]:
    """Return Newton's step downhill, at most `LONGEST`, with curvatures made positive."""
    curvatures, axes = np.linalg.eigh((second + np.swapaxes(second, 1, 2)) / 2)
    parts = np.einsum("kfi,kf->ki", axes, gradient) / np.maximum(np.abs(curvatures), FLATTEST)
    step = -np.einsum("kfi,ki->kf", axes, parts)
    return step / np.maximum(1, np.linalg.norm(step, axis=1, keepdims=True) / LONGEST)
