"""The default map: time, memory, compilations. Each in a fresh process, because of the memory."""

import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import dipoletop as dt
from benchmarks import engines
from benchmarks.reporting import measure

LEVELS = ("order-1", "semi")
REPEATS = 3
COMPILED = "/jax/core/compile/backend_compile_duration"


def compare(points: int) -> list[dict[str, Any]]:
    """`report` for each level and engine."""
    cases = itertools.product(LEVELS, engines.NAMES)
    return [measure.in_fresh_process(report, level, points, engine) for level, engine in cases]


def report(level: str, points: int, engine: str) -> dict[str, Any]:
    """The first and later sweeps over points × points starts, and compilations at other values."""
    before = measure.peak_memory()
    grid = dt.symmetry_cell(points, points)
    basin, first = measure.timed(sweep, level, grid, -0.2, 1e-8, engine)

    def again() -> measure.Record:
        return measure.timed(sweep, level, grid, -0.2, 1e-8, engine)[1]

    later = measure.summary(measure.interleaved({"sweep": again}, REPEATS)["sweep"])
    peak = measure.peak_memory()
    return {
        "level": basin.level,
        "engine": basin.attrs["engine"],
        "points": points,
        "first": first,
        "later": later,
        "starts_per_second": points**2 / later["seconds"]["median"],
        "steps": float(basin.steps.mean()),
        "peak_bytes": peak,
        "import_bytes": before,
        "compilations": _compilations(level, grid, engine),
    }


def memory(points: int, engine: str, stored: bool) -> dict[str, Any]:
    """Memory of the first sweep with value, order 1, its result in memory or on the disk."""
    before = measure.peak_memory()
    grid = dt.symmetry_cell(points, points)
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "basin" if stored else None
        _, clocks = measure.timed(sweep, "order-1", grid, -0.2, 1e-8, engine, store)
    about = {"points": points, "engine": engine, "stored": stored}
    return about | clocks | {"import_bytes": before, "peak_bytes": measure.peak_memory()}


def tops(level: str, delta: float) -> Callable[..., Any]:
    """Return the problem of a map over φ and ω₃, ω⊥ = 0.2."""
    return lambda w3, phi: (dt.equation_at(level, delta), dt.cylindrical(0.2, w3, phi))


def sweep(
    level: str, grid: dt.Grid, delta: float, rtol: float, engine: str, store: Any = None
) -> dt.Basin:
    """Return a map over a grid of φ and ω₃, ω⊥ = 0.2."""
    settings = {"rtol": rtol, "engine": engine, "store": store}
    return dt.sweep(tops(level, delta), grid, progress=False, **settings)


def _compilations(level: str, grid: dt.Grid, engine: str) -> dict[str, int]:
    """Return numbers of programs compiled when only δ, starts, times and tolerance change."""
    omegas = jax.random.normal(jax.random.key(0), (256, 3))
    deltas = jnp.linspace(-0.4, 0.4, 256)
    times = jnp.linspace(0.0, 100.0, 11)

    calls: dict[str, Callable[[float, float], Any]] = {
        "sweep": lambda factor, rtol: sweep(level, grid, -0.2 * factor, rtol, engine),
        "classify_many": lambda factor, rtol: dt.classify_many(
            dt.equation_at(level, factor * deltas), factor * omegas, rtol=rtol, engine=engine
        ),
        "classify": lambda factor, rtol: dt.classify(
            dt.equation_at(level, -0.2 * factor), factor * omegas[0], rtol=rtol
        ),
        "simulate": lambda factor, rtol: dt.simulate(
            dt.equation_at(level, -0.2 * factor), factor * omegas[0], ts=factor * times, rtol=rtol
        ),
    }
    counts = {}
    for name, call in calls.items():
        call(1.0, 1e-8)
        counts[name] = _compiled(lambda call=call: call(0.9, 1e-9))
    return counts


def _compiled(task: Callable[[], Any]) -> int:
    """Return how many programs are compiled during the task, in any thread."""
    seen: list[str] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        seen.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        task()
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    return seen.count(COMPILED) + seen.count(engines.COMPILING)
