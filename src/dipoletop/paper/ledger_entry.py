"""One line of the ledger, the measures of residuals, and random shapes and states."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

Values = ArrayLike | Sequence[float]

LANES = 32


class Entry(NamedTuple):
    """An equation, claim, figure or number of the paper, with the result of its check.

    A residual is relative to the measured quantity. For a claim about cases it is the share of
    checked cases for which the claim fails.
    """

    place: str
    """Its place in the paper."""
    claim: str
    """The correct form: the paper's, or another one if the paper has an error."""
    residual: float
    """The residual of the claim, computed in this run."""
    limit: float
    """The largest residual that rounding, tolerances or neglected terms can explain."""
    printed: str = ""
    """The form printed in the paper, if it is wrong; else ""."""
    printed_residual: float = 0.0
    """The residual of the printed form, measured in the same way."""

    @property
    def holds(self) -> bool:
        """Whether the claim holds, and the printed form, if different, does not."""
        wrong = not self.printed or self.printed_residual > self.limit
        return bool(self.residual <= self.limit and wrong)

    @property
    def verdict(self) -> str:
        """The verdict on the paper's form: confirmed, corrected or FAILED."""
        if not self.holds:
            return "FAILED"
        return "corrected" if self.printed else "confirmed"

    def __str__(self) -> str:
        residual = f"residual {self.residual:.1e}, allowed {self.limit:.1e}"
        text = f"{self.verdict:9}  {self.place}: {self.claim}; {residual}"
        paper = f"the paper has {self.printed}; residual {self.printed_residual:.1e}"
        return f"{text}\n{'':11}{paper}" if self.printed else text


def gap(values: Values, expected: Values) -> float:
    """Return the largest difference over the largest expected number; NaN counts as infinite."""
    known = np.asarray(expected)
    worst = np.max(np.abs(np.asarray(values) - known)) / np.max(np.abs(known))
    return float(worst) if np.isfinite(worst) else np.inf


def share(failures: Iterable[ArrayLike]) -> float:
    """Return the share of cases in which a claim fails."""
    return float(np.mean(np.concatenate([np.ravel(np.asarray(x, bool)) for x in failures])))


def unsolved(equation: Callable, solution: Callable, times: np.ndarray) -> float:
    """Return the largest residual of an equation for a solution (T, n), over the largest rate."""
    t = jnp.asarray(times)
    value, rate = jax.jvp(solution, (t,), (jnp.ones_like(t),))
    return gap(rate.T, equation(0.0, value.T))


def states(components: int, seed: int = 0) -> jnp.ndarray:
    """Return `LANES` random states, components on axis 0."""
    return jnp.asarray(np.random.default_rng(seed).normal(size=(components, LANES)))


def shapes() -> jnp.ndarray:
    """Return `LANES` shapes δ, including the disc, δ = −1/2 and the sphere."""
    others = np.random.default_rng(1).uniform(-1, 0.95, LANES - 3)
    return jnp.asarray(np.concatenate([[-1.0, -0.5, 0.0], others]))
