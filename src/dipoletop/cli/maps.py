"""Runs one level of a map: its sweep, its store, and how long anything was being compiled."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax

from .._base.checks import refuse
from .._base.monitoring import COMPILING
from .._maps.basin import Basin
from .._maps.grids import Grid
from .._maps.store.errors import StoreMismatch
from .._maps.store.saved_basins import starts_done, verify
from .._maps.store.tiles import open_store
from .._maps.sweep import sweep
from .._maps.top_parameters import CYLINDRICAL, SPHERICAL, problem_of_top
from ..equations.levels import Level
from .refusals import Refusal


class Run(NamedTuple):
    """A sweep at one level, and what it cost."""

    basin: Basin
    store: Path | None
    stored: int
    """Starts that the store held already."""
    compiling: float
    """Seconds in which something was compiled."""


def run_level(level: Level, grid: Grid, store: Path | None, **settings: Any) -> Run:
    """Sweep the grid at one level; `settings` are those of `sweep`.

    Raises:
        ValueError: bad settings.
        Refusal: a store with something else in it.
    """
    stored = 0 if store is None else starts_done(store, settings.get("repair", False))
    try:
        with measure_compile_time() as seconds:
            basin = sweep(problem_of_top(level), grid, store=store, **settings)
    except StoreMismatch as error:
        raise Refusal(f"{error.reason}; choose another --output, or remove it.") from None
    return Run(basin, store, stored, seconds())


def repair(path: str, progress: bool) -> tuple[Run, int]:
    """Mend the store of a map, which holds all that its sweep needs; how many starts it took.

    Raises:
        ValueError: it is not the store of a map.
        StoreDamaged: its metadata are damaged.
    """
    whole = verify(path)
    tiles = open_store(path)
    attrs, axes = tiles.header["attrs"], tiles.header["axes"]
    level = next((level for level in Level if level.label == attrs["level"]), None)
    maps = [{"delta", "phi", *ways} for ways in (CYLINDRICAL, SPHERICAL)]
    if level is None or set(axes) not in maps:
        must = "be the store of a `dipoletop map`"
        refuse("path", must, f"{path} is of another sweep, which repairs it with `repair=True`")
    names = "rtol", "max_steps", "engine", "slow_flow"
    settings = {name: attrs[name] for name in names} | {"confirm": attrs.get("confirm")}
    settings |= {"repair": True, "progress": level.value if progress else False}
    grid = Grid(**{name: tiles.values(name) for name in axes})
    run = run_level(level, grid, tiles.folder, **settings)
    return run, sum(tiles.tiling.length(tile) for tile in (*whole.unfinished, *whole.damaged))


@contextlib.contextmanager
def measure_compile_time() -> Iterator[Callable[[], float]]:
    """A function that returns for how many seconds any thread was tracing or compiling.

    JAX reports the end and the duration of every such event. Threads may compile at the same time,
    so the result is the length of the union of all these intervals.
    """
    intervals: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith(("/jax/core/compile/", COMPILING)):
            now = time.perf_counter()
            intervals.append((now - duration_secs, now))

    def length_of_union() -> float:
        total, covered_until = 0.0, -math.inf
        for begin, end in sorted(intervals):
            total += max(0.0, end - max(begin, covered_until))
            covered_until = max(covered_until, end)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield length_of_union
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
