"""Basin maps: a problem over a grid, points or a sample, tile by tile, on all cores or devices."""

import functools
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import jax.numpy as jnp
import numpy as np

from . import lanes
from . import store as disk
from ._checks import names_of, refuse
from ._problems import Problem, builder, fingerprint
from ._settings import MAX_STEPS, absolute, budget, check_atol, tolerance
from ._workers import in_parallel, workers
from .basin import FIELDS, SLOPE, Basin, columns_of, kind_of
from .grids import Grid, Points, Sample
from .outcomes import TILE, check_verdict, classify_block, engines_for, goal, power_of_two


def sweep(
    problem: Problem,
    over: Grid | Points | Sample,
    *,
    rtol: Any = 1e-8,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
    value: bool = True,
    derivatives: Sequence[str] = (),
    confirm: float | None = None,
    store: Any = None,
    progress: bool | str | None = None,
    devices: Sequence[Any] | None = None,
    engine: str = "auto",
) -> Basin:
    """Outcomes of a problem on every point of a grid, a list or a sample.

    Args:
        problem: a function of the grid's axes (by name) or of the sample's start that gives the
            equation and the start; pure JAX, since it is vectorised.
        over: a `Grid`, `Points` or a `Sample`.
        rtol: relative tolerance; also that of ω∞.
        atol: absolute tolerance; None means rtol·|ω₀| for each start.
        max_steps: budget of each run; one that exhausts it is UNDECIDED.
        value: whether to go on until ω∞ is known to `rtol`, not only its outcome.
        derivatives: arguments of the problem, numbers all; `basin.derivative(name)` is then
            ∂ω∞/∂name, from the equation's first variations, each step of which is held to ten
            times `rtol`: over thousands of turns errors add up, and a smaller `rtol` tells.
        confirm: a second `rtol`; `basin.changed` then marks the outcomes that differ.
        store: a folder for the result. Run the same sweep again and it goes on where it was
            stopped; a grid of any size then needs little memory.
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
    size = int(np.prod(over.shape))
    rtols = [tolerance("rtol", rtol)]
    if confirm is not None:
        rtols.append(tolerance("confirm", confirm))
    crew = workers(devices)
    tile = min(TILE, power_of_two(-(-size // 8)))  # whatever the machine: a store may move
    equation, _ = build(np.zeros(1, int))
    check_verdict(equation)
    until = goal(equation, value)
    engines = engines_for(engine, equation, crew, until)
    run = functools.partial(
        _run_tile,
        build,
        size=size,
        tile=tile,
        rtols=rtols,
        atol=atol,
        max_steps=budget("max_steps", max_steps),
        derivatives=along,
        until=until,
        engines=engines,
    )

    settings = {"rtol": float(rtols[0]), "atol": "rtol*|omega_0|" if atol is None else float(atol)}
    attrs = {
        "level": getattr(equation, "level", type(equation).__name__),
        **settings,
        "max_steps": int(max_steps),
        "value": bool(value),
        "engine": engines[crew[0]].NAME,
        **({"derivatives": list(along)} if along else {}),
        **({} if confirm is None else {"confirm": float(confirm)}),
        **_versions(),
    }
    names = [*FIELDS, *(SLOPE + name for name in along)]
    names += [] if confirm is None else ["changed"]
    shared = (over.dims, over.shape, over.coords)
    if store is None:
        columns = {name: np.empty(size, kind_of(name)[0]) for name in names}

        def keep(job: int, found: dict[str, np.ndarray]) -> None:
            for name, values in found.items():
                columns[name][job * tile : job * tile + len(values)] = values

        _work(run, range(-(-size // tile)), keep, crew, (size, tile, progress))
        return Basin(*shared, columns, attrs, time.perf_counter() - began)

    header = {
        "dims": list(over.dims),
        "shape": list(over.shape),
        "tile": tile,
        "columns": names,
        "attrs": attrs,
        "fingerprint": fingerprint(build, size),
    }
    group = disk.create(store, header, over.coords)
    write = functools.partial(disk.write_tile, group)
    _work(run, disk.unfinished(group), write, crew, (size, tile, progress))
    return disk.view(group, time.perf_counter() - began)


def _work(run, jobs, keep, crew, extent) -> None:
    """Run the tiles and keep what they find, with a progress bar."""
    from tqdm import tqdm

    size, tile, progress = extent
    hide = None if progress is None else not progress
    label = progress if isinstance(progress, str) else None
    done = size - sum(min(tile, size - job * tile) for job in jobs)
    with tqdm(
        desc=label,
        total=size,
        initial=done,
        unit="start",
        unit_scale=True,
        disable=hide,
        file=sys.stderr,
    ) as bar:
        for job, found in in_parallel(run, jobs, crew):
            keep(job, found)
            bar.update(len(found["outcome"]))


def _run_tile(
    build, job: int, device: Any, *, size, tile, rtols, atol, max_steps, derivatives, until, engines
) -> dict[str, Any]:
    """Classify the starts of one tile; the last tile is filled up with starts that take no step."""
    at = np.arange(job * tile, (job + 1) * tile)
    real = at < size
    equation, omegas = build(np.minimum(at, size - 1))
    stops = np.where(real, np.inf, 0.0)

    def classified(rtol) -> dict[str, np.ndarray]:
        limits = lanes.Limits(rtol, absolute(atol, rtol, omegas), stops, jnp.asarray(max_steps))
        ends = classify_block(equation, omegas, limits, until, engines[device], device)
        found = columns_of(ends, derivatives)
        return {name: values[real] for name, values in found.items()}

    columns, *again = [classified(rtol) for rtol in rtols]
    for other in again:
        columns["changed"] = columns["outcome"] != other["outcome"]
    return columns


@functools.cache  # it reads files
def _versions() -> dict[str, str]:
    return {f"version_{name}": version(name) for name in ("dipoletop", "jax", "diffrax")}


def _names(derivatives: Any, value: bool) -> tuple[str, ...]:
    """The arguments along which ω∞ is differentiated."""
    names = names_of("derivatives", derivatives)
    if len(set(names)) < len(names):
        refuse("derivatives", "name each argument once", f"is {', '.join(names)}")
    if names and not value:
        refuse("value", "be True if there are derivatives of ω∞ to be found", "is False")
    return names
