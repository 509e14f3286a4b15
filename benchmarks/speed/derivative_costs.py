"""Costs of derivatives relative to the values alone, and their errors.

Derivatives of ω∞ come from the equation's first variations, in the lanes of a sweep or for one
start through JAX. They are compared with differences.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks.accuracy.differences import differences
from benchmarks.problems import mixed_basin
from benchmarks.problems.families import TRUTH, top
from benchmarks.reporting import measure
from benchmarks.speed.outcomes import RTOL

NAMES = ("delta", "w3", "w1")  # a sweep differentiates by the first, the first two, all
POINT = np.append(-0.2, dt.cylindrical(0.2, 0.15, 0.1))  # δ and ω₀ of the single start
CALLS = 20  # of a program for one start, timed together
TIME = 1000.0  # of the end states that are differentiated
HIGHER = ("order-2", "order-3", "order-4")
SMALLER = 0.25  # factor of the amplitudes at these levels, which run away at larger ones
TWICE = ("order-1", "semi")  # levels of the second derivatives, which take long to compile
LENGTHS = (0.3, 0.03, 0.003)  # |ω₀| of runs of different length, δ = 0.3
WEAK = (0.1, 0.01, 0.001)  # |d|² of bodies that rotate ever more often before they are slow
LONG = (1.3, 0.8, 1.0)  # principal moments of these bodies, |ω₀| = 1
TURNING, PATIENCE = 16, 4_000_000  # how many there are, and their steps at most
TOGETHER = 256  # starts whose end states are differentiated under one vmap
FORWARDS = diffrax.ForwardMode()
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


def _program(function: Callable[..., Any], point: tuple[Any, ...]) -> tuple[Any, float]:
    """Return the function compiled for points of this type, and the time of compilation."""
    compiled, clocks = measure.timed(lambda: jax.jit(function).lower(*point).compile())
    return compiled, clocks["seconds"]


def of_one_start(level: str, small: bool) -> list[Row]:
    """ω∞ of one start and its derivatives by δ and ω₀, jitted, at rtol 1e-10."""

    def value(delta: Any, omega: Any) -> Any:
        return dt.residual_rotation(dt.equation_at(level, delta), omega)

    family, row = top(level), POINT[None]
    point = jnp.asarray(POINT[0]), jnp.asarray(POINT[1:])
    slopes = differences(family.values, row, family.directions)[0][0, :, 0]
    cases: Row = {
        "ω∞": (value, point, family.values(row)),
        "by δ": (jax.grad(value), point, slopes[:1]),
    }
    if not small:
        cases["by δ and ω₀"] = (jax.grad(value, (0, 1)), point, slopes)
        if level in TWICE:
            second = differences(family.slopes, row, family.directions)[0][0]
            hessian = jax.hessian(lambda x: value(x[0], x[1:]))
            cases["twice by δ and ω₀"] = (hessian, (jnp.asarray(POINT),), second)
    programs = {name: _program(*case[:2]) for name, case in cases.items()}

    def called(name: str) -> Row:
        def task() -> Any:
            for _ in range(CALLS):
                result = jax.block_until_ready(programs[name][0](*cases[name][1]))
            return result

        result, clocks = measure.timed(task)
        return {clock: spent / CALLS for clock, spent in clocks.items()} | {"result": result}

    calls = {name: partial(called, name) for name in cases}
    measure.interleaved(calls, 1)
    rows: list[Row] = []
    for name, runs in measure.interleaved(calls, 1 if small else 5).items():
        leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(runs[0]["result"])]
        off = np.abs(np.concatenate(leaves) - np.ravel(cases[name][2]))
        row = measure.summary(runs) | {"of": level, "name": name, "starts": 1}
        plain = (rows or [row])[0]["processor_seconds"]["median"]
        row |= {"over_plain": row["processor_seconds"]["median"] / plain}
        row |= {"compile_seconds": programs[name][1]}
        rows.append(row | {"error": float(np.max(off) / np.max(np.abs(cases[name][2])))})
    return rows


def over_many_turns(small: bool) -> list[Row]:
    """Errors of general bodies that radiate weakly, at order 1.

    A change of the unit of time by 1/(1 + a) multiplies ω₀ and ω∞ by 1 + a and divides |d|² by it,
    so ∂ω∞/∂a = ω∞ at a = 0.
    """

    def made(a: Any, strength: Any, w1: Any, w2: Any, w3: Any) -> Any:
        dipole = jnp.stack([jnp.sqrt(strength / (1 + a)), 0 * a, 0 * a])
        rigid = dt.Body(jnp.diag(jnp.array(LONG)), dipole)
        return dt.Reduced(rigid), (1 + a) * jnp.stack([w1, w2, w3])

    way = np.random.default_rng(5).normal(size=(TURNING, 3))
    way[:, 0] = abs(way[:, 0])
    omegas = dict(zip(("w1", "w2", "w3"), way.T / np.linalg.norm(way, axis=1), strict=True))
    rows = []
    for strength in WEAK[:1] if small else WEAK:
        points = dt.Points(a=np.zeros(TURNING), strength=np.full(TURNING, strength), **omegas)
        sweep = partial(dt.sweep, made, points, max_steps=PATIENCE, progress=False)
        exact = sweep(rtol=TRUTH).omega_inf
        for rtol in (RTOL, 1e-10):
            plain, basin = sweep(rtol=rtol), sweep(rtol=rtol, derivatives=("a",))
            pairs = {"value": plain.omega_inf, "slope": basin.derivative("a")}
            off = {name: np.abs(values / exact - 1) for name, values in pairs.items()}
            errors = {name: [float(np.median(e)), float(e.max())] for name, e in off.items()}
            rows.append(
                {"strength": strength, "rtol": rtol, "starts": TURNING, "errors": errors}
                | {"steps": [float(each.steps.mean()) for each in (plain, basin)]}
            )
    return rows


def in_memory(small: bool) -> list[Row]:
    """Temporary memory of compiled gradients by δ, and the lengths of run that they can do."""
    adjoint = diffrax.RecursiveCheckpointAdjoint()
    way = POINT[1:] / np.linalg.norm(POINT[1:])
    starts = np.array([np.append(0.3, size * way) for size in LENGTHS])
    basin = top("order-1").sweep(starts, 1e-10, derivatives="delta")  # to know their steps

    def limit(delta: Any, omega: Any, max_steps: int) -> Any:
        value = dt.residual_rotation(dt.TransverseReduced(delta), omega, max_steps=max_steps)
        return value, 0

    def end(delta: Any, omega: Any, max_steps: int) -> Any:
        # As long as the run to ω∞, a few braking times.
        ts = jnp.stack([jnp.zeros(()), 5 / jnp.sum(omega**2)])
        options: Row = {"adjoint": adjoint, "throw": False, "max_steps": max_steps}
        run = dt.simulate(dt.TransverseReduced(delta), omega, ts, **options)
        return run.omega[-1, 0], run.stats["num_steps"]

    functions = {"ω∞": limit}
    if not small:
        functions["end state, `simulate`, `RecursiveCheckpointAdjoint`"] = end
    rows = []
    for name, function in functions.items():
        for budget in (1_000,) if small else (1_000, 100_000):
            gradient = jax.grad(partial(function, max_steps=budget), has_aux=True)
            points = [(jnp.asarray(row[0]), jnp.asarray(row[1:])) for row in starts]
            program, seconds = _program(gradient, points[0])
            results = [program(*point) for point in points]
            counts = basin.steps.tolist() if function is limit else [int(f[1]) for f in results]
            # A run that exceeds the budget has no derivative, or a wrong end.
            served = [n for n, f in zip(counts, results, strict=True) if np.isfinite(f[0])]
            size = program.memory_analysis().temp_size_in_bytes
            about = {"name": name, "max_steps": budget, "compile_seconds": seconds}
            rows.append(about | {"bytes": size, "steps": [n for n in served if n < budget]})
    return rows


def of_end_states(small: bool, starts: int = 1) -> list[Row]:
    """`simulate` with and without derivatives, without compilation, at rtol 1e-10."""
    point: Any = jnp.asarray(-0.2), dt.cylindrical(0.2, 0.2, 0.1)
    if starts > 1:
        point = jnp.full(starts, -0.2), jnp.asarray(mixed_basin.isotropic(starts, 0.2))

    def end(delta: Any, omega: Any, adjoint: Any = FORWARDS) -> Any:
        ts, equation = jnp.array([0.0, TIME]), dt.TransverseReduced(delta)
        return dt.simulate(equation, omega, ts, adjoint=adjoint, throw=False).omega[-1, 0]

    def tangent(delta: Any, omega: Any) -> Any:
        return jax.jvp(lambda d: end(d, omega), (delta,), (jnp.ones_like(delta),))

    functions: Row = {"end state": lambda delta, omega: (end(delta, omega),)}
    functions["and its derivative by δ, forwards"] = tangent
    if not small:
        reverse = partial(end, adjoint=diffrax.RecursiveCheckpointAdjoint())
        functions["and all four, backwards"] = jax.value_and_grad(reverse, (0, 1))
    cases, first = {}, {}
    for name, function in functions.items():
        program = jax.jit(jax.vmap(function) if starts > 1 else function)

        def call(program: Any = program) -> Row:
            result, clocks = measure.timed(lambda: jax.block_until_ready(program(*point)))
            return clocks | {"result": jax.tree.leaves(result)}

        first[name], cases[name] = call()["seconds"], call
    records = measure.interleaved(cases, 2 if small else 10)
    rows: list[Row] = []
    for name, runs in records.items():
        row = measure.summary(runs) | {"name": name, "starts": starts}
        plain = (rows or [row])[0]["seconds"]["median"]
        times = {"first_seconds": first[name], "over_plain": row["seconds"]["median"] / plain}
        rows.append(row | times)
    by_delta = [runs[0]["result"][1] for name, runs in records.items() if name != "end state"]
    apart = jnp.max(jnp.abs(by_delta[0] - by_delta[-1])) / jnp.max(jnp.abs(by_delta[0]))
    return [row | {"apart": float(apart)} for row in rows]


def compare(small: bool) -> Row:
    """All scenes."""
    levels = ("order-1",) if small else ("order-1", "order-2", "semi", "full")
    return {
        "rtol": RTOL,
        "sweeps": in_sweeps(small),
        "single": [row for level in levels for row in of_one_start(level, small)],
        "turns": over_many_turns(small),
        "memory": in_memory(small),
        "end": of_end_states(small) + ([] if small else of_end_states(small, TOGETHER)),
    }
