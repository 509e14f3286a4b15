"""The parameters in a box that make an objective of ω∞ largest.

The best points of a sweep over the box are the first points of local searches, which use the
gradients that a sweep with `derivatives` gives.
"""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import corners_of_box, refuse
from .._base.summaries import summary
from .._base.tolerances import budget, check_settings, whole
from .._maps.grids import Points
from .._maps.problems import Problem
from .._maps.sweep import sweep

RTOL = 1e-10  # of the runs, unless the user gives another
ALSO = ("progress",)  # a setting of `sweep` that may be given, besides those of the runs

Objective = Callable[[Float[Array, ""], dict[str, Float[Array, ""]]], Float[Array, ""]]
"""From ω∞ and the parameters to the number that a design makes largest; in JAX."""
Point = Float[np.ndarray, "m"]
"""A point of the unit cube, to which the box is scaled."""


class DesignEnd(enum.StrEnum):
    """Why a design ended, in one sentence."""

    MAXIMUM = "A maximum: a remaining slope is closed off by a bound or within `gtol`."
    SLOPE = "No maximum: the search ended on a slope, as it does at the edge of a basin."


@dataclass(frozen=True)
class Design:
    """The parameters in a box that make an objective largest.

    Attributes:
        parameters: the best values, by name.
        value: the objective there.
        omega_inf: ω∞ there.
        defect: largest change of the objective, to first order, along the whole length of one
            side of the box, among the directions that no bound closes: 0 at an exact maximum.
        runs: how many trajectories were computed.
        success: whether the best local search ended at a maximum.
        message: why it ended, one sentence.
        end: why it ended, a member of `DesignEnd`.
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
    """|ω∞|, the objective of a design by default."""
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
    """f(ω∞(x), x) → max over a box low ≤ x ≤ high; f = |ω∞| unless another is given.

    A sweep over the box ranks the points where a local search may begin, since f is flat where a
    top stops; from the best of them L-BFGS-B climbs with the gradient that a sweep gives.

    Args:
        problem: a function of the parameters x, by name, that gives the equation and the start.
        bounds: name = (low, high).
        objective: f(ω∞, parameters), in JAX; ω∞ = 0 for a stop.
        n: points of the first sweep, a Halton sequence.
        seed: of the sequence.
        searches: number of local searches, from the best points.
        gtol: a search succeeds where its `defect` is at most this times the largest |f| seen.
        settings: rtol, here 1e-10, atol, max_steps, devices, engine and progress, as in `sweep`.

    Returns:
        A `Design`, of the best search: the global maximum if the first sweep met its slope.

    Raises:
        ValueError: an empty box, or one in which no fate is known.

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.fitting import design
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> result = design(problem, {"phi": (0.0, np.pi)}, n=64, searches=1)
        >>> result.success, result.value > 0.09887  # that of figure 2a
        (True, True)
    """
    from scipy.stats import qmc

    check_settings(settings, ALSO)
    low, high = corners_of_box("bounds", bounds)
    landscape = _Landscape(problem, objective, tuple(bounds), low, high, {"rtol": RTOL} | settings)
    generator = np.random.default_rng(whole("seed", seed, 0))
    halton = qmc.Halton(len(low), seed=generator)  # pyright: ignore[reportCallIssue]
    units = halton.random(budget("n", n))
    _, values, _ = landscape.values(units)
    if np.all(np.isnan(values)):
        refuse("bounds", "hold parameters whose fate is known", "of all that were tried none is")
    order = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")
    scale, worst = np.nanmax(np.abs(values)) or 1.0, np.nanmin(values)
    best = order[: budget("searches", searches)]
    climbs = [_climb(landscape, units[k], worst, scale, gtol) for k in best]
    runs = len(units) + sum(climb.nfev for climb in climbs) + 1
    top = min(climbs, key=lambda climb: climb.fun).x
    return _design(landscape, top, gtol * scale, runs)


class _Landscape(NamedTuple):
    """An objective over a box, whose sides are the units of its points."""

    problem: Problem
    objective: Objective
    names: tuple[str, ...]
    low: Float[np.ndarray, "m"]
    high: Float[np.ndarray, "m"]
    settings: dict[str, Any]

    def parameters(self, units: Float[np.ndarray, "*k m"]) -> Float[np.ndarray, "*k m"]:
        """The parameters at points of the unit cube."""
        return self.low * (1 - units) + self.high * units

    def values(self, units: Float[np.ndarray, "k m"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ω∞, the objective and its gradient at k points; the latter NaN where ω∞ is not known."""
        columns = dict(zip(self.names, self.parameters(units).T, strict=True))
        basin = sweep(self.problem, Points(**columns), derivatives=self.names, **self.settings)
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
    """The result of a local search from a point of the unit cube."""
    from scipy.optimize import minimize

    def loss(units: Point) -> tuple[float, np.ndarray]:
        _, value, gradient = landscape.values(units[None])
        if np.isnan(value[0]):  # a flat floor, on which the search ends
            return -worst / scale, np.zeros_like(units)
        return -value[0] / scale, -gradient[0] / scale

    return minimize(
        loss,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, 1.0)] * len(first),
        options={"ftol": 0.0, "gtol": gtol / 10},
    )


def _design(landscape: _Landscape, top: Point, largest_defect: float, runs: int) -> Design:
    """The result at the highest point."""
    (omega_inf,), (value,), (gradient,) = landscape.values(top[None])
    closed = ((top <= 0) & (gradient < 0)) | ((top >= 1) & (gradient > 0))
    defect = float(np.max(np.where(closed, 0.0, np.abs(gradient))))
    end = DesignEnd.MAXIMUM if defect <= largest_defect else DesignEnd.SLOPE
    return Design(
        dict(zip(landscape.names, landscape.parameters(top).tolist(), strict=True)),
        float(value),
        float(omega_inf),
        defect,
        runs,
        end is DesignEnd.MAXIMUM,
        str(end),
        end,
    )
