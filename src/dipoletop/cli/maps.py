"""Runs one level of a map, with its store."""

from pathlib import Path
from typing import Any, NamedTuple

from jaxtyping import Array

from .._base.checks import refuse
from .._base.types import Equation
from .._maps.basin import Basin
from .._maps.grids import Grid
from .._maps.store.contents import starts_done, verify
from .._maps.store.errors import StoreMismatch
from .._maps.store.tiles import open_store
from .._maps.sweep import sweep
from ..equations.levels import Level
from ..equations.transverse import equation_at
from .compile_time import measure_compile_time
from .quantities import CYLINDRICAL, SPHERICAL, initial_condition


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
        ValueError: bad settings, or a store with something else in it.
    """

    def problem(**point: Array) -> tuple[Equation, Array]:
        return equation_at(level, point["delta"]), initial_condition(point)

    stored = 0 if store is None else starts_done(store, settings.get("repair", False))
    try:
        with measure_compile_time() as seconds:
            basin = sweep(problem, grid, store=store, **settings)
    except StoreMismatch as error:
        raise ValueError(f"{error.reason}; choose another --output, or remove it.") from None
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
    levels = [level for level in Level if level.label == attrs["level"]]
    maps = [{"delta", "phi", *ways} for ways in (CYLINDRICAL, SPHERICAL)]
    if not levels or set(axes) not in maps:
        must = "be the store of a `dipoletop map`"
        refuse("path", must, f"{path} is of another sweep, which repairs it with `repair=True`")
    settings = {name: attrs.get(name) for name in ("rtol", "max_steps", "confirm", "engine")}
    (level,) = levels
    settings |= {"repair": True, "progress": level.value if progress else False}
    grid = Grid(**{name: tiles.values(name) for name in axes})
    run = run_level(level, grid, tiles.folder, **settings)
    return run, sum(tiles.tiling.length(tile) for tile in (*whole.unfinished, *whole.damaged))
