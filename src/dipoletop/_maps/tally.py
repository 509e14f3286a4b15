"""The function `tally`: a sweep that keeps only counts."""

import dataclasses
import time
from collections.abc import Sequence
from os import PathLike
from typing import Any

from .._base.checks import refuse
from .._base.tolerances import check_settings
from .._runs.classification import Value
from .grids import Grid, Points, Sample
from .problems import Problem
from .sweep_plan import Settings, derivative_names, plan_of
from .sweep_stores import MemoryStore, ZarrStore
from .tally_counts import ROTATION, reduction_of, with_kept_first
from .tally_results import Counts, Tally, tally_on_disk
from .unfinished_tiles import finish


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
    given = Settings(value=value, derivatives=derivatives, reduction=reduction, **settings)
    plan = plan_of(problem, with_kept_first(over, reduction.keep), given)
    if store is None:
        kept = Counts(reduction, plan.tiling)
        place = MemoryStore(plan, lambda x: kept.add(x.tile, x.columns["counts"][0]))
        finish(plan, place, progress, client)
        found = kept.tally(plan.blocks.over.coords, plan.attrs)
    else:
        place = ZarrStore(store, plan, repair)
        finish(plan, place, progress, client)
        found = tally_on_disk(place.tiles, range(plan.tiling.count))
    return dataclasses.replace(found, seconds=time.perf_counter() - began)
