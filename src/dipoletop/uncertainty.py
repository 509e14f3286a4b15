"""Propagation of uncertain parameters, with a covariance or ranges, to ω∞ and the outcome.

`propagate` compares the first order, Var ω∞ ≈ gᵀCg, with random draws; `sobol` attributes the
variance to the parameters. A call makes one sweep or two.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._base.checks import corners_of_box, finite, numbers_by_name
from ._base.refusals import refuse
from ._base.statistics import Share, mean_and_error, share_of
from ._base.summaries import summary, with_error
from ._base.tolerances import check_settings, whole
from ._base.types import Fate, Outcome, implied_probability
from ._maps.grids import Points, Sample
from ._maps.problems import Problem
from ._maps.sweep import sweep
from ._runs.classification import UNCHECKED
from .boundary import fate

ALSO = ("value", "progress")  # settings of `sweep` that are allowed besides the settings of runs
STORED = (*ALSO, "store", "repair")  # and if a call makes a single sweep
RESAMPLES = 400  # of the bootstrap
ASYMMETRY = 1e-10  # allowed in a covariance, in units of the standard deviations
NEGATIVE = 1e-12  # size of a negative eigenvalue allowed for rounding, for each dimension


class Estimate(NamedTuple):
    """A number from a random sample, with its standard error."""

    value: float
    error: float

    def __repr__(self) -> str:
        return with_error(self.value, self.error)


class Index(NamedTuple):
    """A share of the variance, with its 95 % interval."""

    value: float
    low: float
    high: float

    def __repr__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"


@dataclass(frozen=True)
class Propagation:
    """The consequences of a covariance of the parameters for ω∞ and for the outcome.

    Attributes:
        omega_inf: ω∞ at the mean; 0 for a stop, NaN if unknown.
        gradient: g = ∂ω∞/∂x at the mean, by name.
        linear_std: √(gᵀCg), the standard deviation of ω∞ to first order.
        shares: probability of every outcome that occurs, with 95 % intervals (Wilson).
        other: probability of a fate that differs from the fate at the mean: another outcome, sign
            of ω∞ or kind of stop. An unknown fate counts as different.
        mean: mean of the signed ω∞ of RESIDUAL draws; NaN if there are none.
        std: their standard deviation; NaN for fewer than two.

    Property: `trusted`, whether `linear_std` may be used.
    """

    omega_inf: float
    gradient: dict[str, float]
    linear_std: float
    shares: dict[str, Share]
    other: Share
    mean: Estimate
    std: Estimate

    @property
    def trusted(self) -> bool:
        """Whether `linear_std` may be used: it is known, and no draw has a different fate."""
        return bool(np.isfinite(self.linear_std)) and self.other.count == 0

    def __repr__(self) -> str:
        return summary(self)


@dataclass(frozen=True)
class SobolIndices:
    """The shares of the variance of a fate that each parameter causes, alone or with others.

    Attributes:
        target: the target f: "omega_inf" or "residual".
        first: S = Var E(f | x) / Var f, by name.
        total: T = 1 − Var E(f | all but x) / Var f, by name.
        mean: E f.
        variance: Var f.
        runs: number of runs.
        unknown: share of runs with an unknown target (UNDECIDED, FAILED).
    """

    target: str
    first: dict[str, Index]
    total: dict[str, Index]
    mean: float
    variance: float
    runs: int
    unknown: float

    def __repr__(self) -> str:
        return summary(self)


def propagate(
    problem: Problem,
    mean: Mapping[str, Any],
    covariance: Any,
    *,
    n: int = 4096,
    seed: int = 0,
    **settings: Any,
) -> Propagation:
    """Compute Var ω∞ ≈ gᵀCg with g = ∂ω∞/∂x, and without linearisation from random draws.

    Args:
        problem: a function from the parameters x, by name, to the equation and the start.
        mean: name = value of x.
        covariance: C, shape (m, m), in the order of `mean`; it may be singular.
        n: number of draws x ~ N(mean, C); a draw that the problem refuses is FAILED.
        seed: seed of the draws; draw i depends on (seed, i) only.
        settings: rtol, atol, max_steps, devices, engine, value and progress, as in `sweep`. For
            the draws the default of `value` is "unchecked", since statistics do not need the
            estimated error of each ω∞.

    Returns:
        A `Propagation`. Near a basin boundary, where draws have several fates, ω∞ is not a linear
        function of x, and `trusted` is False.

    Raises:
        ValueError: a mean that is not finite, a matrix that is not a covariance, bad settings.

    Source: the first order of the law of propagation of uncertainty (GUM, JCGM 100), and its
        Monte Carlo supplement (JCGM 101).

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.uncertainty import propagate
        >>> def problem(delta, phi):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.2, phi)
        >>> mean = {"delta": -0.2, "phi": np.pi / 30}  # figure 2a
        >>> result = propagate(problem, mean, np.diag([1e-6, 1e-6]), n=256)
        >>> result.trusted, bool(abs(result.std.value / result.linear_std - 1) < 0.2)
        (True, True)
    """
    check_settings(settings, ALSO)
    means = numbers_by_name("mean", mean)
    root = _root(covariance, len(means))
    at_mean = sweep(problem, Points(**means), derivatives=tuple(means), **settings)
    gradient = np.array([at_mean.derivative(name)[0] for name in means])
    with np.errstate(invalid="ignore"):  # infinity times 0 gives NaN
        linear_std = np.linalg.norm(gradient @ np.asarray(root))
    centre = jnp.asarray(list(means.values()))

    def draw(key: Array) -> dict[str, Array]:
        point = centre + root @ jax.random.normal(key, centre.shape, float)
        return dict(zip(means, point, strict=True))

    sample = Sample(n=n, seed=seed, draw=draw)
    drawn = sweep(problem, sample, **{"value": UNCHECKED, **settings})
    residual = drawn.omega_inf[drawn.outcome == Outcome.RESIDUAL]
    other = (fate(drawn) != fate(at_mean)) | (fate(at_mean) <= Fate.UNDECIDED)
    value, slopes = float(at_mean.omega_inf[0]), dict(zip(means, gradient.tolist(), strict=True))
    changed = share_of(int(other.sum()), len(other))
    mean_and_std = _mean_and_std(residual[np.isfinite(residual)])
    shares = drawn.fractions()
    return Propagation(value, slopes, float(linear_std), shares, changed, *mean_and_std)


def _root(covariance: Any, m: int) -> Float[Array, "m m"]:
    """Return R with RRᵀ = C."""
    matrix = np.asarray(finite("covariance", covariance, (m, m), batch=False))
    # Scaled by the standard deviations, so that the units of the parameters do not matter.
    units = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
    values, vectors = np.linalg.eigh(matrix / np.outer(units, units))
    must = "be symmetric without a negative eigenvalue"
    if np.max(np.abs(matrix - matrix.T) / np.outer(units, units)) > ASYMMETRY:
        refuse("covariance", must, "is not symmetric")
    if np.min(values) < -NEGATIVE * m:
        refuse("covariance", must, "has one")
    return jnp.asarray(units[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _mean_and_std(values: Float[np.ndarray, "n"]) -> tuple[Estimate, Estimate]:
    """Return mean and standard deviation with errors, from Var s² = (μ₄ − s⁴)/n for large n."""
    n = len(values)
    mean, error = mean_and_error(values)
    estimate = Estimate(float(mean), float(error))
    if n < 2:
        return estimate, Estimate(np.nan, np.nan)
    variance = float(np.var(values, ddof=1))
    fourth_moment = float(np.mean((values - mean) ** 4))
    std = np.sqrt(variance)
    variance_error = np.sqrt(max(fourth_moment - variance**2, 0.0) / n)
    return estimate, Estimate(float(std), float(variance_error / (2 * std)) if std > 0 else 0.0)


def sobol(
    problem: Problem,
    bounds: Mapping[str, tuple[Any, Any]],
    *,
    n: int = 1024,
    seed: int = 0,
    target: str = "omega_inf",
    most_unknown: float = 0.01,
    **settings: Any,
) -> SobolIndices:
    """Compute Sᵢ = Var E(f | xᵢ) / Var f and Tᵢ = 1 − Var E(f | all but xᵢ) / Var f in a box.

    The parameters x are independent and uniform in the box.

    Args:
        problem: a function from the parameters x, by name, to the equation and the start.
        bounds: name = (low, high) for each of the m parameters.
        n: a power of two; n (m + 2) runs are made, in one sweep.
        seed: seed of the scrambled Sobol sequence and of the bootstrap.
        target: f: "omega_inf", the signed ω∞, 0 for a stop; or "residual", 1 for residual rotation
            and 0 for a stop.
        most_unknown: largest allowed share of runs with an unknown target. If one of the m + 2
            runs of a point of the sequence is unknown, another point's runs replace all of them.
        settings: rtol, atol, max_steps, devices, engine, value, progress, store and repair, as in
            `sweep`; the default of `value` is "unchecked".

    Returns:
        A `SobolIndices`. The intervals come from a bootstrap that treats the points as random; the
        error of a Sobol sequence is smaller.

    Raises:
        ValueError: n that is not a power of two, an empty range, too many unknown runs, a
            constant f.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, by `scipy.stats.sobol_indices`.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.uncertainty import sobol
        >>> def problem(delta, phi):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.2, phi)
        >>> bounds = {"delta": (-0.4, -0.1), "phi": (0.0, 3.14)}
        >>> result = sobol(problem, bounds, n=256, target="residual")
        >>> result.runs, result.first["delta"].value > result.first["phi"].value
        (1024, True)
    """
    check_settings(settings, STORED)
    low, high = corners_of_box("bounds", bounds)
    n, seed = whole("n", n, 2, "be a power of two"), whole("seed", seed, 0)
    if n & (n - 1):
        refuse("n", "be a power of two", f"is {n!r}")
    if target not in ("omega_inf", "residual"):
        refuse("target", "be 'omega_inf' or 'residual'", f"is {target!r}")
    most_unknown = float(finite("most_unknown", most_unknown, batch=False))
    points = low + (high - low) * _saltelli_points(n, len(low), seed)
    columns = dict(zip(bounds, points.reshape(-1, len(low)).T, strict=True))
    basin = sweep(problem, Points(**columns), **{"value": UNCHECKED, **settings})
    found = basin.omega_inf if target == "omega_inf" else implied_probability(basin.outcome)
    values = found.reshape(points.shape[:2])  # NaN where unknown
    unknown = float(np.mean(np.isnan(values)))
    generator = np.random.default_rng([seed, 1])
    _replace_unknown(values, most_unknown, generator)
    first, total = _with_intervals(values, tuple(bounds), generator)
    mean, variance = float(values[:2].mean()), float(values[:2].var())
    return SobolIndices(target, first, total, mean, variance, values.size, unknown)


def _saltelli_points(n: int, m: int, seed: int) -> Float[np.ndarray, "pages n m"]:
    """Return Saltelli's matrices A, B, and A with one column of B, in the unit cube."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    both = qmc.Sobol(2 * m, seed=generator).random(n)  # pyright: ignore[reportCallIssue]
    a, b = both[:, :m], both[:, m:]
    mixed = np.where(np.eye(m, dtype=bool)[:, None], b, a)
    return np.concatenate([a[None], b[None], mixed])


def _replace_unknown(
    values: Float[np.ndarray, "pages n"], most_unknown: float, generator: np.random.Generator
) -> None:
    """Replace the runs of points with an unknown run by the runs of other, random points."""
    unknown = np.isnan(values)
    gaps = np.any(unknown, axis=0)
    if np.mean(unknown) > most_unknown or gaps.all():
        must = "be at least the share of runs whose target is not known"
        was = f"that share is {np.mean(unknown):.3g} (raise `max_steps`?)"
        refuse("most_unknown", must, was)
    values[:, gaps] = values[:, generator.choice(np.flatnonzero(~gaps), int(gaps.sum()))]


def _with_intervals(
    values: Float[np.ndarray, "pages n"], names: tuple[str, ...], generator: np.random.Generator
) -> list[dict[str, Index]]:
    """Return first-order and total indices, each with its percentile interval, by name."""
    n = values.shape[1]
    if np.ptp(values[:2]) == 0:
        refuse("bounds", "make the target vary", f"it is {values[0, 0]:g} everywhere")
    samples = (values[:, None, generator.integers(n, size=n)] for _ in range(RESAMPLES))
    low, high = np.percentile([_indices(sample) for sample in samples], (2.5, 97.5), axis=0)
    numbers = np.stack([_indices(values[:, None]), low, high], axis=-1).tolist()
    return [{name: Index(*row) for name, row in zip(names, rows, strict=True)} for rows in numbers]


def _indices(f: Float[np.ndarray, "pages 1 n"]) -> Float[np.ndarray, "2 m"]:
    """Return first-order and total indices."""
    from scipy.stats import sobol_indices

    m = len(f) - 2
    pages = f[2:] if m > 1 else np.repeat(f[2:], 2, axis=0)  # SciPy squeezes a single one
    indices = sobol_indices(func={"f_A": f[0], "f_B": f[1], "f_AB": pages}, n=f.shape[-1])
    return np.reshape([indices.first_order, indices.total_order], (2, -1))[:, :m]
