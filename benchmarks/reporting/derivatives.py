"""Are the derivatives of ω∞ right? First and second ones against differences.

Numbers: [derivatives.json](derivatives.json). Command:

    python -m benchmarks.accuracy.derivatives --first semi --second      a look
    python -m benchmarks.accuracy.derivatives --write                    each family kept here

Derivatives are compared with central differences of order 6 of the derivative one order lower,
from sweeps at rtol 1e-13: first ones, by `sweep(…, derivatives=…)`, of tops with a transverse
dipole and of general bodies; second ones, by `jax.hessian` of `residual_rotation`. Starts are
random with |ω₀| in 0.05 … 0.3, δ and directions as in the mixed basin; bodies have moments in 0.6
… 1, a dipole along a principal axis (or all motions stop), and a product of inertia I₂₃ across
it.

- **far**: |ω∞| > 0.3 |ω₀|. **near**: the residual starts nearest to the boundary. **distance**: to
  the boundary by Newton's estimate ω∞/|∇ω∞|, the median.
- At the **full** level each start takes seconds, near the boundary minutes: starts and steps of the
  differences are chosen at the semi-reduced level, where motions must be decided before τ = 1e4.
- Errors are over the largest component of each derivative.
- **differences**: of three step sizes (each 0.4 of the one before) the two differences that agree
  best; their distance exceeds the error of the middle one. Where they agree to no more than 1e-8,
  above all next to the boundary, they prove nothing, and the start is **skipped**.

Some families compile for many minutes. It takes half as long with the `XLA_FLAGS` that
`python tests/quick.py` prints, which were used here for second derivatives at order 4 and the full
level, and for general bodies at the full level.
"""

from typing import Any

from benchmarks.reporting.tables import Table, bullets, layout

ORDERS = ("first", "second")


def body(results: dict[str, Any]) -> str:
    """A table for each order, and the commands that they came from."""
    parts = []
    for order in ORDERS:
        if results[order]:
            parts += [f"{order.capitalize()} derivatives:", table(results[order])]
    runs = dict.fromkeys(row["run"] for order in ORDERS for row in results[order])
    return "\n\n".join([*parts, bullets(runs)])


def table(rows: list[dict[str, Any]]) -> str:
    """Median and largest error."""
    names = [f"rtol {rtol}" for rtol in rows[0]["off"]] + ["differences"]
    lines: Table = [["of", "by", "", "starts", "skipped", "distance"]]
    lines[0] += [f"{name}: median / largest" for name in names]
    for row in rows:
        every = [*row["off"].values(), row["apart"]]
        errors = [f"{error['median']:.1e} / {error['largest']:.1e}" for error in every]
        about = [row["of"], ", ".join(row["by"]), row["place"]]
        counts = [str(row["starts"]), str(row["skipped"]), f"{row['distance']:.1e}"]
        lines.append([*about, *counts, *errors])
    return layout(lines, text=3)
