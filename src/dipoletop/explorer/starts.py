"""One start of a map: its verdict, the derivatives of ω∞, its motion."""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.compiling import COMPILED_SOON
from .._base.types import Outcome, Regime, Stop
from .._maps.grids import Grid
from .._maps.problems import Problem
from .._runs.sensitivity import residual_rotation
from .._runs.simulate import simulate
from ..equations._common import follows_attitude
from ..equations.levels import Level
from .drawing import Drawing
from .views import View

FRAMES = 240
"""Number of pictures of the moving body at the beginning, and again at the end."""
BETWEEN = 800
"""Number of times of the curves between these two groups of pictures."""
TURN = 0.15
"""Largest rotation of the body from one picture to the next, in radians."""
TOLD_APART = 0.35
"""Largest precession from one point of a curve to the next, in radians."""
SETTLED = 3.0
"""Length of the motion shown, in units of the time until its outcome is certain."""


class StartVerdict(NamedTuple):
    """How a start ends at a level."""

    level: str
    outcome: str
    omega_inf: float
    omega_inf_error: float
    time: float
    steps: int
    certified: bool
    regime: Regime
    probability: float


class OfBody(NamedTuple):
    """Energy and attitude along a motion, and the body, if its equation has one."""

    energy: Float[np.ndarray, "T"] | Float[Array, "T"]
    attitude: Float[np.ndarray, "T 4"] | Float[Array, "T 4"]
    dipole: Float[np.ndarray, "3"] | Float[Array, "3"]
    inertia: Float[np.ndarray, "3 3"] | Float[Array, "3 3"]


class ShownMotion(NamedTuple):
    """The motion from a start at a level."""

    level: str
    ts: Float[np.ndarray, "T"]
    omega: Float[np.ndarray, "T 3"]
    of_body: OfBody | None
    is_cut: bool
    """Whether it ends before the outcome is certain, because the points of a longer curve would be
    too far apart to resolve its turns."""


def verdict_of(
    drawing: Drawing, level: Level | None, values: Mapping[str, float], rtol: float
) -> StartVerdict:
    """Return the verdict of a start, computed as for a map.

    Raises:
        ValueError: values that the problem refuses.
    """
    basin = drawing.sweep(level, Grid(**{name: [x] for name, x in values.items()}), rtol, True)
    outcome, stop = Outcome(basin.outcome.item()), Stop(basin.stop.item())
    words = outcome.name.lower() + ("" if stop is Stop.NONE else f", {stop.name.lower()}")
    names = "omega_inf", "omega_inf_error", "time", "steps", "certified", "probability"
    numbers = {name: basin.column(name).item() for name in names}
    return StartVerdict(basin.level, words, regime=Regime(basin.regime.item()), **numbers)


def slopes_of(problem: Problem, values: Mapping[str, float], rtol: float) -> dict[str, float]:
    """Return ∂ω∞/∂q for every quantity q at a start; see the table of `residual_rotation`."""
    slopes = _gradient(problem)(_point(values), jnp.asarray(rtol))
    return {name: float(slope) for name, slope in slopes.items()}


def _point(values: Mapping[str, float]) -> dict[str, Array]:
    return {name: jnp.asarray(float(value)) for name, value in values.items()}


@functools.lru_cache(maxsize=16)
def _gradient(problem: Problem) -> Callable[..., dict[str, Array]]:
    """Return a function for the gradient of ω∞, compiled once for each problem."""

    def omega_inf(point: dict[str, Array], rtol: Array) -> Array:
        equation, omega0 = problem(**point)
        return residual_rotation(equation, omega0, rtol=rtol)

    return jax.jit(jax.grad(omega_inf), compiler_options=COMPILED_SOON)


@functools.lru_cache(maxsize=16)
def _motion(problem: Problem) -> Callable[..., tuple[Array, OfBody | None]]:
    """Return a function for ω, energy and attitude at given times, compiled once for a problem."""

    def motion(point: dict[str, Array], ts: Array, rtol: Array) -> tuple[Array, OfBody | None]:
        equation, omega0 = problem(**point)
        body = getattr(equation, "body", None)
        known = body is None or follows_attitude(equation)
        level = None if known else [1.0, 0.0, 0.0, 0.0]
        run = simulate(equation, omega0, ts, rtol=rtol, attitude=level, throw=False)
        if body is None:
            return run.omega, None
        return run.omega, OfBody(run.energy, run.attitude, body.dipole, body.inertia)

    return jax.jit(motion, compiler_options=COMPILED_SOON)


def motion_of(
    problem: Problem, values: Mapping[str, float], verdict: StartVerdict, rtol: float
) -> ShownMotion:
    """Return the motion from a start until well after its outcome is certain.

    Args:
        problem: as for `sweep`.
        values: its arguments.
        verdict: how it ends.
        rtol: relative tolerance of every step.

    Raises:
        ValueError: values that the problem refuses.
        RuntimeError: the run did not reach the last of its times.
    """
    point = _point(values)
    equation, omega0 = problem(**point)
    speed = float(np.linalg.norm(np.asarray(omega0)))
    late = abs(verdict.omega_inf) if math.isfinite(verdict.omega_inf) else 0.0
    precession = _precession(getattr(equation, "body", None), speed)
    ts, is_cut = times_of(speed, late, precession, verdict.time)
    run = _motion(problem)(point, jnp.asarray(ts), jnp.asarray(rtol))
    omega, of_body = jax.tree.map(np.asarray, run)
    if not np.all(np.isfinite(omega)):
        raise RuntimeError(f"The motion could not be followed to τ = {ts[-1]:.4g}.")
    return ShownMotion(verdict.level, ts, omega, of_body, is_cut)


def path_of(motion: ShownMotion, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes of a view along a motion, NaN between sides of a whole turn.

    Both are empty if an axis is none of the quantities that a rotation has.
    """
    w1, w2, w3 = motion.omega.T
    across = np.hypot(w1, w2)
    found = {"w_perp": across, "w3": w3, "amplitude": np.hypot(across, w3)}
    found |= {"theta": np.arctan2(across, w3), "phi": np.arctan2(w2, w1)}
    if view.x not in found or view.y not in found:
        return np.empty(0), np.empty(0)
    path = []
    for name in (view.x, view.y):
        values, (low, high) = found[name], view.ranges[name]
        if name == "phi":
            middle = (low + high) / 2
            values = values + 2 * math.pi * np.round((middle - values) / (2 * math.pi))
            jumps = np.abs(np.diff(values, prepend=values[0])) > math.pi
            values = np.where(jumps, np.nan, values)
        path.append(values)
    return path[0], path[1]


def _precession(body: Any, speed: float) -> float:
    """Return a bound on the rate at which ω turns in the body; |ω| without a known body."""
    if body is None:
        return speed
    moments = np.linalg.eigvalsh(np.asarray(body.inertia))
    return speed * float((moments[-1] - moments[0]) / moments[0])


def times_of(
    speed: float, late: float, precession: float, certain_at: float
) -> tuple[Float[np.ndarray, "T"], bool]:
    """Return a fixed number of times of a motion, dense at both ends for pictures of the body.

    Args:
        speed: |ω₀|.
        late: |ω∞|; 0 for a stop, or if unknown.
        precession: a bound on the rate at which ω changes its direction in the body.
        certain_at: τ at which the outcome is certain; NaN if unknown.

    Returns:
        The times, and whether they end before the outcome is certain.
    """
    if speed == 0:
        return np.linspace(0.0, 1.0, 2 * FRAMES + BETWEEN), False
    wanted = SETTLED * certain_at if math.isfinite(certain_at) else 0.0
    wanted = max(wanted, 20 / speed)
    last = min(wanted, BETWEEN * TOLD_APART / precession) if precession > 0 else wanted
    late = max(late, 1 / math.sqrt(speed**-2 + 2 * last))  # of a top that stops
    begin, end = (min((FRAMES - 1) * TURN / rate, 0.4 * last) for rate in (speed, late))
    parts = (
        np.linspace(0.0, begin, FRAMES),
        np.linspace(begin, last - end, BETWEEN + 2)[1:-1],
        np.linspace(last - end, last, FRAMES),
    )
    return np.concatenate(parts), last < certain_at
