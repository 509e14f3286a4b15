"""Costs of derivatives relative to the values alone, and their errors.

Derivatives of ω∞ come from the equation's first variations, in the lanes of a sweep or for one
start through JAX. They are compared with differences.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import dipoletop as dt
from benchmarks.accuracy.differences import differences
from benchmarks.problems import mixed_basin
from benchmarks.problems.families import TRUTH, body, top
from benchmarks.reporting import measure
from benchmarks.speed.outcomes import RTOL

NAMES = ("delta", "w3", "w1")  # a sweep differentiates by the first, the first two, all
POINT = np.append(-0.2, dt.cylindrical(0.2, 0.15, 0.1))  # δ and ω₀ of the single start
BODY = np.array([0.7, 1.1, 0.9, 0.0, 0.9, 0.2, 0.02, 0.1])  # a row of `families.body`
CALLS = 20  # number of calls of a program for one start that are timed together
TIME = 1000.0  # of the end states that are differentiated
HIGHER = ("order-2", "order-3", "order-4")
SMALLER = 0.25  # factor of the amplitudes at `HIGHER` levels, whose runs diverge at larger ones
LENGTHS = (0.3, 0.03, 0.003)  # |ω₀| of runs of different length, δ = 0.3
LONG = (1.3, 0.8, 1.0)  # principal moments of the body of long runs, |ω₀| = 1
TURNING, PATIENCE = 16, 4_000_000  # number of long runs, and largest number of their steps


class Sizes(NamedTuple):
    """Sizes of the measurement."""

    starts: int = 32768
    levels: tuple[str, ...] = ("order-1", "semi", *HIGHER)
    names: int = len(NAMES)
    engines: tuple[str, ...] = ("native", "jax")
    """Engines; orders 3 and 4 only with the native one, since JAX takes long to compile them."""
    single: tuple[str, ...] = ("order-1", "order-2", "semi", "full")
    """Levels at which one start is differentiated."""
    by_start: bool = True
    """Whether one start is also differentiated by its ω₀."""
    twice: tuple[str, ...] = ("order-1", "semi")
    """Levels at which one start is differentiated twice, which takes long to compile."""
    body: bool = False
    """Whether to include a general body, whose gradient takes minutes to compile."""
    weak: tuple[float, ...] = (0.1, 0.01, 0.001)
    """|d|² of bodies that make ever more turns before they are slow."""
    budgets: tuple[int, ...] = (1_000, 100_000)
    """Largest numbers of steps of the programs whose memory is compared."""
    together: int = 256
    """Number of starts whose end states are differentiated under one vmap."""
    backwards: bool = True
    """Whether to take reverse-mode gradients of `simulate`, which take long to compile."""
    repeats: int = 5


FEW = Sizes(
    starts=64,
    levels=("order-1",),
    names=1,
    engines=("native",),
    single=("order-1",),
    by_start=False,
    twice=(),
    weak=(0.1,),
    budgets=(1_000,),
    together=0,
    backwards=False,
    repeats=1,
)


def _sweep(level: str, rows: Float[np.ndarray, "n 4"], rtol: float, **settings: Any) -> dt.Basin:
    return top(level).sweep(rows, rtol, **settings)


def _slopes(basin: dt.Basin) -> Float[np.ndarray, "n m"]:
    return np.stack([basin.derivative(name) for name in basin.attrs["derivatives"]], axis=-1)


def in_sweeps(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure the mixed basin with residual values, without and with derivatives."""
    deltas, omegas = mixed_basin.sample(sizes.starts)
    rows = np.column_stack([deltas, omegas])
    table = []
    for level in sizes.levels:
        names, at = NAMES[: sizes.names], rows
        if level in HIGHER:
            at = np.column_stack([deltas, SMALLER * omegas])
        precise = _sweep(level, at, TRUTH, derivatives=names)
        for engine in sizes.engines:
            if engine == "native" or level not in HIGHER[1:]:
                table += _with_and_without(level, at, engine, precise, sizes)
    return table


def _with_and_without(
    level: str, rows: np.ndarray, engine: str, precise: dt.Basin, sizes: Sizes
) -> list[dict[str, Any]]:
    """Return a row for each number of derivatives, 0 first."""

    def case(m: int) -> Callable[[], dict[str, Any]]:
        settings = {"engine": engine, "max_steps": mixed_basin.MAX_STEPS, "derivatives": NAMES[:m]}
        settings["slow_flow"] = False  # derivatives are never predicted, so neither are values here
        sweep = partial(_sweep, level, rows, RTOL, **settings)
        _, first = measure.timed(sweep)

        def call() -> dict[str, Any]:
            basin, clocks = measure.timed(sweep)
            return clocks | {"basin": basin, "first": first["seconds"]}

        return call

    records = measure.interleaved({m: case(m) for m in range(sizes.names + 1)}, sizes.repeats)
    plain, base = records[0][0]["basin"], measure.summary(records[0])
    table = []
    for m, runs in records.items():
        basin, costs = runs[0]["basin"], measure.summary(runs)
        clocks = ("seconds", "processor_seconds")
        over = {clock: costs[clock]["median"] / base[clock]["median"] for clock in clocks}
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
            | _errors(basin, precise, plain, m)
        )
    return table


def _errors(basin: dt.Basin, precise: dt.Basin, plain: dt.Basin, m: int) -> dict[str, Any]:
    """Return relative errors of m derivatives (0: of ω∞) at residual starts, and missing ones."""
    residual = plain.outcome == dt.Outcome.RESIDUAL
    values, exact = (
        (_slopes(b)[:, :m] if m else b.omega_inf[:, None])[residual] for b in (basin, precise)
    )
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


def _costs(what: str, cases: dict[str, Any], sizes: Sizes) -> list[dict[str, Any]]:
    """Return a row for each case (function, its point, the exact result), the plain value first."""

    def called(program: Any, point: Any) -> dict[str, Any]:
        def task() -> Any:
            for _ in range(CALLS):
                result = jax.block_until_ready(program(*point))
            return result

        result, clocks = measure.timed(task)
        return {clock: spent / CALLS for clock, spent in clocks.items()} | {"result": result}

    programs = {name: _program(case[0], case[1]) for name, case in cases.items()}
    calls = {name: partial(called, programs[name][0], cases[name][1]) for name in cases}
    for call in calls.values():
        call()
    records = measure.interleaved(calls, sizes.repeats)
    plain = measure.summary(next(iter(records.values())))["processor_seconds"]["median"]
    rows = []
    for name, runs in records.items():
        leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(runs[0]["result"])]
        values, exact = np.concatenate(leaves), np.ravel(cases[name][2])
        row = measure.summary(runs) | {"of": what, "name": name}
        row |= {"compile_seconds": programs[name][1], "starts": 1}
        row |= {"over_plain": row["processor_seconds"]["median"] / plain}
        rows.append(row | {"error": float(np.max(np.abs(values - exact)) / np.max(np.abs(exact)))})
    return rows


def of_one_start(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure ω∞ of one start and its derivatives, jitted, at rtol 1e-10."""
    rows = []
    for level in sizes.single:
        rows += _costs(level, _of_a_top(level, sizes), sizes)
    return rows + (_costs("general body, order 1", _of_a_body(), sizes) if sizes.body else [])


def _of_a_top(level: str, sizes: Sizes) -> dict[str, Any]:
    """Return functions of δ and ω₀, and their exact results."""

    def value(delta: Any, omega: Any) -> Any:
        return dt.residual_rotation(dt.equation_at(level, delta), omega)

    family, row = top(level), POINT[None]
    point = jnp.asarray(POINT[0]), jnp.asarray(POINT[1:])
    slopes = differences(family.values, row, family.directions)[0][0, :, 0]
    cases = {
        "ω∞": (value, point, family.values(row)),
        "by δ": (jax.grad(value), point, slopes[:1]),
    }
    if sizes.by_start:
        cases["by δ and ω₀"] = (jax.grad(value, (0, 1)), point, slopes)
    if level in sizes.twice:
        second = differences(family.slopes, row, family.directions)[0][0]
        hessian = jax.hessian(lambda x: value(x[0], x[1:]))
        cases["twice by δ and ω₀"] = (hessian, (jnp.asarray(POINT),), second)
    return cases


def _of_a_body() -> dict[str, Any]:
    """Return functions of inertia, dipole and start, and their exact results."""
    family, row = body("body, order 1"), BODY[None]

    def value(moments: Any, dipole: Any, omega: Any) -> Any:
        axis = jnp.array([1.0, 0.0, 0.0])
        equation = dt.Reduced(dt.Body(jnp.diag(moments), dipole * axis))
        return dt.residual_rotation(equation, omega)

    parts = jnp.asarray(BODY[:3]), jnp.asarray(BODY[4]), jnp.asarray(BODY[5:])
    moments, _, dipole, start = np.split(
        differences(family.values, row, family.directions)[0][0, :, 0], [3, 4, 5]
    )
    cases = {"ω∞": (value, parts, family.values(row))}
    wanted = {"its moments": moments, "its dipole": dipole, "the start": start}
    for k, name in enumerate(wanted):
        cases[f"by {name}"] = (jax.grad(value, k), parts, wanted[name])
    return cases


def over_many_turns(sizes: Sizes) -> list[dict[str, Any]]:
    """Return errors of derivatives of general bodies that radiate weakly, at order 1.

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
    for strength in sizes.weak:
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


def in_memory(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure temporary memory of compiled gradients by δ, and the longest possible runs."""
    adjoint = diffrax.RecursiveCheckpointAdjoint()
    way = POINT[1:] / np.linalg.norm(POINT[1:])
    starts = np.array([np.append(0.3, size * way) for size in LENGTHS])
    basin = _sweep("order-1", starts, 1e-10, derivatives="delta")  # to know their steps

    def limit(delta: Any, omega: Any, max_steps: int) -> Any:
        value = dt.residual_rotation(dt.TransverseReduced(delta), omega, max_steps=max_steps)
        return value, 0

    def end(delta: Any, omega: Any, max_steps: int) -> Any:
        # As long as the run to ω∞, a few braking times.
        ts = jnp.stack([jnp.zeros(()), 5 / jnp.sum(omega**2)])
        options: dict[str, Any] = {"adjoint": adjoint, "throw": False, "max_steps": max_steps}
        run = dt.simulate(dt.TransverseReduced(delta), omega, ts, **options)
        return run.omega[-1, 0], run.stats["num_steps"]

    functions = {"ω∞": limit}
    if sizes.backwards:
        functions["end state, `simulate`, `RecursiveCheckpointAdjoint`"] = end
    rows = []
    for name, function in functions.items():
        for budget in sizes.budgets:
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


def _end(delta: Any, omega: Any, adjoint: Any) -> Any:
    """Return ω₁ at the end of a run of `simulate`."""
    ts = jnp.array([0.0, TIME])
    top = dt.TransverseReduced(delta)
    return dt.simulate(top, omega, ts, adjoint=adjoint, throw=False).omega[-1, 0]


PLAIN = "end state"


def _derivatives(backwards: bool) -> dict[str, Callable[..., Any]]:
    """Return functions: end state alone, with ∂/∂δ, with all four derivatives (by δ and ω₀)."""
    reverse, forward = diffrax.RecursiveCheckpointAdjoint(), diffrax.ForwardMode()

    def tangent(delta: Any, omega: Any) -> Any:
        ones = (jnp.ones_like(delta),)
        return jax.jvp(lambda d: _end(d, omega, forward), (delta,), ones)

    functions: dict[str, Callable[..., Any]] = {
        PLAIN: lambda delta, omega: (_end(delta, omega, forward),),
        "and its derivative by δ, forwards": tangent,
    }
    if backwards:
        gradient = jax.value_and_grad(partial(_end, adjoint=reverse), (0, 1))
        functions["and all four, backwards"] = gradient
    return functions


def of_end_states(sizes: Sizes) -> list[dict[str, Any]]:
    """Measure `simulate` with and without derivatives, without compilation, at rtol 1e-10."""
    delta, omega = jnp.asarray(-0.2), dt.cylindrical(0.2, 0.2, 0.1)
    rows = _end_states((delta, omega), lambda function: function, sizes)
    if sizes.together:
        n = sizes.together
        many = jnp.full(n, delta), jnp.asarray(mixed_basin.isotropic(n, 0.2))
        rows += _end_states(many, jax.vmap, sizes)
    return rows


def _end_states(point: Any, batched: Callable[..., Any], sizes: Sizes) -> list[dict[str, Any]]:
    """Return a row for each of `_derivatives`, with the difference between derivatives by δ."""
    cases, first = {}, {}
    for name, function in _derivatives(sizes.backwards).items():
        program = jax.jit(batched(function))

        def call(program: Any = program) -> dict[str, Any]:
            result, clocks = measure.timed(lambda: jax.block_until_ready(program(*point)))
            return clocks | {"result": jax.tree.leaves(result)}

        first[name], cases[name] = call()["seconds"], call
    records = measure.interleaved(cases, 2 * sizes.repeats)
    plain = measure.summary(records[PLAIN])["seconds"]["median"]
    by_delta = [runs[0]["result"][1] for name, runs in records.items() if name != PLAIN]
    rows = []
    for name, runs in records.items():
        row = measure.summary(runs) | {"name": name, "starts": np.size(point[0])}
        times = {"first_seconds": first[name], "over_plain": row["seconds"]["median"] / plain}
        rows.append(row | times)
    apart = jnp.max(jnp.abs(by_delta[0] - by_delta[-1])) / jnp.max(jnp.abs(by_delta[0]))
    return [row | {"apart": float(apart)} for row in rows]


def compare(sizes: Sizes) -> dict[str, Any]:
    """Measure all cases."""
    return {
        "rtol": RTOL,
        "sweeps": in_sweeps(sizes),
        "single": of_one_start(sizes),
        "turns": over_many_turns(sizes),
        "memory": in_memory(sizes),
        "end": of_end_states(sizes),
    }
