"""What uncertain parameters make of a fate: a covariance or ranges, carried to ω∞ and the outcome.

All runs of a question go into one sweep.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._base.checks import finite, refuse
from ._base.tolerances import whole
from ._base.types import Outcome
from ._maps.basin import Basin, Share, wilson
from ._maps.grids import Points, Sample
from ._maps.problems import Problem
from ._maps.sweep import sweep
from ._runs.classification import UNCHECKED
from .boundary.crossings import UNDECIDED, fate


class Estimate(NamedTuple):
    """A number from a random sample, with its standard error."""

    value: float
    error: float


class Index(NamedTuple):
    """A share of the variance, with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Propagation:
    """What a covariance of the parameters means for ω∞ and for the outcome.

    Attributes:
        omega_inf: ω∞ at the mean; 0 for a stop, NaN where it is not known.
        gradient: g = ∂ω∞/∂x at the mean, by name.
        linear_std: √(gᵀCg), the standard deviation of ω∞ to first order.
        shares: probability of every outcome that occurs, with 95 % intervals (Wilson).
        other: probability of another fate than that of the mean: another outcome, ω∞ of the
            other sign, another kind of stop. One that is not known is another.
        mean: mean of the signed ω∞ of the draws that end RESIDUAL; NaN if none does.
        std: their standard deviation; NaN for fewer than two.
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
        """Whether `linear_std` may be used: it is known, and no draw has another fate."""
        return bool(np.isfinite(self.linear_std)) and self.other.count == 0


@dataclass(frozen=True)
class SobolIndices:
    """Which parameter, alone or with others, makes the variance of a fate.

    Attributes:
        target: what varies: "omega_inf" or "residual".
        first: S = Var E(f | x) / Var f, by name.
        total: T = 1 − Var E(f | all but x) / Var f, by name.
        mean: E f.
        variance: Var f.
        runs: how many.
        unknown: share of them whose target is not known (UNDECIDED, FAILED).
    """

    target: str
    first: dict[str, Index]
    total: dict[str, Index]
    mean: float
    variance: float
    runs: int
    unknown: float


def propagate(
    problem: Problem,
    mean: Mapping[str, Any],
    covariance: Any,
    *,
    n: Any = 4096,
    seed: Any = 0,
    **options: Any,
) -> Propagation:
    """Var ω∞ ≈ gᵀCg with g = ∂ω∞/∂x, and the same without that approximation from random draws.

    Args:
        problem: a function of the parameters x, by name, that gives the equation and the start.
        mean: name = value of x.
        covariance: C, shape (m, m), in the order of `mean`; it may be singular.
        n: how many draws x ~ N(mean, C); one that the problem cannot take is FAILED.
        seed: of the draws; the i-th depends on (seed, i) only.
        options: passed to `sweep`; a statistic needs no estimate of the error of each ω∞, so
            `value` is "unchecked" if it is not given.

    Returns:
        A `Propagation`. Near a basin boundary, where draws have several fates, ω∞ is no linear
        function of x, and `trusted` is False.

    Raises:
        ValueError: a mean that is not finite, a matrix that is no covariance, bad options.

    Source: the first order of the law of propagation of uncertainty (GUM, JCGM 100), and its
        Monte Carlo supplement (JCGM 101).

    Example:
        >>> import numpy as np, dipoletop as dt
        >>> from dipoletop.uncertainty import propagate
        >>> def problem(delta, phi):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.2, phi)
        >>> mean = {"delta": -0.2, "phi": np.pi / 30}  # figure 2a
        >>> found = propagate(problem, mean, np.diag([1e-6, 1e-6]), n=256)
        >>> found.trusted, bool(abs(found.std.value / found.linear_std - 1) < 0.2)
        (True, True)
    """
    means = numbers("mean", mean)
    names = tuple(means)
    root = _root(covariance, len(names))
    centre = jnp.asarray(list(means.values()))

    def draw(key: Array) -> dict[str, Array]:
        point = centre + root @ jax.random.normal(key, centre.shape, float)
        return dict(zip(names, point, strict=True))

    one = sweep(problem, Points(**means), derivatives=names, **options)
    gradient = np.array([one.derivative(name)[0] for name in names])
    many = sweep(problem, Sample(n=n, seed=seed, draw=draw), **{"value": UNCHECKED, **options})
    with np.errstate(invalid="ignore"):  # infinity times 0, which is said by NaN
        linear = np.linalg.norm(gradient @ np.asarray(root))
    values = many.omega_inf[many.outcome == Outcome.RESIDUAL]
    mean_found, std_found = _moments(values[np.isfinite(values)])
    return Propagation(
        float(one.omega_inf[0]),
        dict(zip(names, gradient.tolist(), strict=True)),
        float(linear),
        many.fractions(),
        _share((fate(many) != fate(one)) | (fate(one) <= UNDECIDED)),
        mean_found,
        std_found,
    )


def numbers(name: str, values: Any) -> dict[str, float]:
    """A dict of finite numbers, at least one."""
    if not isinstance(values, Mapping) or not values:
        refuse(name, "be a dict of named numbers", f"is {values!r}")
    return {
        key: float(finite(f"{name}[{key!r}]", value, batch=False)) for key, value in values.items()
    }


def box(name: str, ranges: Any) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """The lower and the upper corner of a dict of pairs (low, high)."""
    if not isinstance(ranges, Mapping) or not ranges:
        refuse(name, "be a dict of pairs (low, high)", f"is {ranges!r}")
    pairs = []
    for key, pair in ranges.items():
        low, high = np.asarray(finite(f"{name}[{key!r}]", pair, (2,), batch=False))
        if not low < high:
            refuse(f"{name}[{key!r}]", "be a pair low < high", f"is {pair}")
        pairs.append((low, high))
    low, high = np.array(pairs).T
    return low, high


def _root(covariance: Any, m: int) -> Float[Array, "m m"]:
    """R with RRᵀ = C."""
    matrix = np.asarray(finite("covariance", covariance, (m, m), batch=False))
    # In units of the standard deviations, so that no parameter's own unit counts.
    units = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
    values, vectors = np.linalg.eigh(matrix / np.outer(units, units))
    must, least = "be symmetric without a negative eigenvalue", -1e-12 * m
    if np.max(np.abs(matrix - matrix.T) / np.outer(units, units)) > 1e-10:
        refuse("covariance", must, "is not symmetric")
    if np.min(values) < least:
        refuse("covariance", must, "has one")
    return jnp.asarray(units[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _moments(values: Float[np.ndarray, "n"]) -> tuple[Estimate, Estimate]:
    """Mean and standard deviation; var s² = (μ₄ − s⁴)/n for any distribution, n large."""
    n = len(values)
    if n < 2:
        return Estimate(float(values.sum()) if n else np.nan, np.nan), Estimate(np.nan, np.nan)
    centred = values - values.mean()
    variance = float(np.sum(centred**2) / (n - 1))
    spread = max(float(np.mean(centred**4)) - variance**2, 0.0)
    std = np.sqrt(variance)
    error = np.sqrt(spread / n) / (2 * std) if std > 0 else 0.0
    return (
        Estimate(float(values.mean()), float(std / np.sqrt(n))),
        Estimate(float(std), float(error)),
    )


def _share(hits: Bool[np.ndarray, "n"]) -> Share:
    count, n = hits.sum(), len(hits)
    low, high = wilson(count[None], n)
    return Share(float(count / n), float(low[0]), float(high[0]), int(count))


def sobol(
    problem: Problem,
    ranges: Mapping[str, tuple[Any, Any]],
    *,
    n: Any = 1024,
    seed: Any = 0,
    target: str = "omega_inf",
    most_unknown: float = 0.01,
    **options: Any,
) -> SobolIndices:
    """Sᵢ = Var E(f | xᵢ) / Var f and Tᵢ = 1 − Var E(f | all but xᵢ) / Var f, x uniform in a box.

    Args:
        problem: a function of the parameters x, by name, that gives the equation and the start.
        ranges: name = (low, high) of each of the m parameters, which vary independently.
        n: a power of two; n (m + 2) runs are made, in one sweep.
        seed: of the scrambled Sobol sequence and of the bootstrap.
        target: f: "omega_inf", the signed ω∞, 0 for a stop; or "residual", 1 for residual rotation
            and 0 for a stop.
        most_unknown: largest share of runs whose target is not known. A row of the m + 2 runs of
            one point of the sequence that holds such a run is replaced by another row.
        options: passed to `sweep`; a statistic needs no estimate of the error of each ω∞, so
            `value` is "unchecked" if it is not given.

    Returns:
        A `SobolIndices`. The intervals come from a bootstrap over rows, as if they were random:
        those of a Sobol sequence are closer to the truth than that.

    Raises:
        ValueError: n that is no power of two, an empty range, too many unknown runs, a target
            that is the same everywhere.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, by `scipy.stats.sobol_indices`.

    Example:
        >>> import dipoletop as dt
        >>> from dipoletop.uncertainty import sobol
        >>> def problem(delta, phi):
        ...     return dt.TransverseReduced(delta), dt.cylindrical(0.2, 0.2, phi)
        >>> ranges = {"delta": (-0.4, -0.1), "phi": (0.0, 3.14)}
        >>> found = sobol(problem, ranges, n=256, target="residual")
        >>> found.runs, found.first["delta"].value > found.first["phi"].value
        (1024, True)
    """
    low, high = box("ranges", ranges)
    names, m = tuple(ranges), len(ranges)
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 2 or n & (n - 1):
        refuse("n", "be a power of two", f"is {n!r}")
    if target not in ("omega_inf", "residual"):
        refuse("target", "be 'omega_inf' or 'residual'", f"is {target!r}")
    n, seed = int(n), whole("seed", seed, 0)
    most_unknown = float(finite("most_unknown", most_unknown, batch=False))
    rows = low + (high - low) * _rows(n, m, seed)
    points = Points(**dict(zip(names, rows.reshape(-1, m).T, strict=True)))
    found = sweep(problem, points, **{"value": UNCHECKED, **options})
    values = _values(found, target).reshape(m + 2, n)
    unknown, gaps = float(np.mean(np.isnan(values))), np.any(np.isnan(values), axis=0)
    if unknown > most_unknown or gaps.all():
        must = "be at least the share of runs whose target is not known"
        refuse("most_unknown", must, f"that share is {unknown:.3g} (raise `max_steps`?)")
    generator = np.random.default_rng([seed, 1])
    values[:, gaps] = values[:, generator.choice(np.flatnonzero(~gaps), int(gaps.sum()))]
    first, total = _with_intervals(values, generator)
    return SobolIndices(
        target,
        dict(zip(names, first, strict=True)),
        dict(zip(names, total, strict=True)),
        float(values[:2].mean()),
        float(values[:2].var()),
        values.size,
        unknown,
    )


def _rows(n: int, m: int, seed: int) -> Float[np.ndarray, "pages n m"]:
    """Saltelli's matrices A, B, and A with one column of B, in the unit cube."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    both = qmc.Sobol(2 * m, seed=generator).random(n)  # pyright: ignore[reportCallIssue]
    a, b = both[:, :m], both[:, m:]
    mixed = np.where(np.eye(m, dtype=bool)[:, None], b, a)
    return np.concatenate([a[None], b[None], mixed])


def _values(basin: Basin, target: str) -> Float[np.ndarray, "n"]:
    if target == "omega_inf":
        return basin.omega_inf
    known = np.isin(basin.outcome, (Outcome.RESIDUAL, Outcome.STOP))
    return np.where(known, (basin.outcome == Outcome.RESIDUAL) * 1.0, np.nan)


def _with_intervals(
    values: Float[np.ndarray, "pages n"], generator: np.random.Generator, resamples: int = 400
) -> tuple[list[Index], list[Index]]:
    """First-order and total indices, each with its percentile interval."""
    from scipy.stats import sobol_indices

    m, n = values.shape[0] - 2, values.shape[1]
    if np.ptp(values[:2]) == 0:
        refuse("ranges", "make the target vary", f"it is {values[0, 0]:g} everywhere")

    def indices(rows: Any) -> Float[np.ndarray, "2 m"]:
        f = values[:, None, rows]
        pages = f[2:] if m > 1 else np.repeat(f[2:], 2, axis=0)  # SciPy squeezes a single one
        found = sobol_indices(func={"f_A": f[0], "f_B": f[1], "f_AB": pages}, n=n)
        return np.reshape([found.first_order, found.total_order], (2, -1))[:, :m]

    found = indices(slice(None))
    again = [indices(generator.integers(n, size=n)) for _ in range(resamples)]
    low, high = np.percentile(again, (2.5, 97.5), axis=0)
    first, total = (
        [Index(*map(float, row)) for row in zip(found[k], low[k], high[k], strict=True)]
        for k in (0, 1)
    )
    return first, total
