"""Costs of derivatives of ω∞ relative to the values alone, and their errors in sweeps.

They come from first variations, in the lanes of a sweep or for one start through JAX.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks.problems import mixed_basin
from benchmarks.problems.families import TRUTH, top
from benchmarks.reporting import measure
from benchmarks.speed.outcomes import RTOL

NAMES = ("delta", "w3", "w1")  # a sweep differentiates by the first, the first two, all
POINT = np.asarray(-0.2), np.asarray(dt.cylindrical(0.2, 0.15, 0.1))  # δ and ω₀ of a single start
CALLS = 20  # of a program for one start, timed together
HIGHER = ("order-2", "order-3", "order-4")
SMALLER = 0.25  # factor of the amplitudes at these levels, which run away at larger ones
TWICE = ("order-1", "semi")  # levels of the second derivatives, which take long to compile
Row = dict[str, Any]


def in_sweeps(small: bool) -> list[Row]:
    """The mixed basin with residual values, without and with derivatives."""
    rows, most = np.column_stack(mixed_basin.sample(64 if small else 32768)), 1 if small else 3
    table = []
    for level in ("order-1",) if small else ("order-1", "semi", *HIGHER):
        at = rows * ([1] + 3 * [SMALLER]) if level in HIGHER else rows
        precise = top(level).sweep(at, TRUTH, derivatives=NAMES[:most])
        # JAX takes long to compile orders 3 and 4.
        for engine in ("native",) if small or level in HIGHER[1:] else ("native", "jax"):
            table += _with_and_without(level, at, engine, precise, most, 1 if small else 5)
    return table


def _with_and_without(
    level: str, rows: np.ndarray, engine: str, precise: dt.Basin, most: int, repeats: int
) -> list[Row]:
    """A row for each number of derivatives, 0 first."""

    def case(m: int) -> Callable[[], Row]:
        settings = {"engine": engine, "max_steps": mixed_basin.MAX_STEPS, "derivatives": NAMES[:m]}
        settings["slow_flow"] = False  # derivatives are never predicted, so nor are values here
        sweep = partial(top(level).sweep, rows, RTOL, **settings)
        _, first = measure.timed(sweep)

        def call() -> Row:
            basin, clocks = measure.timed(sweep)
            return clocks | {"basin": basin, "first": first["seconds"]}

        return call

    records = measure.interleaved({m: case(m) for m in range(most + 1)}, repeats)
    plain, base = records[0][0]["basin"], measure.summary(records[0])
    table = []
    for m, runs in records.items():
        basin, costs = runs[0]["basin"], measure.summary(runs)
        over = {clock: costs[clock]["median"] / base[clock]["median"] for clock in measure.CLOCKS}
        steps = basin.steps.sum() / plain.steps.sum()
        decided = (basin.outcome > 0) & (plain.outcome > 0)
        table.append(
            costs
            | {"level": level, "engine": engine, "derivatives": m, "starts": len(rows)}
            | {"first_seconds": runs[0]["first"], "over_plain": over}
            | {"steps": float(basin.steps.mean())}
            | {"step_over_plain": over["processor_seconds"] / steps}
            | {"undecided": int(np.sum(basin.outcome == 0))}
            | {"differ": int(np.sum(decided & (basin.outcome != plain.outcome)))}
            | _errors(basin, precise, plain, NAMES[:m])
        )
    return table


def _errors(basin: dt.Basin, precise: dt.Basin, plain: dt.Basin, by: tuple[str, ...]) -> Row:
    """Relative errors of the derivatives (none: of ω∞) at residual starts; starts without."""
    residual = plain.outcome == dt.Outcome.RESIDUAL

    def found(of: dt.Basin) -> Float[np.ndarray, "n m"]:
        columns = [of.derivative(name) for name in by] or [of.omega_inf]
        return np.stack(columns, axis=-1)[residual]

    values, exact = found(basin), found(precise)
    known = np.isfinite(values) & np.isfinite(exact) & (exact != 0)
    off = np.abs(values[known] / exact[known] - 1)
    return {
        "median_error": float(np.median(off)),
        "high_error": float(np.quantile(off, 0.99)),
        "missing": int(np.sum(~np.isfinite(values).all(axis=1))),
    }


def of_one_start(level: str, small: bool) -> list[Row]:
    """ω∞ of one start and its derivatives by δ and ω₀, jitted, at rtol 1e-10."""

    def value(delta: Any, omega: Any) -> Any:
        return dt.residual_rotation(dt.equation_at(level, delta), omega)

    functions: Row = {"ω∞": value, "by δ": jax.grad(value)}
    if not small:
        functions["by δ and ω₀"] = jax.grad(value, (0, 1))
        if level in TWICE:
            functions["twice by δ and ω₀"] = jax.hessian(value, (0, 1))
    cases, compilation = {}, {}
    for name, function in functions.items():
        lowered = jax.jit(function).lower(*POINT)
        program, clocks = measure.timed(lowered.compile)
        cases[name], compilation[name] = partial(_called, program), clocks["seconds"]
    measure.interleaved(cases, 1)
    rows: list[Row] = []
    for name, runs in measure.interleaved(cases, 1 if small else 5).items():
        row = measure.summary(runs) | {"of": level, "name": name, "starts": 1}
        plain = (rows or [row])[0]["processor_seconds"]["median"]
        row |= {"over_plain": row["processor_seconds"]["median"] / plain}
        rows.append(row | {"compile_seconds": compilation[name]})
    return rows


def _called(program: Callable[..., Any]) -> Row:
    """The clocks of one of `CALLS` calls."""

    def calls() -> None:
        for _ in range(CALLS):
            jax.block_until_ready(program(*POINT))

    return {clock: spent / CALLS for clock, spent in measure.timed(calls)[1].items()}


def compare(small: bool) -> Row:
    """All scenes."""
    levels = ("order-1",) if small else ("order-1", "order-2", "semi", "full")
    return {
        "rtol": RTOL,
        "sweeps": in_sweeps(small),
        "single": [row for level in levels for row in of_one_start(level, small)],
    }
