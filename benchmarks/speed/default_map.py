"""The default map: time and memory. Each in a fresh process, because of the memory."""

import itertools
from typing import Any

import dipoletop as dt
from benchmarks import engines
from benchmarks.reporting import measure

LEVELS = ("order-1", "semi")
REPEATS = 3


def compare(small: bool) -> list[dict[str, Any]]:
    """`report` for each level and engine."""
    points, levels = (16, LEVELS[:1]) if small else (512, LEVELS)
    cases = itertools.product(levels, engines.NAMES)
    return [measure.in_fresh_process(report, level, points, engine) for level, engine in cases]


def report(level: str, points: int, engine: str) -> dict[str, Any]:
    """The first and later sweeps over points × points starts."""
    before = measure.peak_memory()
    grid = dt.symmetry_cell(points, points)
    basin, first = measure.timed(sweep, level, grid, engine)
    later = measure.summary([measure.timed(sweep, level, grid, engine)[1] for _ in range(REPEATS)])
    return {
        "level": basin.level,
        "engine": basin.attrs["engine"],
        "points": points,
        "first": first,
        "later": later,
        "starts_per_second": points**2 / later["seconds"]["median"],
        "steps": float(basin.steps.mean()),
        "peak_bytes": measure.peak_memory(),
        "import_bytes": before,
    }


def sweep(level: str, grid: dt.Grid, engine: str) -> dt.Basin:
    """Return a map over a grid of φ and ω₃: δ = −1/5, ω⊥ = 0.2."""

    def top(w3: Any, phi: Any) -> Any:
        return dt.equation_at(level, -0.2), dt.cylindrical(0.2, w3, phi)

    return dt.sweep(top, grid, rtol=1e-8, engine=engine, progress=False)
