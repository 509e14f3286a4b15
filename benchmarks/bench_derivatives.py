"""Derivatives of ω∞ held to differences: near the boundary and far from it, at every level.

Of axisymmetric tops by δ and ω₀, of general bodies by the inertia tensor, the dipole and ω₀, as
sweeps find them; of tops also second ones, as `jax.hessian` does.

python benchmarks/bench_derivatives.py --write     kept: README.md, results/
"""

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
import measure
import problem
import report
from dipoletop._levels import LEVELS, equation
from tables import Table, layout

TRUTH = 1e-13  # relative tolerance of the values that are subtracted
RTOLS = (1e-8, 1e-10, 1e-12)  # of the derivatives
SHIFTS = np.array([-3, -2, -1, 1, 2, 3])
WEIGHTS = np.array([-1, 9, -45, 45, -9, 1]) / 60  # of the central difference of order 6
RATIO = 0.4  # of a step to the one before
STEPS = 3e-3 * RATIO ** np.arange(8)  # of it: next to the boundary short ones
LARGEST = 0.3  # |ω₀|: where all levels hold
CERTAIN = 1e-8  # differences that agree worse prove nothing
NEAREST = 400  # starts from which those are taken that are near the boundary
FAR = 0.3  # ω∞/|ω₀| of starts far from it
BODIES: dict[str, Callable[[dt.Body], Any]] = {
    "body, order 1": dt.Reduced,
    "body, semi": dt.SemiReduced,
    "body, full": dt.Full,
}
COSTLY = {"full": ("semi", ("delta", "w3")), "body, full": ("body, semi", ("i1", "d"))}
FRACTION, PATIENCE = 5, 1e4
"""Each start takes seconds: such families have the starts and steps that suit one a hundred times
faster, vary less, at a part of the starts, and only at those decided before τ = PATIENCE."""
NAMES, ORDERS = (*LEVELS, *BODIES), ("first", "second")

Function = Callable[[np.ndarray], np.ndarray]
"""Of rows, to a row of values for each."""


class Family(NamedTuple):
    """Problems of one kind: each is a row of numbers."""

    name: str
    problem: Callable[..., Any]
    """Its arguments, the columns, to an equation and a start."""
    columns: tuple[str, ...]
    draw: Callable[[int], np.ndarray]
    """A number of rows at random."""
    by: tuple[str, ...]
    """The columns by which it is differentiated."""
    patience: float = np.inf
    """Until which τ motions may take."""

    def sweep(self, rows: Float[np.ndarray, "n k"], rtol: float, **settings: Any) -> dt.Basin:
        """ω∞ of rows."""
        points = dt.Points(**dict(zip(self.columns, rows.T, strict=True)))
        return dt.sweep(self.problem, points, rtol=rtol, progress=False, **settings)

    def values(self, rows: np.ndarray) -> Float[np.ndarray, "n 1"]:
        """ω∞, nearly exact."""
        return self.sweep(rows, TRUTH).omega_inf[:, None]

    def slopes(self, rows: np.ndarray, rtol: float = TRUTH) -> Float[np.ndarray, "n d"]:
        """Its derivatives."""
        basin = self.sweep(rows, rtol, derivatives=self.by)
        return np.stack([basin.derivative(name) for name in self.by], axis=-1)

    @property
    def directions(self) -> Float[np.ndarray, "d k"]:
        """Which number of a row each derivative varies."""
        return np.eye(len(self.columns))[[self.columns.index(name) for name in self.by]]


def families(name: str, count: int) -> tuple[Family, Family, int]:
    """The family of that name, that by which its starts are chosen, and how many they may be."""

    def made(name: str) -> Family:
        return top(name) if name in LEVELS else body(name)

    if name not in COSTLY:
        return made(name), made(name), count
    guide, by = COSTLY[name]
    quick = made(guide)._replace(by=by, patience=PATIENCE)
    return made(name)._replace(by=by), quick, max(count // FRACTION, 1)


def top(level: str) -> Family:
    """Axisymmetric tops of the mixed basin with a transverse dipole."""

    def made(delta: Any, w1: Any, w2: Any, w3: Any) -> Any:
        return equation(level, delta), jnp.stack([w1, w2, w3])

    def draw(n: int) -> np.ndarray:
        deltas, omegas = problem.mixed_basin(n, seed=3)
        return np.column_stack([deltas, omegas])

    columns = ("delta", "w1", "w2", "w3")
    return Family(level, made, columns, draw, columns)


def body(name: str) -> Family:
    """Bodies of any moments between 0.6 and 1, the dipole along axis 1, a principal axis.

    (The dipole must lie along one, or all motions stop.)
    """

    def made(i1: Any, i2: Any, i3: Any, i23: Any, d: Any, w1: Any, w2: Any, w3: Any) -> Any:
        zero = jnp.zeros_like(i1)
        rows = [[i1, zero, zero], [zero, i2, i23], [zero, i23, i3]]
        inertia = jnp.stack([jnp.stack(row) for row in rows])
        rigid = dt.Body(inertia, jnp.stack([d, zero, zero]))
        return BODIES[name](rigid), jnp.stack([w1, w2, w3])

    def draw(n: int) -> np.ndarray:
        _, omegas = problem.mixed_basin(n, seed=4)
        low, high = np.array([[0.6, 0.6, 0.6, -0.05, 0.5], [1.0, 1.0, 1.0, 0.05, 1.0]])
        rigid = low + (high - low) * np.random.default_rng(4).random((n, 5))
        return np.column_stack([rigid, omegas])

    columns = ("i1", "i2", "i3", "i23", "d", "w1", "w2", "w3")
    return Family(name, made, columns, draw, columns)


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


def chosen_steps(
    function: Function, rows: Float[np.ndarray, "n k"], directions: Float[np.ndarray, "d k"]
) -> Float[np.ndarray, "n d"]:
    """For each row and direction the step on which three in a row agree best."""
    n, d = len(rows), len(directions)
    every = along(function, rows, directions, np.tile(STEPS[:, None, None], (1, n, d)))
    apart = np.max(np.abs(np.diff(every, axis=0)), axis=-1)
    apart = np.nan_to_num(np.maximum(apart[1:], apart[:-1]), nan=np.inf)
    return STEPS[np.argmin(apart, axis=0) + 1]


def along(
    function: Function,
    rows: Float[np.ndarray, "n k"],
    directions: Float[np.ndarray, "d k"],
    steps: Float[np.ndarray, "s n d"],
) -> Float[np.ndarray, "s n d c"]:
    """Central differences of order 6 of c functions, with steps of their own."""
    moves = SHIFTS[:, None, None, None, None] * steps[..., None] * directions
    around = rows[:, None] + moves
    found = function(around.reshape(-1, rows.shape[1])).reshape(*around.shape[:-1], -1)
    return np.tensordot(WEIGHTS, found, 1) / steps[..., None]


def differences(
    function: Function,
    rows: Float[np.ndarray, "n k"],
    directions: Float[np.ndarray, "d k"],
    steps: Float[np.ndarray, "n d"] | None = None,
) -> tuple[Float[np.ndarray, "n d c"], Float[np.ndarray, "n d c"]]:
    """Derivatives of c functions of rows, and how far two steps differ on them."""
    fine = chosen_steps(function, rows, directions) if steps is None else steps
    both = along(function, rows, directions, np.stack([fine, fine / RATIO]))
    return both[0], np.abs(both[0] - both[1])


def largest(each: np.ndarray) -> np.ndarray:
    """The largest size in each row."""
    return np.max(np.abs(each), axis=tuple(range(1, each.ndim)))


def certain(found: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The rows of which differences tell the derivatives well enough."""
    sure = np.flatnonzero(largest(found[1]) < CERTAIN * largest(found[0]))
    if sure.size == 0:
        raise SystemExit(f"Of no start differences agree to {CERTAIN:.0e}: take a larger --pool.")
    return sure


def off(found: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Errors over the largest element of each derivative."""
    error = largest(found - exact) / largest(exact)
    return {"median": float(np.median(error)), "largest": float(np.max(error))}


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
            return dt.residual_rotation(equation(level, x[0]), x[1:], rtol=rtol)

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
    path = report.HERE / "results" / "derivatives.json"
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    found = {name: old.get(name, []) for name in ORDERS}
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
    parser.add_argument("--second", nargs="*", choices=LEVELS, default=LEVELS, help="default: all")
    parser.add_argument("--write", action="store_true", help="keep the results of each family")
    args = parser.parse_args()
    machine = measure.machine()
    command = shlex.join(["python", "benchmarks/bench_derivatives.py", *sys.argv[1:]])
    run = {"run": f"`{command}`, {machine['date']}, {machine['cores']} cores"}
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
