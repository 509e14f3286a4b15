"""Edge tracking: the motion on the basin boundary, to the saddle where it ends."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._base.checks import check_single, check_verdict, finite
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import Equation
from .._branch import march as manifold
from .._engines.interface import Limits
from .._engines.on_device import lifted
from .._engines.select import select_engine
from .crossings import Crossings, bisect, cut, fates_at, segments

NAMES = ("w1", "w2", "w3")  # coordinates of a start
PARTS = 8  # times at which two neighbours are looked at before they are brought together again
NEIGHBOURS = 10.0  # their distance to begin with, in units of rtol·|ω|
APART = 1e-5  # their largest distance, in units of |ω|
WIDER = 10.0 ** np.arange(8)  # factors by which a segment is made longer until it is crossed
ENCLOSED = 1e-7  # of the segment between them: how closely the boundary is then enclosed
SPAN = 4.0  # a motion is settled if its shape is the same after so many times the time


def starts_of(equation: Equation) -> Callable[..., Any]:
    """The problem whose coordinates are the components of ω₀."""
    check_verdict(equation)
    check_single(equation)
    return jax.jit(lambda w1, w2, w3: (equation, jnp.stack([w1, w2, w3])))


def to_coordinates(omegas: Float[np.ndarray, "N 3"]) -> dict[str, Float[np.ndarray, "N"]]:
    """Starts as the coordinates of a problem."""
    return dict(zip(NAMES, omegas.T, strict=True))


def to_array(point: dict[str, Float[np.ndarray, "*n"]]) -> Float[np.ndarray, "*n 3"]:
    """The starts at such coordinates."""
    return np.stack([point[name] for name in NAMES], axis=-1)


def planar_shape(omega: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """(φ, z) = (atan2(ω₂, ω₁), ω₃/ω⊥²): what the planar system moves, free of the amplitude."""
    w1, w2, w3 = omega
    return np.array([np.arctan2(w2, w1), w3 / (w1**2 + w2**2)])


class Edge(NamedTuple):
    """A motion on the basin boundary."""

    ts: Float[np.ndarray, "T"]
    """Times τ, in units of τ₀."""
    omega: Float[np.ndarray, "T 3"]
    """ω in the middle between the neighbours of different fates."""
    shape: Float[np.ndarray, "T k"]
    """The shape of the motion; of a top with transverse dipole (φ, z)."""
    width: Float[np.ndarray, "T"]
    """The distance of the neighbours in units of |ω|."""
    settled: bool
    """Whether the last of `shape` is where the motion ends: the edge state."""


def edge_state(
    equation: Equation,
    a: Any,
    b: Any,
    *,
    shape: Callable[[Float[np.ndarray, "3"]], Any] = planar_shape,
    tol: float = 1e-6,
    rounds: int = 100,
    **settings: Any,
) -> Edge:
    """Follow dω/dτ = equation(ω) along the basin boundary between a and b to its saddle.

    Neighbours on both sides of the boundary are integrated until they have parted, then the
    boundary is found again between them, and so on: what parts them is only the unstable
    direction, and along all others the motion comes to the edge state.

    Args:
        equation: an equation of motion with a `verdict`.
        a: a start, shape (3,), dimensionless, body axes.
        b: one with another fate.
        shape: what of ω is to settle, since ω itself dies away; the default is (φ, z) of the
            transverse top, which `planar.saddle` gives for small amplitudes.
        tol: settled means: changed by less than this while τ became four times larger.
        rounds: how often the boundary is found again at most.
        settings: of the sweeps, as in `bisect`.

    Returns:
        An `Edge`.

    Raises:
        ValueError: bad arguments, or starts of the same fate.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.boundary import edge_state
        >>> a, b = dt.cylindrical(0.1, 0.0, 0.0), dt.cylindrical(0.1, 0.1, 0.0)
        >>> edge = edge_state(dt.TransverseReduced(-0.2), a, b, tol=1e-4)
        >>> edge.settled, edge.shape[-1].round(3).tolist()
        (True, [0.615, 2.357])
    """
    problem, settling = starts_of(equation), float(tolerance("tol", tol))
    ends = (np.asarray(finite(k, x, (3,), batch=False)) for k, x in (("a", a), ("b", b)))
    found = bisect(problem, *(to_coordinates(end[None]) for end in ends), **settings)
    track, settled = _follow(equation, found, lambda w: np.asarray(shape(w)), settling, rounds)
    pairs = np.stack([pair for _, pair in track])
    omega = pairs.mean(axis=1)
    width = np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1) / np.linalg.norm(omega, axis=1)
    shapes = np.stack([np.asarray(shape(w)) for w in omega])
    return Edge(np.array([t for t, _ in track]), omega, shapes, width, settled)


def _follow(equation, found: Crossings, shape: Any, tol: float, rounds: int) -> tuple[list, bool]:
    """The neighbours at every time at which the boundary was found between them."""
    now, pair = 0.0, _pair(found)
    track = [(now, pair)]
    span = 2 / np.sum(pair[0] ** 2)  # braking times
    landmark, before = span, shape(pair.mean(axis=0))
    for _ in range(budget("rounds", rounds)):
        ts = span * np.arange(1, PARTS + 1) / PARTS
        later = _after(equation, pair, ts, found.settings)
        apart = np.linalg.norm(later[:, 1] - later[:, 0], axis=1)
        near = np.cumprod(apart <= APART * np.linalg.norm(later[:, 0], axis=1))
        if not near[0]:
            span /= PARTS
            continue
        last = int(near.sum()) - 1
        crossed = _between(found, later[last])
        if crossed is None:
            break
        now, pair = now + ts[last], _pair(crossed)
        track.append((now, pair))
        span *= 2.0 if last == PARTS - 1 else 1.0
        if now >= SPAN * landmark:
            change = np.abs(shape(pair.mean(axis=0)) - before)
            if np.all(change <= tol):
                return track, True
            landmark, before = now, shape(pair.mean(axis=0))
    return track, False


def _pair(found: Crossings) -> Float[np.ndarray, "2 3"]:
    """Neighbours on both sides of a single crossing, as near as errors leave them different."""
    a, b = to_array(found.a)[0], to_array(found.b)[0]
    gap = NEIGHBOURS * found.settings["rtol"] * np.linalg.norm(a) / np.linalg.norm(b - a)
    return to_array(found.at(found.s[:, None] + gap * np.array([[-0.5, 0.5]])))[0]


def _between(found: Crossings, pair: Float[np.ndarray, "2 3"]) -> Crossings | None:
    """The boundary between the same two fates, near two states that errors may have moved."""
    half = (pair[1] - pair[0]) / 2 * WIDER[:, None]
    middle = pair.mean(axis=0)
    a, b = to_coordinates(middle - half), to_coordinates(middle + half)
    tried = segments(found.problem, a, b, found.settings)
    same = np.all(fates_at(tried, tried.bracket) == found.fates, axis=1)
    if not same.any():
        return None
    first = slice(int(np.argmax(same)), int(np.argmax(same)) + 1)
    a, b = ({name: x[first] for name, x in end.items()} for end in (a, b))
    return cut(segments(found.problem, a, b, found.settings), ENCLOSED)


def _after(
    equation: Equation, pair: Float[np.ndarray, "2 3"], ts: Float[np.ndarray, "T"], settings: Any
) -> Float[np.ndarray, "T 2 3"]:
    """Where two starts are at several times, each a lane of its own."""
    omegas = jnp.asarray(np.tile(pair, (len(ts), 1)).T)
    arrays, rest = eqx.partition(manifold.physical(equation), eqx.is_array)
    count = omegas.shape[1]
    arrays = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, count)), arrays)
    block = eqx.combine(arrays, rest)
    y0 = lifted(block, omegas)
    rtol = tolerance("rtol", settings["rtol"])
    steps = jnp.asarray(budget("max_steps", settings.get("max_steps", MAX_STEPS)))
    limits = Limits(rtol, absolute(None, rtol, omegas), jnp.asarray(np.repeat(ts, 2)), steps)
    device = next(iter(y0.devices()))
    engine = select_engine(settings.get("engine", "auto"), block, device, "time")
    ends = engine.end_states(block, y0, limits, until="time")
    return np.asarray(block.omega(jnp.asarray(ends.y))).T.reshape(len(ts), 2, 3)
