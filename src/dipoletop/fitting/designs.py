"""The parameters in a box that maximise an objective of ω∞.

Local searches begin at the best points of a sweep over the box, and use the gradients from a sweep
with `derivatives`.
"""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import corners_of_box
from .._base.refusals import refuse
from .._base.summaries import summary
from .._base.tolerances import budget, check_settings, whole
from .._maps.grids import Points
from .._maps.problems import Problem
from .._maps.sweep import PointSweeps

RTOL = 1e-10  # default relative tolerance of the runs

Objective = Callable[[Float[Array, ""], dict[str, Float[Array, ""]]], Float[Array, ""]]
"""A function in JAX from ω∞ and the parameters to the number that a design maximises."""
Point = Float[np.ndarray, "m"]
"""A point of the unit cube, to which the box is scaled."""


class DesignEnd(enum.StrEnum):
    """The reason for the end of a design, one sentence."""

    MAXIMUM = "A maximum: a remaining slope is closed off by a bound or within `gtol`."
    SLOPE = "No maximum: the search ended on a slope, as it does at the edge of a basin."


@dataclass(frozen=True)
class Design:
    """The parameters in a box that maximise an objective.

    Attributes:
        parameters: the best values, by name.
        value: the objective there.
        omega_inf: ω∞ there.
        defect: the largest first-order increase of the objective over the full length of a side of
            the box, among the directions not blocked by a bound; 0 at an exact maximum.
        runs: number of computed trajectories.
        success: whether the best local search ended at a maximum.
        message: the reason for its end, one sentence.
        end: the reason for its end, a member of `DesignEnd`.
    """

    parameters: dict[str, float]
    value: float
    omega_inf: float
    defect: float
    runs: int
    success: bool
    message: str
    end: DesignEnd

    def __repr__(self) -> str:
        return summary(self, "success", "message")


def speed(omega_inf: Float[Array, ""], parameters: dict[str, Float[Array, ""]]) -> Any:
    """Return |ω∞|, the default objective of a design."""
    return jnp.abs(omega_inf)


def design(
    problem: Problem,
    bounds: Mapping[str, tuple[Any, Any]],
    *,
    objective: Objective = speed,
    n: int = 1024,
    seed: int = 0,
    searches: int = 4,
    gtol: float = 1e-6,
    **settings: Any,
) -> Design:
    """Maximise f(ω∞(x), x) over a box low ≤ x ≤ high, by default f = |ω∞|.

    Since f is flat where a top stops, a sweep over the box first ranks possible starting points.
    L-BFGS-B climbs from the best of them, with gradients from sweeps.

    Args:
        problem: a function from the parameters x, by name, to the equation and the start.
        bounds: name = (low, high).
        objective: f(ω∞, parameters), in JAX; ω∞ = 0 for a stop.
        n: number of points of the first sweep, a Halton sequence.
        seed: seed of the sequence.
        searches: number of local searches, from the best points.
        gtol: a search succeeds if its `defect` is at most this times the largest |f| found.
        settings: rtol, here 1e-10, atol, max_steps, devices and engine, as in `sweep`.

    Returns:
        The `Design` of the best search: the global maximum if the first sweep has a point on its
        slope.

    Raises:
        ValueError: an empty box, or a box without a known fate.

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.fitting import design
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> result = design(problem, {"phi": (0.0, np.pi)}, n=64, searches=1)
        >>> result.success, result.value > 0.09887  # ω∞ of figure 2a
        (True, True)
    """
    from scipy.stats import qmc

    check_settings(settings)
    low, high = corners_of_box("bounds", bounds)
    sweeps = PointSweeps(problem, {"rtol": RTOL} | settings)
    landscape = _Landscape(sweeps, objective, tuple(bounds), low, high)
    generator = np.random.default_rng(whole("seed", seed, 0))
    halton = qmc.Halton(len(low), seed=generator)  # pyright: ignore[reportCallIssue]
    units = halton.random(budget("n", n))
    _, values, _ = landscape.values(units)
    if np.all(np.isnan(values)):
        refuse("bounds", "hold parameters whose fate is known", "no fate of those tried is known")
    order = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")
    scale, worst = np.nanmax(np.abs(values)) or 1.0, np.nanmin(values)
    best = order[: budget("searches", searches)]
    climbs = [_climb(landscape, units[k], worst, scale, gtol) for k in best]
    runs = len(units) + sum(climb.nfev for climb in climbs) + 1
    top = min(climbs, key=lambda climb: climb.fun).x
    return _design(landscape, top, gtol * scale, runs)


class _Landscape(NamedTuple):
    """An objective over a box, in coordinates of the unit cube."""

    sweeps: PointSweeps
    objective: Objective
    names: tuple[str, ...]
    low: Float[np.ndarray, "m"]
    high: Float[np.ndarray, "m"]

    def parameters(self, units: Float[np.ndarray, "*k m"]) -> Float[np.ndarray, "*k m"]:
        """Return the parameters at points of the unit cube."""
        return self.low * (1 - units) + self.high * units

    def values(self, units: Float[np.ndarray, "k m"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ω∞, the objective and its gradient at k points; both NaN where ω∞ is unknown."""
        columns = dict(zip(self.names, self.parameters(units).T, strict=True))
        basin = self.sweeps(Points(**columns), self.names)
        omega_inf = basin.omega_inf
        partials = jax.vmap(jax.value_and_grad(self.objective, argnums=(0, 1)))
        parameters = jax.tree.map(jnp.asarray, columns)
        value, (by_omega, by_parameter) = partials(jnp.asarray(omega_inf), parameters)
        gradient = [
            np.asarray(by_omega) * basin.derivative(name) + np.asarray(by_parameter[name])
            for name in self.names
        ]
        value = np.where(np.isnan(omega_inf), np.nan, value)
        return omega_inf, value, np.stack(gradient, axis=-1) * (self.high - self.low)


def _climb(landscape: _Landscape, first: Point, worst: float, scale: float, gtol: float) -> Any:
    """Return the result of a local search from a point of the unit cube."""
    from scipy.optimize import minimize

    def loss(units: Point) -> tuple[float, np.ndarray]:
        _, value, gradient = landscape.values(units[None])
        if np.isnan(value[0]):  # a constant floor, where the search ends
            return -worst / scale, np.zeros_like(units)
        return -value[0] / scale, -gradient[0] / scale

    cube, options = [(0.0, 1.0)] * len(first), {"ftol": 0.0, "gtol": gtol / 10}
    return minimize(loss, first, jac=True, method="L-BFGS-B", bounds=cube, options=options)


def _design(landscape: _Landscape, top: Point, largest_defect: float, runs: int) -> Design:
    """Return the `Design` at the highest point."""
    (omega_inf,), (value,), (gradient,) = landscape.values(top[None])
    closed = ((top <= 0) & (gradient < 0)) | ((top >= 1) & (gradient > 0))
    defect = float(np.max(np.where(closed, 0.0, np.abs(gradient))))
    end = DesignEnd.MAXIMUM if defect <= largest_defect else DesignEnd.SLOPE
    parameters = dict(zip(landscape.names, landscape.parameters(top).tolist(), strict=True))
    good = end is DesignEnd.MAXIMUM
    return Design(parameters, float(value), float(omega_inf), defect, runs, good, str(end), end)
