"""Basin maps: a problem over a grid, points or a sample, tile by tile, on all cores or devices."""

import functools
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from .._base.checks import check_verdict, names_of, refuse
from .._base.parallel import in_parallel, worker_devices
from .._base.stopping import Until
from .._base.tolerances import MAX_STEPS, absolute, budget, check_atol, tolerance
from .._engines.interface import Limits
from .._engines.select import select_engines
from .._runs.classification import Value, classification_of, stopping_rule
from .._runs.classify_many import TILE, classify_block, power_of_two
from . import store as disk
from .basin import FIELDS, SLOPE, Basin, columns_of, kind_of
from .grids import Grid, Points, Sample
from .problems import Builder, Problem, block_digest, builder


def sweep(
    problem: Problem,
    over: Grid | Points | Sample,
    *,
    rtol: Any = 1e-8,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
    value: Value = True,
    derivatives: Sequence[str] = (),
    confirm: float | None = None,
    store: Any = None,
    repair: bool = False,
    progress: bool | str | None = None,
    devices: Sequence[Any] | None = None,
    engine: str = "auto",
) -> Basin:
    """Outcomes of a problem on every point of a grid, a list or a sample.

    Args:
        problem: a function of the grid's axes (by name) or of the sample's start that gives the
            equation and the start; pure JAX, since it is vectorised.
        over: a `Grid`, `Points` or a `Sample`.
        rtol: relative tolerance of every step; `omega_inf_error` tells how exact ω∞ is.
        atol: absolute tolerance; None means none, since errors are measured by the present |ω|; or
            rtol·|ω₀| for each start with `value=False`.
        max_steps: budget of each run; one that exhausts it is UNDECIDED.
        value: whether to go on until ω∞ is known, not only its outcome: True, with an estimate of
            its error from three neighbouring starts; "unchecked", without, for about a third of
            the cost; or False.
        derivatives: arguments of the problem, numbers all; `basin.derivative(name)` is then
            ∂ω∞/∂name, from the equation's first variations, each step of which is held to ten
            times `rtol`: over thousands of turns errors add up, and a smaller `rtol` tells.
        confirm: a second `rtol`; `basin.changed` then marks the outcomes that differ.
        store: a folder for the result. Run the same sweep again and it goes on where it was
            stopped; a grid of any size then needs little memory. Before a tile is used again it
            is read, and its equations and starts are compared with those it was computed from, to
            the last bit: processors of another kind may compute others, and are then refused.
        repair: whether to compute damaged tiles of the store again, in place of `StoreDamaged`.
        progress: whether to show a progress bar; None shows it on a terminal, a text with that
            label.
        devices: which devices to use; None means all.
        engine: "jax", "native" (machine code, for float64 on processors; it needs numba), or
            "auto", the fastest that can run here; `basin.attrs` says which did.

    Returns:
        A `Basin`.

    Raises:
        ValueError: bad arguments, among them a store that holds another sweep. A run that fails
            is an outcome, FAILED.
        StoreDamaged: the store is not as it was written.

    Example:
        >>> import dipoletop as dt
        >>> def problem(w3, phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
        >>> basin = dt.sweep(problem, dt.Grid(w3=[0.1, 0.3], phi=[0.0, 0.8, 1.6]))
        >>> basin.outcome.shape, basin.level
        ((2, 3), "reduced, order 1 (the paper's)")
    """
    began = time.perf_counter()
    along = _names(derivatives, value)
    build = builder(problem, over, along)
    if atol is not None:
        check_atol(atol)
    rtols = [tolerance("rtol", rtol)]
    if confirm is not None:
        rtols.append(tolerance("confirm", confirm))
    steps, crew = budget("max_steps", max_steps), worker_devices(devices)
    equation, _ = build(np.zeros(1, int))
    check_verdict(equation)
    until = stopping_rule(equation, value)
    engines = select_engines(engine, equation, crew, until, classification_of)

    def run(job: int, device: Any) -> tuple[dict[str, np.ndarray], Any]:
        block = build(tiling.points(job))
        limits = functools.partial(_limits, block, tiling.real(job), atol, steps, until)
        each = [
            columns_of(classify_block(*block, limits(rtol), value, engines[device], device), along)
            for rtol in rtols
        ]
        return _compared(each, tiling.real(job)), block

    attrs = {
        "level": getattr(equation, "level", type(equation).__name__),
        "rtol": float(rtols[0]),
        "atol": float(atol or 0) if value or atol is not None else "rtol*|omega_0|",
        "max_steps": steps,
        "value": value,
        "engine": engines[crew[0]].name,
        **({"derivatives": list(along)} if along else {}),
        **({} if confirm is None else {"confirm": float(confirm)}),
        **_versions(),
    }
    names = [*FIELDS, *(SLOPE + name for name in along)]
    names += [] if confirm is None else ["changed"]
    size = int(np.prod(over.shape))
    # A tile has the same size whatever the machine: a store may move.
    tiling = Tiling(size, min(TILE, power_of_two(-(-size // 8))))
    work = functools.partial(_work, run, crew=crew, tiling=tiling, progress=progress)
    if store is None:
        columns = _in_memory(work, names, tiling)
        seconds = time.perf_counter() - began
        return Basin(over.dims, over.shape, over.coords, columns, attrs, seconds)
    header = _header(build, {"tile": tiling.tile, "columns": names, "attrs": attrs})
    kept = disk.create(store, header, over.header.values, repair)
    jobs = _to_do(kept, lambda job: block_digest(build(tiling.points(job))), crew, repair)
    work(jobs, lambda job, found, block: kept.write(job, found, block_digest(block)))
    return disk.view(kept, time.perf_counter() - began)


class Tiling(NamedTuple):
    """How flat indices are cut into tiles; the last one is filled up with the last index."""

    size: int
    tile: int

    @property
    def count(self) -> int:
        """The number of tiles."""
        return -(-self.size // self.tile)

    def _every(self, job: int) -> Int[np.ndarray, "tile"]:
        return np.arange(job * self.tile, (job + 1) * self.tile)

    def points(self, job: int) -> Int[np.ndarray, "tile"]:
        """The indices of a tile."""
        return np.minimum(self._every(job), self.size - 1)

    def real(self, job: int) -> Bool[np.ndarray, "tile"]:
        """Which of them do not fill it up."""
        return self._every(job) < self.size


def _in_memory(work: Any, names: list[str], tiling: Tiling) -> dict[str, np.ndarray]:
    columns = {name: np.empty(tiling.size, kind_of(name)[0]) for name in names}

    def keep(job: int, found: dict[str, np.ndarray], _: Any) -> None:
        for name, values in found.items():
            start = job * tiling.tile
            columns[name][start : start + len(values)] = values

    work(range(tiling.count), keep)
    return columns


def _header(build: Builder, about: dict[str, Any]) -> dict[str, Any]:
    """All that tells a sweep from another one, but the values that are swept."""
    over = build.over
    return {
        "dims": list(over.dims),
        "shape": list(over.shape),
        **about,
        "axes": list(over.coords),
        "over": over.header.kind,
        "settings": over.header.settings,
        "type": str(jnp.result_type(float)),
        "programs": {name: found.hex() for name, found in build.programs().items()},
    }


def _to_do(kept: disk.Tiles, inputs: Any, crew: list[Any], repair: bool) -> list[int]:
    """The tiles to be computed; what is there already is read, and its inputs are compared."""
    left = kept.unfinished()
    there = sorted(set(range(kept.count)) - set(left))
    damaged = kept.damaged(there)
    if not repair:
        kept.refuse_damaged(damaged, " (`repair` computes it again)")
    good = [tile for tile in there if tile not in damaged]
    for tile, found in in_parallel(lambda job, _: inputs(job), good, crew):
        was = kept.record(tile).inputs
        if found != was:
            refuse(
                "store",
                "be new or hold this very sweep",
                f"in tile {tile} of {kept.place} the equations or starts are others "
                f"({was.hex()[:8]} there and {found.hex()[:8]} here)",
            )
    return sorted([*left, *damaged])


def _work(run, jobs, keep, *, crew, tiling: Tiling, progress) -> None:
    """Run the tiles and keep what they find, with a progress bar."""
    from tqdm import tqdm

    hide = None if progress is None else not progress
    label = progress if isinstance(progress, str) else None
    left = sum(int(np.sum(tiling.real(job))) for job in jobs)
    with tqdm(
        desc=label,
        total=tiling.size,
        initial=tiling.size - left,
        unit="start",
        unit_scale=True,
        disable=hide,
        file=sys.stderr,
    ) as bar:
        for job, (found, block) in in_parallel(run, jobs, crew):
            keep(job, found, block)
            bar.update(len(found["outcome"]))


def _limits(block, real, atol, max_steps: int, until: Until, rtol) -> Limits:
    """What fills up a tile takes no step."""
    stops = np.where(real, np.inf, 0.0)
    least = absolute(atol, rtol, block[1], label_only=until == "outcome")
    return Limits(rtol, least, stops, jnp.asarray(max_steps))


def _compared(each: list[dict[str, np.ndarray]], real: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of the first tolerance, and where the outcome differs at the second."""
    columns, *again = each
    for other in again:
        columns["changed"] = columns["outcome"] != other["outcome"]
    return {name: values[real] for name, values in columns.items()}


@functools.cache  # it reads files
def _versions() -> dict[str, str]:
    return {f"version_{name}": version(name) for name in ("dipoletop", "jax", "diffrax")}


def _names(derivatives: Any, value: Value) -> tuple[str, ...]:
    """The arguments along which ω∞ is differentiated."""
    names = names_of("derivatives", derivatives)
    if len(set(names)) < len(names):
        refuse("derivatives", "name each argument once", f"is {', '.join(names)}")
    if names and not value:
        refuse("value", "be True if there are derivatives of ω∞ to be found", "is False")
    return names
