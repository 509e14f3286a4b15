"""`dipoletop map`: which starts keep rotating and which stop."""

import functools
from typing import Any

import click

from ..equations.levels import Level
from .options import (
    AXIS,
    DURATION,
    MAP_LEVEL,
    NUMBER,
    SIZE,
    TERMS,
    grid_over,
    levels_option,
    name_of,
    output_paths,
    picture_options,
    progress_option,
    quantity_options,
    range_option,
    saved,
)
from .running import Refusal, computing, interruptible, say

SLOW_FLOW: dict[str, Any] = {"auto": "auto", "on": True, "off": False}
SLOW = """Predict by the average over free rotation: runs beyond --max-steps (auto), all that the
first state does not decide (on), none (off)."""
ENGINE = """auto runs native (machine code; needs llvmlite) where it can, else jax. Machine code is
kept in your cache folder, ~/.cache/dipoletop on Linux, unless DIPOLETOP_CACHE=off."""
TIME_LIMIT = """Stop after this time, such as 90s, 30m, 2h or 1:30:00, with exit status 124;
finished tiles are kept."""


@click.command("map", epilog=TERMS)
@levels_option(MAP_LEVEL, ("order-1", "semi"), "Level of the equation; give two to compare them.")
@click.option("--x", type=AXIS, metavar="AXIS", default="phi", help="Horizontal axis.")
@click.option("--y", type=AXIS, metavar="AXIS", default="w3", help="Vertical axis.")
@range_option("Range of an axis; may be repeated.")
@quantity_options
@click.option("--size", type=SIZE, metavar="N[xM]", default="512", help="Starts on x [and on y].")
@click.option("--rtol", type=NUMBER, default="1e-8", help="Relative tolerance of every step.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Most steps of a run.")
@click.option("--slow-flow", type=click.Choice(list(SLOW_FLOW)), default="auto", help=SLOW)
@click.option(
    "--confirm", type=NUMBER, metavar="RTOL", help="Run all again at this tolerance, and compare."
)
@click.option(
    "--device", type=click.Choice(["cpu", "gpu"]), help="Kind of devices.  [default: all]"
)
@click.option("--engine", type=click.Choice(["auto", "jax", "native"]), default="auto", help=ENGINE)
@picture_options("map")
@click.option(
    "--store/--no-store",
    default=True,
    help="Keep the data in OUTPUT-LEVEL.zarr; the same command resumes a stopped sweep.",
)
@click.option("--repair", is_flag=True, help="Recompute damaged data of the store.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute on the workers of a Dask scheduler, such as tcp://host:8786 (needs dask).",
)
@click.option("--time-limit", type=DURATION, help=TIME_LIMIT)
@progress_option
@computing
def map_command(**options: Any) -> None:
    """Map which starts keep rotating and which stop, over any two quantities.

    Without options: outcome and ω∞ over φ and ω₃, at δ = -0.2 and ω⊥ = 0.2, by the paper's
    equation (order 1) and by the semi-reduced one. Starts whose outcomes differ are hatched. A run
    ends as soon as its outcome and ω∞ are certain.
    """
    from .. import plots
    from .map_run import cluster_client, devices_of, lines_of, remarks_on, run_level

    levels, keep = list(map(Level, options["level"])), options["store"]
    if len(set(levels)) != len(levels) or len(levels) > 2:
        raise Refusal("--level must be one level, or two different ones.")
    axes = x, y = name_of(options["x"]), name_of(options["y"])
    ranges = {name_of(word): ends for word, *ends in options["ranges"]}
    grid, text = grid_over(axes, ranges, options["size"], options)
    base, picture = output_paths(options, "map")
    names = "rtol", "max_steps", "confirm", "engine", "repair"
    settings = {name: options[name] for name in names}
    settings["slow_flow"] = SLOW_FLOW[options["slow_flow"]]
    settings["devices"] = devices_of(options["device"])
    say(f"{text}.")
    runs = []
    with (
        interruptible(keeps_tiles=keep, time_limit=options["time_limit"]),
        cluster_client(options["scheduler"], keep) as settings["client"],
    ):
        for level in levels:
            place = base.with_name(f"{base.name}-{level}.zarr") if keep else None
            shown = level.value if options["progress"] else False
            runs.append(run_level(level, grid, place, progress=shown, **settings))
    basins = [run.basin for run in runs]
    if len(basins) == 2:
        drawn: Any = plots.compare(*basins, x=x, y=y)
    else:
        drawn = plots.basin(basins[0], x=x, y=y)
    for run in runs:
        say("\n  ".join(lines_of(run)))
    for line in remarks_on(basins):
        say(line)
    if levels == [Level.ORDER_1]:
        others = "outcomes may differ at the consistent levels (--level semi)"
        say(f"{Level.ORDER_1.caveat}; {others}.")
    saved("Picture", picture, functools.partial(plots.save, drawn, dpi=150))
    for run in runs:
        if run.store:
            say(f"Data: {run.store} (dipoletop.Basin.load reads it)")
