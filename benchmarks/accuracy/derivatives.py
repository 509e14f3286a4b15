"""Derivatives of ω∞ against differences: near the boundary and far from it, at every level.

First derivatives come from sweeps: of axisymmetric tops by δ and ω₀, of general bodies by the
inertia tensor, the dipole and ω₀. Second derivatives of tops come from `jax.hessian`.

    python -m benchmarks.accuracy.derivatives --small         a look
    python -m benchmarks.accuracy.derivatives full --write    one family; kept beside the others
    python -m benchmarks.accuracy.derivatives --write         all; kept: results/derivatives.md
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks.accuracy.differences import Function, certain, chosen_steps, differences, off
from benchmarks.problems.families import NAMES, TRUTH, Family, merged, with_guide
from benchmarks.reporting import pages
from dipoletop import Level, equation_at

RTOLS = (1e-8, 1e-10, 1e-12)  # of the derivatives
LARGEST = 0.3  # |ω₀|: all levels are valid there
NEAREST = 400  # number of nearest starts from which the starts near the boundary are chosen
FAR = 0.3  # least ω∞/|ω₀| of starts far from the boundary


def drawn(guide: Family, count: int, pool: int) -> dict[str, np.ndarray]:
    """Return random residual rows: some near the boundary, and some with ω∞ beyond `FAR`.

    The distance from the boundary is Newton's estimate, ω∞/|∇ω∞|.
    """
    rows = guide.draw(pool)
    sizes = np.linalg.norm(rows[:, -3:], axis=1)
    rows, sizes = rows[sizes < LARGEST], sizes[sizes < LARGEST]
    basin = guide.sweep(rows, TRUTH)
    values, soon = np.abs(basin.omega_inf), basin.time < guide.patience
    slopes = np.linalg.norm(guide.slopes(rows, RTOLS[0]), axis=1)
    residual = (values > 0) & (slopes > 0) & soon
    near = np.argsort(values[residual] / slopes[residual])[:NEAREST]
    return {"near": rows[residual][near], "far": rows[(values > FAR * sizes) & soon][:count]}


def first(name: str, count: int, pool: int) -> list[dict[str, Any]]:
    """Compare first derivatives, from sweeps."""
    asked, guide, count = with_guide(name, count)
    return compared(asked, guide, (asked.slopes, asked.values, guide.values), count, pool)


def second(level: str, count: int, pool: int) -> list[dict[str, Any]]:
    """Compare second derivatives, from `jax.hessian` of `residual_rotation`."""
    asked, guide, count = with_guide(level, count)
    directions = jnp.asarray(asked.directions)

    @jax.jit
    def hessian(row: Any, rtol: Any) -> Any:
        def value(moves: Any) -> Any:
            x = row + moves @ directions
            return dt.residual_rotation(equation_at(level, x[0]), x[1:], rtol=rtol)

        return jax.hessian(value)(jnp.zeros(len(directions)))

    def hessians(rows: np.ndarray, rtol: float) -> np.ndarray:
        return np.array([hessian(jnp.asarray(row), jnp.asarray(rtol)) for row in rows])

    return compared(asked, guide, (hessians, asked.slopes, guide.slopes), count, pool)


def compared(
    asked: Family, guide: Family, functions: tuple[Any, Function, Function], count: int, pool: int
) -> list[dict[str, Any]]:
    """Return errors of derivatives near the boundary and far from it, at each tolerance.

    `functions`: the derivatives to check, the function that they differentiate, and the same
    function for the guide.
    """
    derivative, function, guiding = functions
    ways, lines = asked.directions, []
    for place, rows in drawn(guide, count, pool).items():
        steps = chosen_steps(guiding, rows, ways)
        clear = certain(*differences(guiding, rows, ways, steps))[:count]
        exact, apart = differences(function, rows[clear], ways, steps[clear])
        sure = certain(exact, apart)
        rows, exact, apart = rows[clear[sure]], exact[sure], apart[sure]
        skipped = int(clear[-1]) + 1 - len(rows)
        exact = exact.reshape(len(rows), *[len(ways)] * (1 if exact.shape[-1] == 1 else 2))
        distance = np.abs(guide.values(rows)[:, 0]) / np.linalg.norm(guide.slopes(rows), axis=1)
        lines.append(
            {"of": asked.name, "by": asked.by, "place": place, "starts": len(rows)}
            | {"skipped": skipped, "distance": float(np.median(distance))}
            | {"apart": off(exact + apart.reshape(exact.shape), exact)}
            | {"off": {f"{rtol:.0e}": off(derivative(rows, rtol), exact) for rtol in RTOLS}}
        )
    return lines


def measured(small: bool, names: list[str]) -> dict[str, Any]:
    """The families of these names, by default all, beside the others that were kept."""
    count, pool = (5, 512) if small else (50, 4096)
    found: dict[str, Any] = {"first": [], "second": []}
    for name in names or (["semi"] if small else NAMES):
        found["first"] += first(name, count, pool)
        if name in list(Level) and not small:
            found["second"] += second(name, max(count // 5, 1), pool)
    kept = found if small else pages.read("derivatives")
    return {order: merged(kept[order], rows) for order, rows in found.items()}


if __name__ == "__main__":
    pages.command("derivatives", measured, names=NAMES)
