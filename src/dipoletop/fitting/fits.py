"""The parameters that best fit a time series, by Gauss–Newton steps in a trust region.

The Jacobian comes from forward differentiation of the trajectory.
"""

import enum
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import finite, numbers_by_name, where_valid
from .._base.refusals import refuse
from .._base.summaries import summary
from .._base.tolerances import budget, tolerance
from .._maps.problems import Problem
from .._runs.simulate import simulate
from .._runs.trajectory import Trajectory
from ..equations._common import is_full, physical

LEAST_GAIN = 1e-6  # least gain of a Gauss–Newton step, relative to chi2; below it: a minimum
RAREST = 1e-6  # probability of so large a chi2, below which the model does not fit
LEAST_STEP = 1e-8  # least Gauss–Newton step, relative to the parameters; below it: a minimum
FTOL, XTOL = 1e-10, 1e-14  # relative changes of chi2 and p at which `least_squares` stops

Observe = Callable[[Trajectory], Float[Array, "..."]]
"""A function from a trajectory to the measured quantity, in the shape of the series."""
Residuals = Callable[[tuple[float, ...]], tuple[np.ndarray, np.ndarray]]
"""A function from parameters to the flat residuals and their Jacobian."""
Parameters = Float[Array, "m"]
Times = Float[Array, "T"]


class FitEnd(enum.StrEnum):
    """The reason for the end of a fit, one sentence."""

    MINIMUM = "A minimum: no step makes chi2 smaller."
    POOR = (
        "A local minimum that does not describe the series: chance makes chi2 so large less often "
        "than once in a million. Begin from another guess."
    )
    UNDETERMINED = "The series does not determine the parameters: others fit it as well."
    REFUSED = (
        "No minimum: chi2 still falls towards parameters that the problem or its solver refuses."
    )
    BUDGET = "No minimum within {} trajectories."


@dataclass(frozen=True)
class Fit:
    """The parameters that best fit a time series.

    Attributes:
        parameters: the best values, by name.
        covariance: covariance in the order of `parameters`, shape (m, m); NaN if the series does
            not determine them.
        chi2: Σ((observed − series)/sigma)²; with sigma = 1 if it is not given.
        dof: number of values minus number of parameters.
        steps: number of computed trajectories.
        success: whether the search ended at a minimum that determines every parameter and, if
            `sigma` is given, describes the series. If it is not, that may be a local minimum.
        message: the reason for the end, one sentence.
        end: the reason for the end, a member of `FitEnd`.

    Property: `errors`, the standard errors of the parameters.
    """

    parameters: dict[str, float]
    covariance: Float[np.ndarray, "m m"]
    chi2: float
    dof: int
    steps: int
    success: bool
    message: str
    end: FitEnd

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the parameters."""
        roots = np.sqrt(np.diag(self.covariance)).tolist()
        return dict(zip(self.parameters, roots, strict=True))

    def __repr__(self) -> str:
        return summary(self, "covariance", "success", "message", parameters="errors")


def velocity(trajectory: Trajectory) -> Float[Array, "T 3"]:
    """Return ω(τ), the default of `observe`."""
    return trajectory.omega


def fit(
    problem: Problem,
    ts: Any,
    series: Any,
    guess: Mapping[str, Any],
    *,
    sigma: Any = None,
    observe: Observe = velocity,
    rtol: float = 1e-10,
    max_trajectories: int = 100,
) -> Fit:
    """Minimise χ²(p) = Σ((observe(trajectory of p) − series)/σ)², with covariance C = (JᵀJ)⁻¹.

    J is the Jacobian of the residuals (observe − series)/σ at the minimum. If the problem refuses a
    trial p, such as δ ≥ 1, the search takes a shorter step.

    Args:
        problem: a function from the parameters p, by name, to the equation and the start.
        ts: times, shape (T,), increasing; the first is the time of the start.
        series: the measured values, finite: ω(τ), shape (T, 3), or the shape of `observe`.
        guess: name = first value; the search goes downhill from here.
        sigma: standard error of the series, a number or an array that broadcasts to it. If it is
            None, one common value is estimated, and C is scaled by χ²/dof.
        observe: function from a `Trajectory` to the series, such as `lambda run: run.omega[:, 0]`.
        rtol: relative tolerance of the trajectory.
        max_trajectories: largest number of trajectories.

    Returns:
        A `Fit`.

    Raises:
        ValueError: a series that is not finite, has another shape than the observed one, or has
            no more values than there are parameters; a guess that the problem or solver refuses.

    Source: Gauss–Newton steps in a trust region, `scipy.optimize.least_squares`.

    Example:
        >>> import jax.numpy as jnp, numpy as np, dipoletop as dt
        >>> from dipoletop.fitting import fit
        >>> def problem(delta, speed):
        ...     return dt.TransverseSemi(delta), speed * jnp.array([0.8, 0.0, 0.6])
        >>> ts = np.linspace(0.0, 50.0, 20)
        >>> series = dt.simulate(*problem(-0.2, 0.3), ts).omega[:, 0]
        >>> guess = {"delta": -0.1, "speed": 0.25}
        >>> result = fit(problem, ts, series, guess, observe=lambda run: run.omega[:, 0])
        >>> result.success, {name: round(value, 6) for name, value in result.parameters.items()}
        (True, {'delta': -0.2, 'speed': 0.3})
    """
    first = numbers_by_name("guess", guess)
    model = _Model(problem, tuple(first), observe, float(tolerance("rtol", rtol)))
    times = finite("ts", ts, (-1,), batch=False)
    times = where_valid("ts", times, jnp.all(jnp.diff(times) > 0), "increase")
    data = _series(model, first, times, series)
    residuals = _residuals(model, first, times, data, _weight(sigma, data.shape))
    most = budget("max_trajectories", max_trajectories)
    result = _least_squares(residuals, list(first.values()), most)
    return _fit(model, result, estimate_sigma=sigma is None)


class _Model(NamedTuple):
    """The fitted function, compiled once for all series of one shape."""

    problem: Problem
    names: tuple[str, ...]
    observe: Observe
    rtol: float

    def equation_and_start(self, p: Parameters) -> tuple[Any, Any]:
        """Return the equation and the start at these parameters."""
        return self.problem(**dict(zip(self.names, p, strict=True)))

    def observed(self, p: Parameters, safe: Parameters, times: Times) -> Float[Array, "..."]:
        """Return the series predicted by the parameters; not finite if their run fails."""
        arrays = jax.tree.leaves(eqx.filter(self.equation_and_start(p), eqx.is_inexact_array))
        valid = functools.reduce(jnp.logical_and, [jnp.all(jnp.isfinite(x)) for x in arrays])
        # A run from NaN would use up its whole budget of steps.
        equation, start = self.equation_and_start(jnp.where(valid, p, safe))
        options: dict[str, Any] = {"rtol": self.rtol, "throw": False}
        if not is_full(physical(equation)):  # diffrax does not integrate full equations
            options["adjoint"] = diffrax.ForwardMode()
        run = simulate(equation, start, times, **options)
        return jnp.where(valid, self.observe(run), jnp.nan)


@eqx.filter_jit
def _linearised(
    model: _Model, p: Parameters, safe: Parameters, times: Times
) -> tuple[Float[Array, "*s"], Float[Array, "*s m"]]:
    """Return the predicted series, and its Jacobian, with the parameters on the last axis."""

    def with_copy(p: Parameters) -> tuple[Array, Array]:
        series = model.observed(p, safe, times)
        return series, series

    jacobian, series = jax.jacfwd(with_copy, has_aux=True)(p)
    return series, jacobian


def _residuals(
    model: _Model, first: dict[str, float], times: Times, data: np.ndarray, weight: np.ndarray
) -> Residuals:
    """Return a function for (observed − series)/σ and its Jacobian."""
    safe = jnp.asarray(list(first.values()))

    @functools.lru_cache(maxsize=1)  # the Jacobian is needed at the last residuals' p
    def residuals_at(p: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        series, slope = map(np.asarray, _linearised(model, jnp.asarray(p), safe, times))
        rows = (slope * weight[..., None]).reshape(-1, len(p))
        return ((series - data) * weight).ravel(), rows

    if not all(np.all(np.isfinite(x)) for x in residuals_at(tuple(first.values()))):
        must = "start a run that can be followed, with its derivatives, to the last of `ts`"
        refuse("guess", must, "its run fails")
    return residuals_at


def _series(model: _Model, first: dict[str, float], times: Times, series: Any) -> np.ndarray:
    """Return the series after checking that it has the observed shape and enough values."""
    try:
        model.problem(**first)  # with known values, so that a bad one is refused by name
    except TypeError as error:
        refuse("guess", "name the arguments of `problem`", f"has {', '.join(first)} ({error})")
    p = jnp.asarray(list(first.values()))
    shape = jax.eval_shape(model.observed, p, p, times).shape
    data = np.asarray(finite("series", series, shape, batch=False))
    if data.size <= len(first):
        must = f"hold more than {len(first)} values, one for each parameter"
        refuse("series", must, f"holds {data.size}")
    return data


def _weight(sigma: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return 1/σ in the shape of the series."""
    if sigma is None:
        return np.ones(shape)
    errors = np.asarray(finite("sigma", sigma, np.shape(sigma), batch=False))
    if np.any(errors <= 0):
        refuse("sigma", "be positive", f"has {errors[errors <= 0].flat[0]:g}")
    try:
        return np.broadcast_to(1 / errors, shape)
    except ValueError:
        refuse("sigma", f"broadcast to the series, shape {shape}", f"has shape {errors.shape}")


def _least_squares(residuals: Residuals, first: list[float], most: int) -> Any:
    """Return the result of SciPy's `least_squares`, downhill from the guess."""
    from scipy.optimize import least_squares

    with np.errstate(divide="ignore", invalid="ignore"):  # of a singular Jacobian
        return least_squares(
            lambda p: residuals(tuple(p.tolist()))[0],
            first,
            lambda p: residuals(tuple(p.tolist()))[1],  # pyright: ignore[reportArgumentType]
            x_scale="jac",
            ftol=FTOL,
            xtol=XTOL,
            gtol=None,  # pyright: ignore[reportArgumentType]
            max_nfev=most,
        )


def _fit(model: _Model, result: Any, estimate_sigma: bool) -> Fit:
    """Return a `Fit` from the result of `least_squares`."""
    from scipy.special import chdtrc

    size, m = result.jac.shape
    chi2, dof = 2 * float(result.cost), size - m
    units = np.linalg.norm(result.jac, axis=0)
    left, values, rows = np.linalg.svd(result.jac / np.where(units > 0, units, 1.0), False)
    # A singular value below the error of the Jacobian carries no information.
    determined = np.all(values > 100 * model.rtol * values[0]) and np.all(units > 0)
    root = rows.T / values / units[:, None] if determined else np.full((m, m), np.nan)
    # If refused parameters stopped the search, the Gauss–Newton step is still large.
    gain = left.T @ result.fun
    small_step = np.linalg.norm(root @ gain) <= LEAST_STEP * np.linalg.norm(result.x)
    if not determined:
        end = FitEnd.UNDETERMINED
    elif result.status == 0:
        end = FitEnd.BUDGET
    else:
        at_minimum = gain @ gain <= LEAST_GAIN * chi2 or small_step
        end = FitEnd.MINIMUM if at_minimum else FitEnd.REFUSED
        if at_minimum and not estimate_sigma and chdtrc(dof, chi2) < RAREST:
            end = FitEnd.POOR
    parameters = dict(zip(model.names, result.x.tolist(), strict=True))
    covariance = root @ root.T * (chi2 / dof if estimate_sigma else 1.0)
    steps, good = int(result.nfev), end is FitEnd.MINIMUM
    return Fit(parameters, covariance, chi2, dof, steps, good, end.format(steps), end)
