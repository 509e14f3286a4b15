"""Derivatives of motions, balance terms, decay times and ω∞ against differences, at random starts.

Derivatives are along a random change of all parameters of a problem: first ones in forward and
reverse mode (the larger error of the two is kept), and second ones.

    python -m benchmarks.accuracy.directions --small         a look
    python -m benchmarks.accuracy.directions full --write    one family; kept beside the others
    python -m benchmarks.accuracy.directions --write         all; kept: results/directions.md
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks.accuracy.differences import STEPS, agree, chosen_steps, differences, largest, spread
from benchmarks.problems.families import COSTLY, NAMES, TRUTH, Family, family, merged
from benchmarks.reporting import pages
from dipoletop.radiation import schott_energy

RTOLS = (1e-10, 1e-12)  # of the derivatives; the first is the default for one start
UNTIL = 20.0  # τ of the end states
SHARE = 0.5  # of the energy to be lost
SMALLEST, LARGEST = 0.1, 0.3  # |ω₀|: large enough for short runs, small enough for all levels
PATIENCE = 1000.0  # largest τ at which ω∞ and its derivatives may become certain
LONG = 5  # number of step sizes for differences: the starts are not next to the boundary
FORWARDS = diffrax.ForwardMode()
ORDERS = {"first": ("value", ("forwards", "backwards")), "second": ("forwards", ("second",))}
"""The function whose differences are taken, and the derivatives that are compared with them."""

Function = Callable[..., Any]
"""A function from an equation, a start, a tolerance and diffrax's `adjoint` to some numbers."""


class Quantity(NamedTuple):
    """A function to differentiate, and the parts of its result."""

    function: Function
    parts: dict[str, slice]
    """Groups of numbers whose errors are relative to the largest of them."""


def motion(equation: Any, omega: Any, rtol: Any, adjoint: Any) -> Float[Any, "6"]:
    """Return the end state, its kinetic and Schott energies, and the energy radiated so far."""
    options = {} if equation.level == "full" else {"adjoint": adjoint}
    ts = jnp.array([0.0, UNTIL])
    run = dt.simulate(equation, omega, ts, rtol=rtol, balance=True, throw=False, **options)
    schott = schott_energy(equation.body, run.omega[-1], run.omega_dot[-1])
    assert run.emitted is not None
    return jnp.append(run.omega[-1], jnp.stack([run.energy[-1], schott, run.emitted[-1]]))


def decay(equation: Any, omega: Any, rtol: Any, _: Any) -> Float[Any, "1"]:
    """Return τ at which a share of the energy is lost."""
    return dt.decay_time(equation, omega, SHARE, rtol=rtol)[None]


def residual(equation: Any, omega: Any, rtol: Any, _: Any) -> Float[Any, "1"]:
    """Return ω∞."""
    return dt.residual_rotation(equation, omega, rtol=rtol)[None]


BALANCE = {"kinetic energy": slice(3, 4), "Schott energy": slice(4, 5), "radiated": slice(5, 6)}
QUANTITIES = {
    "motion": Quantity(motion, {"end state": slice(3)} | BALANCE),
    "decay": Quantity(decay, {"decay time": slice(1)}),
    "residual": Quantity(residual, {"ω∞": slice(1)}),
}


def cases(drawn_from: Family, count: int) -> Float[np.ndarray, "n 2*k"]:
    """Return random residual starts with a random change of each."""
    rows = drawn_from.draw(20 * count)
    sizes = np.linalg.norm(rows[:, -3:], axis=1)
    rows = rows[(sizes > SMALLEST) & (sizes < LARGEST)]
    basin = drawn_from.sweep(rows, TRUTH, derivatives=drawn_from.by)
    rows = rows[(np.abs(basin.omega_inf) > 0) & (basin.time < PATIENCE)][:count]
    ways = np.random.default_rng(5).normal(size=rows.shape)
    ways[:, -3:] *= np.linalg.norm(rows[:, -3:], axis=1)[:, None]
    return np.hstack([rows, ways / np.max(np.abs(ways), axis=1)[:, None]])


def derivatives(of: Family, function: Function) -> dict[str, Callable[..., np.ndarray]]:
    """Return functions for the value and its derivatives, of rows with a problem and a change."""

    def value(x: Any, rtol: Any, adjoint: Any = FORWARDS) -> Any:
        return function(*of.problem(*x), rtol, adjoint)

    def forwards(x: Any, way: Any, rtol: Any) -> Any:
        return jax.jvp(lambda x: value(x, rtol), (x,), (way,))[1]

    def backwards(x: Any, way: Any, rtol: Any) -> Any:
        result, back = jax.vjp(lambda x: value(x, rtol, None), x)
        return jax.vmap(lambda unit: back(unit)[0])(jnp.eye(result.size)) @ way

    def second(x: Any, way: Any, rtol: Any) -> Any:
        return jax.jvp(lambda x: forwards(x, way, rtol), (x,), (way,))[1]

    def of_rows(of_one: Callable[[Any, Any, Any], Any]) -> Callable[..., np.ndarray]:
        # Rows are done in sequence: compilation, most of the time, takes longer for batches.
        @jax.jit
        def compiled(row: Any, rtol: Any) -> Any:
            x, way = jnp.split(row, 2)
            return of_one(x, way, rtol)

        return lambda rows, rtol=TRUTH: np.stack([compiled(row, rtol) for row in rows])

    def plain(x: Any, _: Any, rtol: Any) -> Any:
        return value(x, rtol)

    every = {"value": plain, "forwards": forwards, "backwards": backwards, "second": second}
    return {name: of_rows(of_one) for name, of_one in every.items()}


def errors(name: str, quantity: Quantity, count: int) -> list[dict[str, Any]]:
    """Return errors of derivatives along random changes: a row for each part of the quantity."""
    asked = family(name)
    guide = family(COSTLY[name][0] if name in COSTLY else name)
    rows = cases(guide, count)
    ways = np.roll(rows, rows.shape[1] // 2, axis=1)[:, None]
    ways[..., rows.shape[1] // 2 :] = 0
    find = derivatives(asked, quantity.function)
    quick = derivatives(guide, quantity.function) if name in COSTLY else find
    lines = [{"of": name, "what": part, "starts": len(rows)} for part in quantity.parts]
    for order, (of, compared_ways) in ORDERS.items():
        steps = chosen_steps(quick[of], rows, ways, STEPS[:LONG])
        exact, apart = (each[:, 0] for each in differences(find[of], rows, ways, steps))
        results = {rtol: [find[way](rows, rtol) for way in compared_ways] for rtol in RTOLS}
        for line, part in zip(lines, quantity.parts.values(), strict=True):
            of_part = {rtol: [each[:, part] for each in every] for rtol, every in results.items()}
            line[order] = compared(exact[:, part], apart[:, part], of_part)
    return lines


def compared(
    exact: Float[np.ndarray, "n c"],
    apart: Float[np.ndarray, "n c"],
    results: dict[float, list[Float[np.ndarray, "n c"]]],
) -> dict[str, Any]:
    """Return errors over the largest component, where differences agree; the larger of two ways."""
    sure = agree(exact, apart)
    size = largest(exact[sure])
    line = {"shown": int(np.sum(sure)), "apart": spread(largest(apart[sure]) / size)}
    for rtol, ways in results.items():
        sizes = [largest((numbers - exact)[sure]) / size for numbers in ways]
        line[f"{rtol:.0e}"] = spread(np.max(sizes, axis=0))
    return line


def measured(small: bool, names: list[str]) -> list[dict[str, Any]]:
    """The families of these names, by default all, beside the others that were kept."""
    whats, found = [QUANTITIES["motion"]] if small else list(QUANTITIES.values()), []
    for name in names or (["semi"] if small else NAMES):
        for quantity in whats:
            found += errors(name, quantity, 10 if small else 100)
    return merged([] if small else pages.read("directions"), found)


if __name__ == "__main__":
    pages.command("directions", measured, names=NAMES)
