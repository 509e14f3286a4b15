"""Edge tracking: the motion on the basin boundary, up to the saddle where it ends.

Two neighbours on both sides of the boundary are integrated until they separate, then the boundary
between them is bisected again. They separate along the unstable direction only; along all other
directions the motion on the boundary approaches the edge state.

Source: J. D. Skufca, J. A. Yorke and B. Eckhardt, Edge of chaos in a parallel shear flow, Phys.
Rev. Lett. 96, 174101 (2006).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._base.checks import check_single, check_verdict, finite
from .._base.refusals import refuse
from .._base.summaries import summary
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import Equation
from .._engines.interface import Limits, lifted
from .._engines.select import select_engine
from .._maps.problems import Problem
from ..equations._common import physical
from ..equations.torque_driven import DrivenEquation
from .crossings import Coordinates, Crossings, bisect, fates_at, narrow, unsearched, unsearched_rows

NAMES = ("w1", "w2", "w3")  # coordinates of a start
PARTS = 8  # times at which the distance of two neighbours is measured between bisections
NEIGHBOURS = 10.0
"""The first distance of neighbours over rtol·|ω|; at less, errors could put both on one side."""
APART = 1e-5
"""Their largest distance over |ω|; their middle leaves a curved boundary like APART²."""
WIDER = 10.0 ** np.arange(8)
"""Factors by which the segment through both is extended until it crosses the boundary."""
ENCLOSED = 1e-7
"""The width of the bracket on that segment: ENCLOSED·APART is far below NEIGHBOURS·rtol."""
SPAN = 4.0
"""The factor of τ over which a settled shape stays constant: ω decays as a power of τ, so that
progress is measured by factors of τ, not by times."""

Shape = Callable[[Float[np.ndarray, "3"]], Any]
"""A function from ω to the numbers that settle on the way to the edge state."""
Pair = Float[np.ndarray, "2 3"]
"""Two neighbours on the two sides of the boundary."""


def problem_of_starts(equation: Equation) -> Problem:
    """Return the problem whose coordinates are the components of ω₀."""
    check_verdict(equation)
    check_single(equation)
    return jax.jit(lambda w1, w2, w3: (equation, jnp.stack([w1, w2, w3])))


def to_coordinates(omegas: Float[np.ndarray, "N 3"]) -> Coordinates:
    """Return starts as the coordinates of a problem."""
    return dict(zip(NAMES, omegas.T, strict=True))


def to_array(point: dict[str, Float[np.ndarray, "*n"]]) -> Float[np.ndarray, "*n 3"]:
    """Return the starts with the given coordinates."""
    return np.stack([point[name] for name in NAMES], axis=-1)


def planar_shape(omega: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Compute (φ, z) = (atan2(ω₂, ω₁), ω₃/ω⊥²), the variables of the planar system."""
    w1, w2, w3 = omega
    return np.array([np.arctan2(w2, w1), w3 / (w1**2 + w2**2)])


class Edge(NamedTuple):
    """A motion on the basin boundary."""

    ts: Float[np.ndarray, "T"]
    """Times τ, in units of τ₀."""
    omega: Float[np.ndarray, "T 3"]
    """ω in the middle between the neighbours of different fates, in units of 1/τ₀."""
    shape: Float[np.ndarray, "T k"]
    """The shape of the motion; of a top with transverse dipole (φ, z)."""
    width: Float[np.ndarray, "T"]
    """The distance of the neighbours in units of |ω|."""
    settled: bool
    """Whether the last of `shape` is the edge state, where the motion ends."""

    def __repr__(self) -> str:
        return summary(self)


def edge_state(
    equation: Equation,
    a: Any,
    b: Any,
    *,
    shape: Shape = planar_shape,
    shape_tol: float = 1e-6,
    rounds: int = 100,
    **settings: Any,
) -> Edge:
    """Follow dω/dτ = equation(ω) along the basin boundary between a and b to its saddle.

    Neighbours on both sides of the boundary are integrated until they separate, then the boundary
    is found again between them, and so on. They separate along the unstable direction only; along
    all other directions the motion approaches the edge state.

    Args:
        equation: an equation of motion with a `verdict`.
        a: a start, shape (3,), dimensionless, body axes.
        b: a start with another fate.
        shape: a function of ω whose value settles, since ω itself decays; the default is (φ, z) of
            the transverse top, which `planar.saddle` gives for small amplitudes.
        shape_tol: the largest change of a settled `shape` while τ becomes four times larger.
        rounds: how often the boundary is found again, at most.
        settings: the settings of the sweeps, as in `bisect`.

    Returns:
        An `Edge`.

    Raises:
        ValueError: bad arguments, or starts of the same fate.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import edge_state
        >>> a, b = dt.cylindrical(0.1, 0.0, 0.0), dt.cylindrical(0.1, 0.1, 0.0)
        >>> edge = edge_state(dt.TransverseReduced(-0.2), a, b, shape_tol=1e-4)
        >>> edge.settled, edge.shape[-1].round(3).tolist()
        (True, [0.615, 2.357])
    """
    if isinstance(equation, DrivenEquation):  # its time and attitude would start anew
        must = "have no torque from outside, since motions are begun again from late states"
        refuse("equation", must, f"is {type(equation).__name__}")
    problem, tol = problem_of_starts(equation), float(tolerance("shape_tol", shape_tol))
    start_a = to_coordinates(np.asarray(finite("a", a, (3,), batch=False))[None])
    start_b = to_coordinates(np.asarray(finite("b", b, (3,), batch=False))[None])
    crossing = bisect(problem, start_a, start_b, **settings)
    times, pairs, settled = _follow(equation, crossing, shape, tol, budget("rounds", rounds))
    omega = pairs.mean(axis=1)
    width = np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1) / np.linalg.norm(omega, axis=1)
    shapes = np.stack([np.asarray(shape(w)) for w in omega])
    return Edge(times, omega, shapes, width, settled)


def _follow(
    equation: Equation, crossing: Crossings, shape: Shape, tol: float, rounds: int
) -> tuple[Float[np.ndarray, "T"], Float[np.ndarray, "T 2 3"], bool]:
    """Return the times at which the boundary was found again, the neighbours, and `settled`."""
    now, pair = 0.0, _neighbours(crossing)
    times, pairs = [now], [pair]
    interval = 2 / np.sum(pair[0] ** 2)  # twice the time of braking, 1/ω²
    landmark, shape_then = interval, _shape_of(shape, pair)
    settled = False
    for _ in range(rounds):
        ts = interval * np.arange(1, PARTS + 1) / PARTS
        later = _states_at(equation, pair, ts, crossing.sweeps.settings)
        distance = np.linalg.norm(later[:, 1] - later[:, 0], axis=1)
        near = distance <= APART * np.linalg.norm(later[:, 0], axis=1)
        together = int(np.cumprod(near).sum())  # times up to which the two are still neighbours
        if not together:
            interval /= PARTS
            continue
        new = _between(crossing, later[together - 1])
        if new is None:
            break
        now, pair = now + ts[together - 1], _neighbours(new)
        times.append(now)
        pairs.append(pair)
        interval *= 2.0 if together == PARTS else 1.0
        if now >= SPAN * landmark:
            shape_now = _shape_of(shape, pair)
            settled = bool(np.all(np.abs(shape_now - shape_then) <= tol))
            if settled:
                break
            landmark, shape_then = now, shape_now
    return np.array(times), np.stack(pairs), settled


def _shape_of(shape: Shape, pair: Pair) -> np.ndarray:
    """Return the shape in the middle between two neighbours."""
    return np.asarray(shape(pair.mean(axis=0)))


def _neighbours(crossing: Crossings) -> Pair:
    """Return two states on both sides of a single crossing, as near as errors allow."""
    a, b = to_array(crossing.a)[0], to_array(crossing.b)[0]
    gap = NEIGHBOURS * crossing.sweeps.rtol * np.linalg.norm(a) / np.linalg.norm(b - a)
    fractions = crossing.s[:, None] + gap * np.array([[-0.5, 0.5]])
    return to_array(crossing.at(fractions))[0]


def _between(crossing: Crossings, pair: Pair) -> Crossings | None:
    """Find the boundary between the same two fates, near two states that errors may have moved.

    Return None if no segment through both, up to 10⁷ times longer, has ends of these fates.
    """
    half = (pair[1] - pair[0]) / 2 * WIDER[:, None]
    middle = pair.mean(axis=0)
    a, b = to_coordinates(middle - half), to_coordinates(middle + half)
    segments = unsearched(crossing.sweeps, a, b)
    same = np.all(fates_at(segments, segments.bracket) == crossing.fates, axis=1)
    first = unsearched_rows(segments, np.flatnonzero(same)[:1])
    return narrow(first, ENCLOSED) if same.any() else None


def _states_at(
    equation: Equation, pair: Pair, ts: Float[np.ndarray, "T"], settings: dict[str, Any]
) -> Float[np.ndarray, "T 2 3"]:
    """Return ω of two starts at several times; each start and time is a lane of its own."""
    omegas = jnp.asarray(np.tile(pair, (len(ts), 1)).T)
    in_lanes = eqx.filter_vmap(lambda _: physical(equation), out_axes=eqx.if_array(-1))
    block = in_lanes(omegas[0])
    y0 = lifted(block, omegas)
    rtol = tolerance("rtol", settings["rtol"])
    steps = jnp.asarray(budget("max_steps", settings.get("max_steps", MAX_STEPS)))
    atol = absolute(settings.get("atol"), rtol, omegas)
    limits = Limits(rtol, atol, jnp.asarray(np.repeat(ts, 2)), steps)
    device = next(iter(y0.devices()))
    engine = select_engine(settings.get("engine", "auto"), block, device, "time")
    ends = engine.end_states(block, y0, limits, until="time")
    return np.asarray(block.omega(jnp.asarray(ends.y))).T.reshape(len(ts), 2, 3)
