"""Parameters found: those that explain a measured series, and those that rotate fastest for ever.

Both take a problem as `sweep` does: from named parameters to an equation and a start.
"""

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

from ._base.checks import finite, refuse, where_valid
from ._base.tolerances import budget, tolerance, whole
from ._branch import march as manifold
from ._maps.grids import Points
from ._maps.problems import Problem
from ._maps.sweep import sweep
from ._runs.simulate import simulate
from ._runs.trajectory import Trajectory
from .uncertainty import box, numbers

Observe = Callable[[Trajectory], Float[Array, "..."]]
"""From a trajectory to what was measured, in the shape of the series."""
Objective = Callable[[Float[Array, ""], dict[str, Float[Array, ""]]], Float[Array, ""]]
"""From ω∞ and the parameters to what shall be as large as possible; in JAX."""

MINIMUM = "A minimum: no step makes chi2 smaller."
UNDETERMINED = "The series does not determine the parameters: others fit it as well."
WALL = "No minimum: chi2 still falls towards parameters that the problem or its solver refuses."
SUMMIT = "A maximum: what slope is left, a bound closes or `gtol` allows."
SLOPE = "No maximum: the search ended on a slope, as it does at the edge of a basin."


@dataclass(frozen=True)
class Fit:
    """The parameters that explain a series best.

    Attributes:
        parameters: the best values, by name.
        covariance: of the parameters, in the order of `parameters`, shape (m, m); NaN where the
            series does not determine them.
        chi2: Σ((observed − series)/sigma)²; with sigma = 1 where none is known.
        dof: number of values less number of parameters.
        steps: how often the trajectory was computed.
        success: whether the search ended at a minimum that determines every parameter. It may be
            a local one: see whether `chi2` is about `dof`.
        message: why it ended, one sentence.
    """

    parameters: dict[str, float]
    covariance: Float[np.ndarray, "m m"]
    chi2: float
    dof: int
    steps: int
    success: bool
    message: str

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the parameters."""
        roots = np.sqrt(np.diag(self.covariance)).tolist()
        return dict(zip(self.parameters, roots, strict=True))


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
    """

    parameters: dict[str, float]
    value: float
    omega_inf: float
    defect: float
    runs: int
    success: bool
    message: str


def velocity(run: Trajectory) -> Float[Array, "T 3"]:
    """ω(τ), what a series is by default."""
    return run.omega


def fit(
    problem: Problem,
    ts: Any,
    series: Any,
    guess: Mapping[str, Any],
    *,
    sigma: Any = None,
    observe: Observe = velocity,
    rtol: Any = 1e-10,
    max_steps: Any = 100,
) -> Fit:
    """χ²(p) = Σ((observe(trajectory of p) − series)/σ)² → min, with the covariance C = (JᵀJ)⁻¹.

    J is the Jacobian of the residuals (observe − series)/σ at the minimum. A trial p that the
    problem cannot take, such as δ ≥ 1, is refused by the search, which goes a shorter way.

    Args:
        problem: a function of the parameters p, by name, that gives the equation and the start.
        ts: times, shape (T,), increasing; the first is the start.
        series: what was measured, finite: ω(τ), shape (T, 3), or what `observe` makes of it.
        guess: name = first value; the minimum found is the one downhill from here.
        sigma: standard error of the series, a number or an array that broadcasts to it. For None
            one for all is estimated: C is scaled by χ²/dof.
        observe: from a `Trajectory` to the series, such as `lambda run: run.omega[:, 0]`.
        rtol: relative tolerance of the trajectory.
        max_steps: budget of trajectories.

    Returns:
        A `Fit`.

    Raises:
        ValueError: a series of another shape than what is observed, or not finite, or without
            more values than parameters; a guess that the problem or the solver cannot take.

    Source: Gauss–Newton steps in a trust region, `scipy.optimize.least_squares`.

    Example:
        >>> import jax.numpy as jnp, numpy as np, dipoletop as dt
        >>> from dipoletop.fitting import fit
        >>> def problem(delta, speed):
        ...     return dt.TransverseSemi(delta), speed * jnp.array([0.8, 0.0, 0.6])
        >>> ts = np.linspace(0.0, 50.0, 20)
        >>> series = dt.simulate(*problem(-0.2, 0.3), ts).omega[:, 0]
        >>> guess = {"delta": -0.1, "speed": 0.25}
        >>> found = fit(problem, ts, series, guess, observe=lambda run: run.omega[:, 0])
        >>> found.success, {name: round(value, 6) for name, value in found.parameters.items()}
        (True, {'delta': -0.2, 'speed': 0.3})
    """
    from scipy.optimize import least_squares

    first = numbers("guess", guess)
    safe = jnp.asarray(list(first.values()))
    model = _Model(problem, tuple(first), observe, float(tolerance("rtol", rtol)))
    times = finite("ts", ts, (-1,), batch=False)
    times = where_valid("ts", times, jnp.all(jnp.diff(times) > 0), "increase")
    data = _series(model, first, times, series)
    weight = _weight(sigma, data.shape)

    @functools.lru_cache(maxsize=1)  # the Jacobian is wanted where the residuals were last
    def at(p: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        found, slope = map(np.asarray, _linearised(model, jnp.asarray(p), safe, times))
        return ((found - data) * weight).ravel(), (slope * weight[..., None]).reshape(-1, len(p))

    if not all(np.all(np.isfinite(x)) for x in at(tuple(first.values()))):
        must = "start a run that can be followed, with its derivatives, to the last of `ts`"
        refuse("guess", must, "its run fails")
    with np.errstate(divide="ignore", invalid="ignore"):  # of a singular Jacobian
        found = least_squares(
            lambda p: at(tuple(p.tolist()))[0],
            list(first.values()),
            lambda p: at(tuple(p.tolist()))[1],  # pyright: ignore[reportArgumentType]
            x_scale="jac",
            ftol=1e-10,
            xtol=1e-14,
            gtol=None,  # pyright: ignore[reportArgumentType]
            max_nfev=budget("max_steps", max_steps),
        )
    return _fit(model, found, sigma is None)


class _Model(NamedTuple):
    """What is fitted; compiled once for all series of one shape."""

    problem: Problem
    names: tuple[str, ...]
    observe: Observe
    rtol: float

    def made(self, p: Float[Array, "m"]) -> tuple[Any, Any]:
        """Equation and start."""
        return self.problem(**dict(zip(self.names, p, strict=True)))

    def observed(
        self, p: Float[Array, "m"], safe: Float[Array, "m"], times: Float[Array, "T"]
    ) -> Float[Array, "..."]:
        """What the parameters predict; not finite if their run fails."""
        arrays = jax.tree.leaves(eqx.filter(self.made(p), eqx.is_inexact_array))
        able = functools.reduce(jnp.logical_and, [jnp.all(jnp.isfinite(x)) for x in arrays])
        # A run from NaN would use up all of its budget.
        equation, start = self.made(jnp.where(able, p, safe))
        options: dict[str, Any] = {"rtol": self.rtol, "throw": False}
        if not manifold.is_full(manifold.physical(equation)):  # which diffrax does not follow
            options["adjoint"] = diffrax.ForwardMode()
        run = simulate(equation, start, times, **options)
        return jnp.where(able, self.observe(run), jnp.nan)


@eqx.filter_jit
def _linearised(model: _Model, p: Float[Array, "m"], *given: Float[Array, "_"]) -> Any:
    """What is observed, and its Jacobian, with the parameters on the last axis."""

    def twice(p: Float[Array, "m"]) -> Any:
        found = model.observed(p, *given)
        return found, found

    slope, found = jax.jacfwd(twice, has_aux=True)(p)
    return found, slope


def _series(model: _Model, first: dict[str, float], times: Any, series: Any) -> np.ndarray:
    """The series, if it is what can be observed and determines the parameters."""
    try:
        model.problem(**first)  # known values: a bad one is refused by its own name
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
    """1/σ in the shape of the series."""
    if sigma is None:
        return np.ones(shape)
    errors = np.asarray(finite("sigma", sigma, np.shape(sigma), batch=False))
    if np.any(errors <= 0):
        refuse("sigma", "be positive", f"has {errors[errors <= 0].flat[0]:g}")
    try:
        return np.broadcast_to(1 / errors, shape)
    except ValueError:
        refuse("sigma", f"broadcast to the series, shape {shape}", f"has shape {errors.shape}")


def _fit(model: _Model, found: Any, scaled: bool) -> Fit:
    """The result, from that of `least_squares`."""
    size, m = found.jac.shape
    chi2, dof = 2 * float(found.cost), size - m
    units = np.linalg.norm(found.jac, axis=0)
    left, values, rows = np.linalg.svd(found.jac / np.where(units > 0, units, 1.0), False)
    # What is smaller than the error of the Jacobian is no information.
    determined = np.all(values > 100 * model.rtol * values[0]) and np.all(units > 0)
    root = rows.T / values / units[:, None] if determined else np.full((m, m), np.nan)
    # A search that a wall ends leaves a step to go, and a lower chi2 behind it.
    gain = left.T @ found.fun
    step = np.linalg.norm(root @ gain)
    ended = gain @ gain <= 1e-6 * chi2 or step <= 1e-8 * np.linalg.norm(found.x)
    if not determined:
        message = UNDETERMINED
    elif found.status == 0:
        message = f"No minimum within {found.nfev} trajectories."
    else:
        message = MINIMUM if ended else WALL
    return Fit(
        dict(zip(model.names, found.x.tolist(), strict=True)),
        root @ root.T * (chi2 / dof if scaled else 1.0),
        chi2,
        dof,
        int(found.nfev),
        message == MINIMUM,
        message,
    )


def speed(omega_inf: Float[Array, ""], parameters: dict[str, Float[Array, ""]]) -> Any:
    """|ω∞|, what a design makes largest by default."""
    return jnp.abs(omega_inf)


def design(
    problem: Problem,
    bounds: Mapping[str, tuple[Any, Any]],
    *,
    objective: Objective = speed,
    n: Any = 1024,
    starts: Any = 4,
    seed: Any = 0,
    gtol: float = 1e-6,
    **options: Any,
) -> Design:
    """f(ω∞(x), x) → max over a box low ≤ x ≤ high; f = |ω∞| unless another is given.

    A sweep over the box ranks where to begin, since f is flat where a top stops; from the best
    points L-BFGS-B climbs with the gradient that the sweep's tangent lanes give.

    Args:
        problem: a function of the parameters x, by name, that gives the equation and the start.
        bounds: name = (low, high).
        objective: f(ω∞, parameters), in JAX; ω∞ = 0 for a stop.
        n: points of the first sweep, a Halton sequence.
        starts: how many of them a local search begins at.
        seed: of the sequence.
        gtol: a search succeeds where its `defect` is at most this times the largest |f| seen.
        options: passed to `sweep`; `rtol` is 1e-10 if it is not given.

    Returns:
        A `Design`, of the best of the local searches. That it is the global maximum is likely
        as far as the first sweep was fine enough to see it.

    Raises:
        ValueError: an empty box, or one in which no fate is known.

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.fitting import design
        >>> def problem(phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)
        >>> found = design(problem, {"phi": (0.0, np.pi)}, n=64, starts=1)
        >>> found.success, found.value > 0.09887  # that of figure 2a
        (True, True)
    """
    from scipy.optimize import minimize
    from scipy.stats import qmc

    low, high = box("bounds", bounds)
    side, names = high - low, tuple(bounds)
    known = functools.partial(_objective, problem, objective, {"rtol": 1e-10, **options})

    def at(units: Float[np.ndarray, "k m"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        columns = dict(zip(names, (low * (1 - units) + high * units).T, strict=True))
        omega_inf, value, slope = known(columns)
        return omega_inf, value, slope * side

    many = budget("n", n)
    generator = np.random.default_rng(whole("seed", seed, 0))
    units = qmc.Halton(len(names), seed=generator).random(many)  # pyright: ignore[reportCallIssue]
    _, values, _ = at(units)
    if np.all(np.isnan(values)):
        refuse("bounds", "hold parameters whose fate is known", "of all that were tried none is")
    worst, scale = np.nanmin(values), np.nanmax(np.abs(values)) or 1.0

    def loss(u: Float[np.ndarray, "m"]) -> tuple[float, np.ndarray]:
        _, value, slope = at(u[None])
        if np.isnan(value[0]):  # nowhere to go on from
            return -worst / scale, np.zeros_like(u)
        return -value[0] / scale, -slope[0] / scale

    order = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")
    climbs = [
        minimize(
            loss,
            units[k],
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(names),
            options={"ftol": 0.0, "gtol": gtol / 10},
        )
        for k in order[: budget("starts", starts)]
    ]
    top = min(climbs, key=lambda climb: climb.fun).x
    (omega_inf,), (value,), (slope,) = at(top[None])
    closed = ((top <= 0) & (slope < 0)) | ((top >= 1) & (slope > 0))
    defect = float(np.max(np.where(closed, 0.0, np.abs(slope))))
    success = bool(defect <= gtol * scale)
    return Design(
        dict(zip(names, (low * (1 - top) + high * top).tolist(), strict=True)),
        float(value),
        float(omega_inf),
        defect,
        many + sum(climb.nfev for climb in climbs) + 1,
        success,
        SUMMIT if success else SLOPE,
    )


def _objective(
    problem: Problem, objective: Objective, options: dict[str, Any], columns: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ω∞, the objective and its gradient (k, m) at k points; NaN where ω∞ is not known."""
    basin = sweep(problem, Points(**columns), derivatives=tuple(columns), **options)
    omega_inf = basin.omega_inf
    both = jax.vmap(jax.value_and_grad(objective, argnums=(0, 1)))
    value, (by_omega, by_name) = both(jnp.asarray(omega_inf), jax.tree.map(jnp.asarray, columns))
    slope = [
        np.asarray(by_omega) * basin.derivative(name) + np.asarray(by_name[name])
        for name in columns
    ]
    return omega_inf, np.where(np.isnan(omega_inf), np.nan, value), np.stack(slope, axis=-1)
