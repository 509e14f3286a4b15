"""Derivatives of motions, balance terms, decay times and ω∞, held to differences at random starts.

Along a random change of everything that a problem depends on: first ones, forwards and backwards
(the worse of the two is told), and second ones.

python benchmarks/bench_directions.py --write     kept: README.md, results/
"""

import argparse
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
import measure
import report
from differences import CERTAIN, STEPS, chosen_steps, differences, largest
from dipoletop.radiation import schott_energy
from families import COSTLY, FRACTION, NAMES, TRUTH, Family, made
from tables import Table, layout

RTOLS = (1e-10, 1e-12)  # of the derivatives; the first is what functions of one start take
UNTIL = 20.0  # τ of the end states
SHARE = 0.5  # of the energy to be lost
SMALLEST, LARGEST = 0.1, 0.3  # |ω₀|: what does not take long, and where all levels hold
PATIENCE = 1000.0  # τ before which ω∞ and its derivatives are certain
LONG = 5  # of the steps of differences: those for starts that are not next to the boundary
FORWARDS = diffrax.ForwardMode()
ORDERS = {"first": ("value", ("forwards", "backwards")), "second": ("forwards", ("second",))}
"""What differences are taken of, and what is held to them."""

Function = Callable[..., Any]
"""Of an equation, a start, a tolerance and `adjoint`, diffrax's, to some numbers."""


class Quantity(NamedTuple):
    """What is differentiated."""

    function: Function
    parts: dict[str, slice]
    """Numbers that are compared with the largest of them."""


def motion(equation: Any, omega: Any, rtol: Any, adjoint: Any) -> Float[Any, "6"]:
    """End state, its kinetic energy and its Schott energy, and the energy radiated so far."""
    options = {} if equation.level == "full" else {"adjoint": adjoint}
    ts = jnp.array([0.0, UNTIL])
    run = dt.simulate(equation, omega, ts, rtol=rtol, balance=True, throw=False, **options)
    schott = schott_energy(equation.body, run.omega[-1], run.omega_dot[-1])
    assert run.emitted is not None
    return jnp.append(run.omega[-1], jnp.stack([run.energy[-1], schott, run.emitted[-1]]))


def decay(equation: Any, omega: Any, rtol: Any, _: Any) -> Float[Any, "1"]:
    """τ at which a share of the energy is lost."""
    return dt.decay_time(equation, omega, SHARE, rtol=rtol)[None]


def residual(equation: Any, omega: Any, rtol: Any, _: Any) -> Float[Any, "1"]:
    """ω∞."""
    return dt.residual_rotation(equation, omega, rtol=rtol)[None]


BALANCE = {"kinetic energy": slice(3, 4), "Schott energy": slice(4, 5), "radiated": slice(5, 6)}
QUANTITIES = {
    "motion": Quantity(motion, {"end state": slice(3)} | BALANCE),
    "decay": Quantity(decay, {"decay time": slice(1)}),
    "residual": Quantity(residual, {"ω∞": slice(1)}),
}
PARTS = [part for quantity in QUANTITIES.values() for part in quantity.parts]


def cases(family: Family, count: int) -> Float[np.ndarray, "n 2*k"]:
    """Residual starts at random, and a random change of each."""
    rows = family.draw(20 * count)
    sizes = np.linalg.norm(rows[:, -3:], axis=1)
    rows = rows[(sizes > SMALLEST) & (sizes < LARGEST)]
    found = family.sweep(rows, TRUTH, derivatives=family.by)
    rows = rows[(np.abs(found.omega_inf) > 0) & (found.time < PATIENCE)][:count]
    ways = np.random.default_rng(5).normal(size=rows.shape)
    ways[:, -3:] *= np.linalg.norm(rows[:, -3:], axis=1)[:, None]
    return np.hstack([rows, ways / np.max(np.abs(ways), axis=1)[:, None]])


def derivatives(family: Family, function: Function) -> dict[str, Callable[..., np.ndarray]]:
    """Of a quantity in a family, at rows that hold a problem and a change."""

    def value(x: Any, rtol: Any, adjoint: Any = FORWARDS) -> Any:
        return function(*family.problem(*x), rtol, adjoint)

    def forwards(x: Any, way: Any, rtol: Any) -> Any:
        return jax.jvp(lambda x: value(x, rtol), (x,), (way,))[1]

    def backwards(x: Any, way: Any, rtol: Any) -> Any:
        found, back = jax.vjp(lambda x: value(x, rtol, None), x)
        return jax.vmap(lambda unit: back(unit)[0])(jnp.eye(found.size)) @ way

    def second(x: Any, way: Any, rtol: Any) -> Any:
        return jax.jvp(lambda x: forwards(x, way, rtol), (x,), (way,))[1]

    def of_rows(one: Callable[[Any, Any, Any], Any]) -> Callable[..., np.ndarray]:
        # One after another: most of the time is compilation, and of batches it takes longer.
        @jax.jit
        def compiled(row: Any, rtol: Any) -> Any:
            x, way = jnp.split(row, 2)
            return one(x, way, rtol)

        return lambda rows, rtol=TRUTH: np.stack([compiled(row, rtol) for row in rows])

    def plain(x: Any, _: Any, rtol: Any) -> Any:
        return value(x, rtol)

    every = {"value": plain, "forwards": forwards, "backwards": backwards, "second": second}
    return {name: of_rows(one) for name, one in every.items()}


def held(name: str, quantity: Quantity, count: int) -> list[dict[str, Any]]:
    """Derivatives along random changes beside differences: a row for each part."""
    family, guide = made(name), made(COSTLY[name][0] if name in COSTLY else name)
    costly = name in COSTLY and quantity.function is not motion
    rows = cases(guide, count // FRACTION if costly else count)
    ways = np.roll(rows, rows.shape[1] // 2, axis=1)[:, None]
    ways[..., rows.shape[1] // 2 :] = 0
    find = derivatives(family, quantity.function)
    quick = derivatives(guide, quantity.function) if name in COSTLY else find
    lines = [{"of": name, "what": part, "starts": len(rows)} for part in quantity.parts]
    for order, (of, asked) in ORDERS.items():
        steps = chosen_steps(quick[of], rows, ways, STEPS[:LONG])
        exact, apart = (each[:, 0] for each in differences(find[of], rows, ways, steps))
        found = {rtol: [find[way](rows, rtol) for way in asked] for rtol in RTOLS}
        for line, part in zip(lines, quantity.parts.values(), strict=True):
            of_part = {rtol: [each[:, part] for each in every] for rtol, every in found.items()}
            line[order] = compared(exact[:, part], apart[:, part], of_part)
    return lines


def compared(
    exact: Float[np.ndarray, "n c"],
    apart: Float[np.ndarray, "n c"],
    found: dict[float, list[Float[np.ndarray, "n c"]]],
) -> dict[str, Any]:
    """Errors over the largest component, where the differences tell; of two ways the worse."""
    sure = largest(apart) < CERTAIN * largest(exact)
    size = largest(exact[sure])
    line = {"shown": int(np.sum(sure)), "apart": spread(largest(apart[sure]) / size)}
    for rtol, ways in found.items():
        errors = [largest((numbers - exact)[sure]) / size for numbers in ways]
        line[f"{rtol:.0e}"] = spread(np.max(errors, axis=0))
    return line


def spread(errors: Float[np.ndarray, "n"]) -> dict[str, float]:
    """Of errors; NaN where there is no derivative."""
    if errors.size == 0:
        return {"median": np.nan, "largest": np.nan}
    return {"median": float(np.median(errors)), "largest": float(np.max(errors))}


def table(rows: list[dict[str, Any]]) -> str:
    """Median and largest error."""
    names = [f"{rtol:.0e}" for rtol in RTOLS]
    found: Table = [["of", "what", "starts"]]
    for order in ORDERS:
        found[0] += [f"{order}: shown", *(f"rtol {name}" for name in names), "differences"]
    for row in rows:
        line = [row["of"], row["what"], str(row["starts"])]
        for order in ORDERS:
            errors = [row[order][name] for name in (*names, "apart")]
            line += [str(row[order]["shown"])]
            line += [f"{error['median']:.1e} / {error['largest']:.1e}" for error in errors]
        found.append(line)
    return layout(found, text=2)


def kept(rows: list[dict[str, Any]]) -> None:
    """Rows into the results, in the place of older ones of the same kind."""
    new = {(row["of"], row["what"]): row for row in [*report.kept("directions"), *rows]}
    every = [new[of, what] for of in NAMES for what in PARTS if (of, what) in new]
    runs = dict.fromkeys(row["run"] for row in every)
    report.keep("directions", f"{'; '.join(runs)}.\n\n{table(every)}", every)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=100, help="of each kind")
    parser.add_argument("--of", nargs="*", choices=NAMES, default=NAMES, help="default: all")
    whats = list(QUANTITIES)
    parser.add_argument("--what", nargs="*", choices=whats, default=whats, help="default: all")
    parser.add_argument("--write", action="store_true", help="keep the results of each kind")
    args = parser.parse_args()
    run = {"run": measure.this_run()}
    for name in args.of:
        for what in args.what:
            rows = [row | run for row in held(name, QUANTITIES[what], args.starts)]
            print(table(rows), flush=True)
            if args.write:
                kept(rows)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
