"""Problems to differentiate, as rows of numbers: tops and bodies at every level."""

from collections.abc import Callable
from datetime import date
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from dipoletop import Level, equation_at

TRUTH = 1e-13  # relative tolerance of the values that are subtracted
BODIES: dict[str, Callable[[dt.Body], Any]] = {
    "body, order 1": dt.Reduced,
    "body, semi": dt.SemiReduced,
    "body, full": dt.Full,
}
COSTLY = {"full": ("semi", ("delta", "w3")), "body, full": ("body, semi", ("i1", "d"))}
"""Families whose starts take seconds each. A guide, a hundred times faster, chooses their starts
and the steps of the differences, and fewer columns are varied."""
FRACTION, PATIENCE = 5, 1e4  # for `COSTLY`: a fifth of the starts, decided before this τ
NAMES = (*Level, *BODIES)


class Family(NamedTuple):
    """Problems of one kind: each is a row of numbers."""

    name: str
    problem: Callable[..., Any]
    """A function from its arguments, the columns, to an equation and a start."""
    columns: tuple[str, ...]
    draw: Callable[[int], np.ndarray]
    """A function from a number to that many random rows."""
    by: tuple[str, ...]
    """The columns by which ω∞ is differentiated."""
    patience: float = np.inf
    """The latest τ at which a motion may be decided."""

    def sweep(self, rows: Float[np.ndarray, "n k"], rtol: float, **settings: Any) -> dt.Basin:
        """Return a sweep of rows with ω∞."""
        points = dt.Points(**dict(zip(self.columns, rows.T, strict=True)))
        return dt.sweep(self.problem, points, rtol=rtol, progress=False, **settings)

    def values(self, rows: np.ndarray) -> Float[np.ndarray, "n 1"]:
        """Return ω∞ at the tolerance `TRUTH`."""
        return self.sweep(rows, TRUTH).omega_inf[:, None]

    def slopes(self, rows: np.ndarray, rtol: float = TRUTH) -> Float[np.ndarray, "n d"]:
        """Return the derivatives of ω∞."""
        basin = self.sweep(rows, rtol, derivatives=self.by)
        return np.stack([basin.derivative(name) for name in self.by], axis=-1)

    @property
    def directions(self) -> Float[np.ndarray, "d k"]:
        """The unit vector in a row along which each derivative is taken."""
        return np.eye(len(self.columns))[[self.columns.index(name) for name in self.by]]


def merged(old: list[dict[str, Any]], new: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of results, the new ones in the place of older ones of the same kind."""
    run = {"run": f"`{measure.command()}`, {date.today()}, {measure.cores()} cores"}
    kinds = [(row["of"], row["place"]) for row in [*old, *new]]
    rows = dict(zip(kinds, [*old, *(row | run for row in new)], strict=True))
    return sorted(rows.values(), key=lambda row: NAMES.index(row["of"]))


def family(name: str) -> Family:
    """Return the family with this name."""
    return top(name) if name in list(Level) else body(name)


def with_guide(name: str, count: int) -> tuple[Family, Family, int]:
    """Return the family with this name, its guide, and the number of starts."""
    if name not in COSTLY:
        return family(name), family(name), count
    guide, by = COSTLY[name]
    quick = family(guide)._replace(by=by, patience=PATIENCE)
    return family(name)._replace(by=by), quick, max(count // FRACTION, 1)


def top(level: str) -> Family:
    """Return the family of axisymmetric tops of the mixed basin with a transverse dipole."""

    def problem(delta: Any, w1: Any, w2: Any, w3: Any) -> Any:
        return equation_at(level, delta), jnp.stack([w1, w2, w3])

    def draw(n: int) -> np.ndarray:
        deltas, omegas = mixed_basin.sample(n, seed=3)
        return np.column_stack([deltas, omegas])

    columns = ("delta", "w1", "w2", "w3")
    return Family(level, problem, columns, draw, columns)


def body(name: str) -> Family:
    """Return a family of bodies with moments between 0.6 and 1, the dipole on principal axis 1.

    (With a dipole off the principal axes all motions would stop.)
    """

    def problem(i1: Any, i2: Any, i3: Any, i23: Any, d: Any, w1: Any, w2: Any, w3: Any) -> Any:
        zero = jnp.zeros_like(i1)
        rows = [[i1, zero, zero], [zero, i2, i23], [zero, i23, i3]]
        inertia = jnp.stack([jnp.stack(row) for row in rows])
        rigid = dt.Body(inertia, jnp.stack([d, zero, zero]))
        return BODIES[name](rigid), jnp.stack([w1, w2, w3])

    def draw(n: int) -> np.ndarray:
        _, omegas = mixed_basin.sample(n, seed=4)
        low, high = np.array([[0.6, 0.6, 0.6, -0.05, 0.5], [1.0, 1.0, 1.0, 0.05, 1.0]])
        rigid = low + (high - low) * np.random.default_rng(4).random((n, 5))
        return np.column_stack([rigid, omegas])

    columns = ("i1", "i2", "i3", "i23", "d", "w1", "w2", "w3")
    return Family(name, problem, columns, draw, columns)
