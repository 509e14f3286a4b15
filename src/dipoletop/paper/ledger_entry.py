"""One line of the ledger, and how residuals are measured."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

Values = ArrayLike | Sequence[float]

LANES = 32


class Entry(NamedTuple):
    """An equation, claim, figure or number of the paper, and what was found when it was tried.

    A residual is relative to the size of what is measured. Of a claim about cases it is the share
    of the tried cases in which the claim fails.
    """

    place: str
    """Where it stands in the paper."""
    claim: str
    """What holds: the paper's form, or the right one if the paper is corrected."""
    residual: float
    """By how much that fails, as computed just now."""
    limit: float
    """What rounding, tolerances or neglected terms allow."""
    printed: str = ""
    """What the paper prints in its place; empty if it is confirmed."""
    printed_residual: float = 0.0
    """By how much what is printed fails, measured in the same way."""

    @property
    def holds(self) -> bool:
        """Whether the claim holds, and what the paper prints in its place does not."""
        wrong = not self.printed or self.printed_residual > self.limit
        return bool(self.residual <= self.limit and wrong)

    @property
    def verdict(self) -> str:
        """Confirmed, corrected or FAILED."""
        if not self.holds:
            return "FAILED"
        return "corrected" if self.printed else "confirmed"


def gap(values: Values, expected: Values) -> float:
    """Largest difference over the largest of the expected numbers; NaN counts as infinite."""
    known = np.asarray(expected)
    worst = np.max(np.abs(np.asarray(values) - known)) / np.max(np.abs(known))
    return float(worst) if np.isfinite(worst) else np.inf


def share(failures: Iterable[ArrayLike]) -> float:
    """The share of cases in which a claim fails."""
    return float(np.mean(np.concatenate([np.ravel(np.asarray(x, bool)) for x in failures])))


def unsolved(equation: Callable, solution: Callable, times: np.ndarray) -> float:
    """How far dω/dτ of a solution (T, n) is from what an equation says, over the largest rate."""
    t = jnp.asarray(times)
    value, rate = jax.jvp(solution, (t,), (jnp.ones_like(t),))
    return gap(rate.T, equation(0.0, value.T))


def states(components: int, seed: int = 0) -> jnp.ndarray:
    """Random states, components on axis 0."""
    return jnp.asarray(np.random.default_rng(seed).normal(size=(components, LANES)))


def shapes() -> jnp.ndarray:
    """As many shapes δ, the disc, δ = −1/2 and the sphere among them."""
    others = np.random.default_rng(1).uniform(-1, 0.95, LANES - 3)
    return jnp.asarray(np.concatenate([[-1.0, -0.5, 0.0], others]))
