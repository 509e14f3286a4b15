"""Derivatives of ω∞ held to differences: near the boundary and far from it, at every level.

Of axisymmetric tops by δ and ω₀, of general bodies by the inertia tensor, the dipole and ω₀, as
sweeps find them; of tops also second ones, as `jax.hessian` does.

python benchmarks/bench_derivatives.py --write     kept: README.md, results/
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
import measure
import report
from differences import Function, certain, chosen_steps, differences, off
from dipoletop import Level, equation_at
from families import NAMES, TRUTH, Family, families
from tables import Table, layout

RTOLS = (1e-8, 1e-10, 1e-12)  # of the derivatives
LARGEST = 0.3  # |ω₀|: where all levels hold
NEAREST = 400  # starts from which those are taken that are near the boundary
FAR = 0.3  # ω∞/|ω₀| of starts far from it
ORDERS = ("first", "second")


def drawn(guide: Family, count: int, pool: int) -> dict[str, np.ndarray]:
    """Rows at random, residual ones: by their distance from the boundary, and with ω∞ beyond `FAR`.

    The distance is as Newton's method has it, ω∞/|∇ω∞|.
    """
    rows = guide.draw(pool)
    sizes = np.linalg.norm(rows[:, -3:], axis=1)
    rows, sizes = rows[sizes < LARGEST], sizes[sizes < LARGEST]
    found = guide.sweep(rows, TRUTH)
    values, soon = np.abs(found.omega_inf), found.time < guide.patience
    slopes = np.linalg.norm(guide.slopes(rows, RTOLS[0]), axis=1)
    residual = (values > 0) & (slopes > 0) & soon
    near = np.argsort(values[residual] / slopes[residual])[:NEAREST]
    return {"near": rows[residual][near], "far": rows[(values > FAR * sizes) & soon][:count]}


def first(name: str, count: int, pool: int) -> list[dict[str, Any]]:
    """First derivatives, of sweeps."""
    asked, guide, count = families(name, count)
    return compared(asked, guide, (asked.slopes, asked.values, guide.values), count, pool)


def second(level: str, count: int, pool: int) -> list[dict[str, Any]]:
    """Second derivatives, of `residual_rotation`."""
    asked, guide, count = families(level, count)
    directions = jnp.asarray(asked.directions)

    @jax.jit
    def hessian(row: Any, rtol: Any) -> Any:
        def value(moves: Any) -> Any:
            x = row + moves @ directions
            return dt.residual_rotation(equation_at(level, x[0]), x[1:], rtol=rtol)

        return jax.hessian(value)(jnp.zeros(len(directions)))

    def found(rows: np.ndarray, rtol: float) -> np.ndarray:
        return np.array([hessian(jnp.asarray(row), jnp.asarray(rtol)) for row in rows])

    return compared(asked, guide, (found, asked.slopes, guide.slopes), count, pool)


def compared(
    asked: Family, guide: Family, functions: tuple[Any, Function, Function], count: int, pool: int
) -> list[dict[str, Any]]:
    """What is found at rows for each tolerance beside differences.

    Functions: what finds the derivatives, what they are of, and what this is in the guide.
    """
    finds, function, guiding = functions
    ways, lines = asked.directions, []
    for place, rows in drawn(guide, count, pool).items():
        steps = chosen_steps(guiding, rows, ways)
        clear = certain(differences(guiding, rows, ways, steps))[:count]
        exact, apart = differences(function, rows[clear], ways, steps[clear])
        sure = certain((exact, apart))
        rows, exact, apart = rows[clear[sure]], exact[sure], apart[sure]
        skipped = int(clear[-1]) + 1 - len(rows)
        exact = exact.reshape(len(rows), *[len(ways)] * (1 if exact.shape[-1] == 1 else 2))
        distance = np.abs(guide.values(rows)[:, 0]) / np.linalg.norm(guide.slopes(rows), axis=1)
        lines.append(
            {"of": asked.name, "by": asked.by, "place": place, "starts": len(rows)}
            | {"skipped": skipped, "distance": float(np.median(distance))}
            | {"apart": off(exact + apart.reshape(exact.shape), exact)}
            | {"off": {f"{rtol:.0e}": off(finds(rows, rtol), exact) for rtol in RTOLS}}
        )
    return lines


def table(rows: list[dict[str, Any]]) -> str:
    """Median and largest error."""
    names = [f"rtol {rtol}" for rtol in rows[0]["off"]] + ["differences"]
    found: Table = [["of", "by", "", "starts", "skipped", "distance"]]
    found[0] += [f"{name}: median / largest" for name in names]
    for row in rows:
        every = [*row["off"].values(), row["apart"]]
        errors = [f"{error['median']:.1e} / {error['largest']:.1e}" for error in every]
        about = [row["of"], ", ".join(row["by"]), row["place"]]
        counts = [str(row["starts"]), str(row["skipped"]), f"{row['distance']:.1e}"]
        found.append([*about, *counts, *errors])
    return layout(found, text=3)


def kept(order: str, rows: list[dict[str, Any]]) -> None:
    """Rows into the results, in the place of older ones of the same family."""
    found = {name: [] for name in ORDERS} | dict(report.kept("derivatives"))
    others = [row for row in found[order] if row["of"] != rows[0]["of"]]
    found[order] = sorted(others + rows, key=lambda row: NAMES.index(row["of"]))
    runs = dict.fromkeys(row["run"] for name in ORDERS for row in found[name])
    parts = ["; ".join(runs) + "."]
    for name in ORDERS:
        if found[name]:
            parts += [f"{name.capitalize()} derivatives:", table(found[name])]
    report.keep("derivatives", "\n\n".join(parts), found)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, default=50, help="of each kind of start")
    parser.add_argument("--pool", type=int, default=4096, help="from so many starts at random")
    parser.add_argument("--first", nargs="*", choices=NAMES, default=NAMES, help="default: all")
    parser.add_argument(
        "--second", nargs="*", choices=list(Level), default=list(Level), help="default: all"
    )
    parser.add_argument("--write", action="store_true", help="keep the results of each family")
    args = parser.parse_args()
    run = {"run": measure.this_run()}
    pieces = [("first", first, name, args.points) for name in args.first]
    pieces += [("second", second, name, max(args.points // 5, 1)) for name in args.second]
    for order, measured, name, count in pieces:
        rows = [row | run for row in measured(name, count, args.pool)]
        print(table(rows), flush=True)
        if args.write:
            kept(order, rows)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
