"""Sweeps over a grid, points or a sample, tile by tile, on all devices: outcomes, or counts."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

from .._base.checks import ArrayLike, NumberLike
from .._base.refusals import refuse
from .._base.tolerances import MAX_STEPS, check_settings, tolerance
from .._runs.classification import Value
from .._runs.run_settings import RunSettings
from .._runs.slow_runs import SlowFlow
from .basin import Basin
from .grids import Grid, Points, Sample
from .problems import Problem
from .sweep_plan import derivative_names, plan_of
from .sweep_stores import ColumnsInMemory, MemoryStore, Store, ZarrStore
from .tally_counts import ROTATION, reduction_of, with_kept_first
from .tally_results import Counts, Tally, tally_on_disk
from .tiling import Tiling
from .unfinished_tiles import finish


def sweep(
    problem: Problem,
    over: Grid | Points | Sample,
    *,
    rtol: NumberLike = 1e-8,
    atol: NumberLike | ArrayLike | None = None,
    max_steps: int = MAX_STEPS,
    value: Value = True,
    derivatives: str | Sequence[str] = (),
    confirm: float | None = None,
    store: str | bytes | PathLike[Any] | None = None,
    repair: bool = False,
    progress: bool | str | None = None,
    devices: Sequence[Any] | None = None,
    engine: str = "auto",
    slow_flow: SlowFlow = "auto",
    client: Any = None,
) -> Basin:
    """Compute the outcome of a problem at every point of a grid, a list or a sample.

    Args:
        problem: a function from the grid's axes (by name) or the sample's start to the equation and
            the start ω₀. It is vectorised, so it must be pure JAX.
        over: a `Grid`, `Points` or a `Sample`.
        rtol: relative tolerance of every step; `omega_inf_error` gives the error of ω∞.
        atol: absolute tolerance. None means 0, since errors are relative to the present |ω|; but
            rtol·|ω₀| with `value=False` for tops all of whose slow motions have the same outcome.
        max_steps: budget of each run; one that would exceed it is predicted, or UNDECIDED.
        value: whether ω∞ is wanted, not only the outcome; see the table below.
        derivatives: arguments of the problem, each a number; `basin.derivative(name)` is then
            ∂ω∞/∂name. The equation's first variations are integrated with tolerance 10·rtol;
            their errors accumulate over many turns, so repeat with a smaller `rtol` to check.
        confirm: a second `rtol`; `basin.changed` then marks the outcomes that differ.
        store: a folder for the result, which the same sweep resumes; see below.
        repair: whether to compute damaged tiles of the store again, instead of raising
            `StoreDamaged`.
        progress: whether to show a progress bar; None shows it on a terminal only. A text is its
            label.
        devices: the devices to use, with a thread each; None means all GPUs of this process if
            there are any, else all cores. A list may contain both.
        engine: "jax", "native" (machine code, for float64 on processors; it needs llvmlite), or
            "auto", the fastest that can run here; `basin.attrs["engine"]` is the one that ran.
        slow_flow: whether runs that would take more than `max_steps` are predicted by the average
            over free rotation: "auto", True (all runs that the first state does not decide) or
            False; see `classify`. `basin.regime` names the law that decided.
        client: a `distributed.Client` (`pip install 'dipoletop[dask]'`): the workers of its cluster
            compute the tiles, and write them to the store, which they must see at the same path.
            If a worker dies, another one computes its tile. `devices` is then ignored. The page
            `notebooks/clusters.md` shows how to start such a cluster.

    | `value` | a run ends when | `omega_inf_error` | cost |
    |---|---|---|---|
    | True | ω∞ is known | estimated, if need be from neighbouring starts | 1 |
    | "unchecked" | ω∞ is known | infinite where ω∞ was integrated | about ½ |
    | False | the outcome is certain | infinite, and ω∞ NaN, unless ω₁ is constant | least |

    With `value=False` the native engine runs starts at rtol = 1e-4 first, and again at `rtol` if
    that leaves the outcome in doubt, as near a boundary; the runs of `confirm` all have its
    tolerance.

    With a `store` a grid of any size needs little memory, and calling an interrupted sweep again
    resumes it. The finished tiles are read first, and their equations and starts are compared bit
    by bit with this call's. On another kind of processor these may differ; the store is then
    refused.

    Returns:
        A `Basin`.

    Raises:
        ValueError: bad arguments. A run that fails is an outcome, FAILED.
        StoreMismatch: the store holds another sweep, or its path cannot be used.
        StoreDamaged: the store differs from what was written.
        ConnectionError: the scheduler of the `client` was lost, or several workers died with the
            same tile. Finished tiles are kept; the same call resumes the sweep.

    Example:
        >>> import dipoletop as dt
        >>> def problem(w3, phi):
        ...     return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)
        >>> basin = dt.sweep(problem, dt.Grid(w3=[0.1, 0.3], phi=[0.0, 0.8, 1.6]))
        >>> basin.outcome.shape, basin.level
        ((2, 3), "reduced, order 1 (the paper's)")
    """
    began = time.perf_counter()
    settings = RunSettings(rtol, atol, max_steps, value, engine, slow_flow, devices)
    plan = plan_of(problem, over, settings, derivatives=derivatives, confirm=confirm)
    if store is None:
        columns = ColumnsInMemory(plan)
        place: Store = MemoryStore(plan, columns.add)
    else:
        columns = place = ZarrStore(store, plan, repair)
    finish(plan, place, progress, client)
    return Basin(*columns.contents(), seconds=time.perf_counter() - began)


def tally(
    problem: Problem,
    over: Grid | Points | Sample,
    *,
    keep: str | Sequence[str] = (),
    histograms: Any = None,
    value: Value | None = None,
    derivatives: str | Sequence[str] = (),
    store: str | bytes | PathLike[Any] | None = None,
    repair: bool = False,
    progress: bool | str | None = None,
    client: Any = None,
    **settings: Any,
) -> Tally:
    """Count the outcomes of a sweep without keeping its starts, for more than fit on a disk.

    A store holds only the counts of each tile, so that 1e10 starts take some 100 MB. Each tile is
    counted once, even if the sweep is killed and run again.

    Args:
        problem: as in `sweep`.
        over: as in `sweep`; a `Sample` may have up to 2⁶³ − 1 starts.
        keep: names of axes of a `Grid`; starts are counted separately for each combination of
            values on these axes. By default all starts are counted together.
        histograms: a mapping from the column to count to increasing edges of bins. The column is
            "omega_inf", "omega_inf_error", "time", "steps", or a derivative ("d_omega_inf_d_" and
            its name).
        value: whether to compute ω∞, as in `sweep`; None: if a histogram counts it.
        derivatives: as in `sweep`.
        store: a folder for the counts of each tile, which the same tally resumes; `Tally.load`
            reads it.
        repair: as in `sweep`.
        progress: as in `sweep`.
        client: as in `sweep`.
        settings: rtol, atol, max_steps, devices, engine and slow_flow, as in `sweep`.

    Returns:
        A `Tally`.

    Raises:
        ValueError: bad arguments.
        StoreMismatch: the store holds something else, or its path cannot be used.
        StoreDamaged: the store differs from what was written.

    Example:
        >>> import dipoletop as dt
        >>> def problem(delta, omega0):
        ...     return dt.TransverseSemi(delta), omega0
        >>> starts = [[0.2, 0.0, 0.1], [0.0, 0.2, 0.1], [0.1, 0.1, 0.3]]
        >>> grid = dt.Grid(delta=[-0.2, 0.2], omega0=starts)
        >>> found = dt.tally(problem, grid, keep="delta")
        >>> found.count(dt.Outcome.RESIDUAL)
        array([2, 3])
    """
    began = time.perf_counter()
    names = derivative_names(derivatives, value is not False)
    check_settings(settings)
    reduction = reduction_of(over, keep, {} if histograms is None else histograms, names)
    counts_rotation = any(column in ROTATION for column in reduction.edges)
    if counts_rotation and value is False:
        refuse("value", "be True or None if there are histograms of ω∞", "is False")
    if value is None:
        value = bool(names) or counts_rotation
    runs = RunSettings(value=value, **settings)
    over = with_kept_first(over, reduction.keep)
    plan = plan_of(problem, over, runs, derivatives=derivatives, reduction=reduction)
    if store is None:
        kept = Counts(reduction, plan.tiling)
        place = MemoryStore(plan, lambda x: kept.add(x.tile, x.columns["counts"][0]))
        finish(plan, place, progress, client)
        found = kept.tally(plan.blocks.over.coords, plan.attrs)
    else:
        place = ZarrStore(store, plan, repair)
        finish(plan, place, progress, client)
        found = tally_on_disk(place.tiles, range(plan.tiling.count))
    return replace(found, seconds=time.perf_counter() - began)


def prepared_sweep(
    problem: Problem,
    over: Grid | Points,
    settings: RunSettings,
    derivatives: tuple[str, ...] = (),
) -> Callable[[Grid | Points, NumberLike], Basin]:
    """Prepare a sweep once for all values of the same names.

    Tracing the problem and choosing an engine take longer than running some ten thousand starts. So
    does a division into tiles, whose Python code runs in one thread at a time. An engine with its
    own threads therefore gets all starts at once.

    Returns:
        A function from a grid with these axes, or points with these coordinates, and a tolerance
        to the basin, as from `sweep`. It raises a ValueError for a bad tolerance, or values that
        the problem refuses.

    Raises:
        ValueError: bad arguments.
    """
    plan = plan_of(problem, over, settings, derivatives=derivatives)
    if all(engine.has_own_threads for engine in plan.engines.values()):
        devices, threads = plan.devices[:1], len(plan.devices)
        plan = replace(plan, devices=devices, cut=lambda x: Tiling(x, x), threads=threads)

    def basin_over(over: Grid | Points, rtol: NumberLike) -> Basin:
        began = time.perf_counter()
        blocks = replace(plan.blocks, over=over)
        settings = plan.settings._replace(rtol=tolerance("rtol", rtol, xp=np))
        here = replace(plan, blocks=blocks, settings=settings)
        columns = ColumnsInMemory(here)
        finish(here, MemoryStore(here, columns.add), False)
        return Basin(*columns.contents(), seconds=time.perf_counter() - began)

    return basin_over


class PointSweeps:
    """The sweeps of one problem over lists of points, each prepared once (`prepared_sweep`).

    What the problem refers to must not change in the meantime.

    Args:
        problem: a problem as for `sweep`.
        settings: fields of `RunSettings`.
    """

    def __init__(self, problem: Problem, settings: Mapping[str, Any]) -> None:
        self.problem, self.settings = problem, dict(settings)
        self._prepared: dict[Any, Callable[[Points, NumberLike], Basin]] = {}

    def __call__(self, points: Points, derivatives: tuple[str, ...] = ()) -> Basin:
        """Return the basin over points, as from `sweep`."""
        key = tuple(points.header.values), derivatives
        if key not in self._prepared:
            settings = RunSettings(**self.settings)
            self._prepared[key] = prepared_sweep(self.problem, points, settings, derivatives)
        return self._prepared[key](points, self.rtol)

    @property
    def rtol(self) -> Any:
        """The relative tolerance of the runs."""
        return self.settings.get("rtol", RunSettings().rtol)
