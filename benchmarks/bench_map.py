"""The default map in a process of its own, so that its memory is its own: time, memory, compiles.

python benchmarks/bench_map.py order-1 512 native prints one line of JSON; … memory 512 native 0
prints the memory of one sweep only (1: its result goes to the disk).
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import dipoletop as dt
import measure
from dipoletop._base.monitoring import COMPILING

LEVELS, ENGINES = ("order-1", "semi"), ("native", "jax")
REPEATS = 3
COMPILED = "/jax/core/compile/backend_compile_duration"


def measured(*arguments: Any) -> dict[str, Any]:
    """`report`, or after "memory" `memory`, of a fresh process."""
    command = [sys.executable, __file__, *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def report(level: str, points: int, engine: str) -> dict[str, Any]:
    """The first and later sweeps over points × points starts, and what other values compile."""
    before = peak_memory()
    grid = dt.symmetry_cell(points, points)
    basin, first = measure.timed(lambda: sweep(level, grid, -0.2, 1e-8, engine))

    def again() -> measure.Record:
        return measure.timed(lambda: sweep(level, grid, -0.2, 1e-8, engine))[1]

    later = measure.summary(measure.interleaved({"sweep": again}, REPEATS)["sweep"])
    peak = peak_memory()
    return {
        "level": basin.level,
        "engine": basin.attrs["engine"],
        "points": points,
        "first": first,
        "later": later,
        "starts_per_second": points**2 / later["seconds"]["median"],
        "steps": float(basin.steps.mean()),
        "fractions": {name: share.share for name, share in basin.fractions().items()},
        "peak_bytes": peak,
        "import_bytes": before,
        "compilations": _compilations(level, grid, engine),
    }


def memory(points: int, engine: str, stored: bool) -> dict[str, Any]:
    """Memory of the first sweep with value, order 1, its result in memory or on the disk."""
    before = peak_memory()
    grid = dt.symmetry_cell(points, points)
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "basin" if stored else None
        _, clocks = measure.timed(lambda: sweep("order-1", grid, -0.2, 1e-8, engine, store))
    about = {"points": points, "engine": engine, "stored": stored}
    return about | clocks | {"import_bytes": before, "peak_bytes": peak_memory()}


def _equation(level: str, delta: Any) -> Any:
    return dt.TransverseSemi(delta) if level == "semi" else dt.TransverseReduced(delta)


def tops(level: str, delta: float) -> Callable[..., Any]:
    """The starts of a map over φ and ω₃, ω⊥ = 0.2."""
    return lambda w3, phi: (_equation(level, delta), dt.cylindrical(0.2, w3, phi))


def sweep(
    level: str, grid: dt.Grid, delta: float, rtol: float, engine: str, store: Any = None
) -> dt.Basin:
    """A map over a grid of φ and ω₃, ω⊥ = 0.2."""
    settings = {"rtol": rtol, "engine": engine, "store": store}
    return dt.sweep(tops(level, delta), grid, progress=False, **settings)


def _compilations(level: str, grid: dt.Grid, engine: str) -> dict[str, int]:
    """Programs compiled when δ, starts, times and tolerance change and nothing else does."""
    omegas = jax.random.normal(jax.random.key(0), (256, 3))
    deltas = jnp.linspace(-0.4, 0.4, 256)
    times = jnp.linspace(0.0, 100.0, 11)

    calls: dict[str, Callable[[float, float], Any]] = {
        "sweep": lambda scale, rtol: sweep(level, grid, -0.2 * scale, rtol, engine),
        "classify_many": lambda scale, rtol: dt.classify_many(
            _equation(level, scale * deltas), scale * omegas, rtol=rtol, engine=engine
        ),
        "classify": lambda scale, rtol: dt.classify(
            _equation(level, -0.2 * scale), scale * omegas[0], rtol=rtol
        ),
        "simulate": lambda scale, rtol: dt.simulate(
            _equation(level, -0.2 * scale), scale * omegas[0], ts=scale * times, rtol=rtol
        ),
    }
    found = {}
    for name, call in calls.items():
        call(1.0, 1e-8)
        found[name] = _compiled(lambda call=call: call(0.9, 1e-9))
    return found


def _compiled(task: Callable[[], Any]) -> int:
    """How many programs XLA compiles meanwhile, in any thread."""
    seen: list[str] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        seen.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        task()
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    return seen.count(COMPILED) + seen.count(COMPILING)


def peak_memory() -> int | None:
    """Most memory this process has held, bytes; None where the system does not tell.

    Linux's own counter first: getrusage also remembers the process that started this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        if "VmHWM" in lines:
            return 1024 * int(lines["VmHWM"].split()[0])
    try:
        import resource
    except ImportError:
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    scene, points, *rest = sys.argv[1:]
    if scene == "memory":
        print(json.dumps(memory(int(points), rest[0], rest[1] == "1")))
    else:
        print(json.dumps(report(scene, int(points), *rest)))
