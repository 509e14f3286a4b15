"""`dipoletop info`, `plot`, `export` and `store`: what is in a store, and whether it is sound."""

import contextlib
import functools
import os
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .._base.refusals import refuse
from .._maps.store.errors import StoreDamaged
from .._maps.top_parameters import CYLINDRICAL, SPHERICAL
from ..equations.levels import Level
from .options import (
    NUMBER,
    make_folder,
    name_of,
    output_paths,
    picture_options,
    progress_option,
    range_option,
    saved,
)
from .running import Refusal, computing, interruptible, plain_reason, say

if TYPE_CHECKING:
    from .._maps.basin import Basin

RECENT = 100  # tiles from which the speed of a sweep is found
path_argument = click.argument("path")
at_option = click.option(
    "--at",
    type=(str, NUMBER),
    multiple=True,
    metavar="AXIS VALUE",
    help="Fix an axis at the value nearest to this; may be given for several axes.",
)
SHADE = """What shades the outcomes: omega_inf, omega_inf_error, time, steps, probability,
certified, a derivative such as d_omega_inf_d_delta, or none."""


@click.command("info")
@path_argument
@computing
def info_command(path: str) -> None:
    """Say what the sweep of the store PATH is, how far it is, how fast it goes, and its digests."""
    from .._base.summaries import duration
    from .._maps.basin import Basin
    from .._maps.columns import VERSION, without_versions
    from .._maps.store.layout import tiling_of_starts
    from .._maps.store.tiles import open_store
    from .._maps.tally_results import Tally

    tiles = open_store(path)
    header, attrs = tiles.header, tiles.header["attrs"]
    starts, finished = tiling_of_starts(header), tiles.finished()
    done = sum(map(starts.length, finished))
    say(repr((Tally if "tally" in header else Basin).load(path, unfinished=True)))
    plain = without_versions(attrs)
    settings = (f"{name} {value}" for name, value in plain.items() if name != "level")
    say(f"Settings  {', '.join(settings)}")
    bytes_on_disk = sum(file.stat().st_size for file in tiles.folder.rglob("*") if file.is_file())
    size = f"{done} starts ({done / starts.size:.1%}); {bytes_on_disk / 1e6:.3g} MB on disk"
    say(f"Tiles     {len(finished)} of {starts.count} finished, {size}")
    times = sorted((tiles.written_at(tile), tile) for tile in finished)[-RECENT:]
    if times and (seconds := times[-1][0] - times[0][0]):
        rate = sum(starts.length(tile) for _, tile in times[1:]) / seconds
        left = f"; {duration((starts.size - done) / rate)} left at this rate"
        pauses = f"over the last tiles, pauses included{left if done < starts.size else ''}"
        say(f"Speed     {rate:,.0f} starts per second {pauses}")
    say(f"Work      {'a process is at it' if tiles.is_claimed() else 'no process is at it'}")
    versions = (name.removeprefix(VERSION) for name in attrs if name not in plain)
    say(f"Versions  {', '.join(f'{name} {attrs[VERSION + name]}' for name in versions)}")
    for name, digest in header.get("programs", {}).items():
        say(f"Digest    {digest} of the {name}")
    say(f"Format    {header['format']}, {', '.join(header['columns'])}")


@click.command("plot")
@path_argument
@click.option("--x", metavar="AXIS", help="Horizontal axis.  [default: phi, or the last]")
@click.option("--y", metavar="AXIS", help="Vertical axis.  [default: the other one]")
@at_option
@click.option("--panels", metavar="AXIS", help="Draw a panel for each value on this axis.")
@click.option(
    "--average", is_flag=True, help="Draw the share of residual rotations over all other axes."
)
@click.option("--shade", metavar="COLUMN", default="omega_inf", help=SHADE)
@picture_options("plot")
@computing
def plot_command(path: str, **options: Any) -> None:
    """Draw the basin in the store PATH over any two of its axes, while its sweep runs or after.

    Other axes are fixed (--at), averaged (--average) or drawn as panels (--panels). What is not
    computed yet is hatched.
    """
    from .. import plots

    basin = _part(path, options["at"])
    shade = None if options["shade"] == "none" else options["shade"]
    x, y = (options[name] and name_of(options[name]) for name in ("x", "y"))
    _, picture = output_paths(options, "plot")
    if options["average"]:
        if x is None or y is None:
            raise Refusal("--average needs --x and --y, the axes that are not averaged over.")
        drawn: Any = plots.shares(basin, x, y)
    elif options["panels"]:
        panels = name_of(options["panels"])
        drawn = plots.basin(basin, shade=shade, x=x, y=y, panels=panels)[0]
    elif not basin.coords:
        drawn = plots.starts(basin, x or "phi", y or "cos_theta", shade=shade)
    elif sum(n > 1 for n in basin.shape) == 1:
        drawn = plots.line(basin, options["shade"])
    else:
        drawn = plots.basin(basin, shade=shade, x=x, y=y)
    saved("Picture", picture, functools.partial(plots.save, drawn, dpi=150))


@click.command("export")
@path_argument
@click.argument("target")
@at_option
@range_option("Only values in this range; may be given for several axes.", str)
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME",
    help="Only this column; may be given several times.",
)
@computing
def export_command(path: str, target: str, **options: Any) -> None:
    """Write what is in the store PATH to the file TARGET: .nc (NetCDF), .parquet or .csv.

    NetCDF keeps the grid, its labels and units. The tables have a row for each start.
    """
    from .._base.tables import rows_of
    from .._maps.columns import LEVEL
    from .._maps.grids import counted

    suffix, formats = Path(target).suffix, (".nc", ".parquet", ".csv")
    if suffix not in formats:
        raise Refusal(f"{target} must end with {', '.join(formats)}, which tells the format.")
    basin = _part(path, options["at"], options["ranges"])
    data = basin.to_xarray()
    if suffix != ".nc":
        data = data.drop_vars(LEVEL, errors="ignore")  # the same in every row
    names = [str(name) for name in data.data_vars]
    if unknown := [name for name in options["columns"] if name not in names]:
        raise Refusal(f"--column {unknown[0]}: the columns are {', '.join(names)}.")
    kept = options["columns"] or names
    data = data.drop_vars([name for name in names if name not in kept])
    make_folder(Path(target).absolute().parent, target)

    def write(path: Path) -> None:
        with _replaced(path) as part:
            if suffix == ".nc":
                _write_netcdf(data, part)
            elif suffix == ".csv":
                # 17 digits give every number back exactly.
                rows_of(data, basin.dims).to_csv(part, index=False, float_format="%.17g")
            else:
                try:
                    rows_of(data, basin.dims).to_parquet(part)
                except ImportError:
                    needs = "Parquet needs pyarrow: pip install 'dipoletop[parquet]'."
                    raise Refusal(needs) from None

    saved("Data", Path(target), write, f"{counted(basin.shape)}, {', '.join(kept)}")


@contextlib.contextmanager
def _replaced(target: Path) -> Iterator[Path]:
    """A file beside the target, which replaces it once it is complete."""
    try:
        with tempfile.TemporaryDirectory(prefix=".", dir=target.absolute().parent) as beside:
            yield Path(beside) / target.name
            os.replace(Path(beside) / target.name, target)
    except OSError as error:
        raise Refusal(f"{target} cannot be written ({plain_reason(error)}).") from None


def _write_netcdf(data: Any, file: Path) -> None:
    """Write NetCDF 3, whose names are ASCII; other names need NetCDF 4."""
    names = [str(name) for name in (*data.variables, *data.dims)]
    if all(name.isascii() for name in names):
        data.to_netcdf(file, engine="scipy")
    elif find_spec("h5netcdf") and find_spec("h5py"):
        data.to_netcdf(file, engine="h5netcdf")
    else:
        other = next(name for name in names if not name.isascii())
        raise Refusal(f"NetCDF with the name {other} needs h5netcdf: pip install h5netcdf h5py.")


def _part(path: str, at: Any, ranges: Any = ()) -> "Basin":
    """What is chosen of the basin in a store, whether it is finished or not."""
    from .._maps.basin import Basin

    basin = Basin.load(path, unfinished=True)
    nearest: dict[str, Any] = {name_of(axis): value for axis, value in at}
    within: dict[str, Any] = {name_of(axis): slice(*ends) for axis, *ends in ranges}
    basin = basin.sel(method="nearest", **nearest) if nearest else basin
    return basin.sel(**within) if within else basin


@click.group("store")
def store_command() -> None:
    """Verify and repair the data that `dipoletop map` and `dipoletop.sweep` keep in a folder."""


@store_command.command("verify", short_help="Check that the data are what was written.")
@path_argument
@computing
def verify_command(path: str) -> None:
    """Read all data of the store PATH and list the tiles that are damaged.

    The exit status is 1 if there is damage. A tile that a sweep has not computed yet is not
    damaged; the same sweep computes it when it is resumed.
    """
    from .._maps.store.saved_basins import verify

    try:
        report = verify(path)
    except StoreDamaged as error:
        say(error)
        raise SystemExit(1) from None
    for tile, reason in report.damaged.items():
        say(f"tile {tile}: {reason}")
    left = f", {len(report.unfinished)} not computed yet" if report.unfinished else ""
    say(f"{len(report.damaged)} of {report.tiles} tiles damaged{left}.")
    raise SystemExit(1 if report.damaged else 0)


@store_command.command("repair", short_help="Recompute damaged tiles of a map.")
@path_argument
@progress_option
@computing
def repair_command(path: str, progress: bool) -> None:
    """Recompute the damaged and the missing tiles of a map.

    PATH is the store of one level, as `dipoletop map` names it. If its metadata are sound, it holds
    all that is needed. If they are damaged, `dipoletop map --repair` with the options of the map
    writes them anew. The store of another sweep is repaired by that sweep: dt.sweep(...,
    repair=True).
    """
    from .._maps.grids import Grid
    from .._maps.store.saved_basins import verify
    from .._maps.store.tiles import open_store
    from .map_run import run_level

    with interruptible(keeps_tiles=True):
        report, tiles = verify(path), open_store(path)
        attrs, axes = tiles.header["attrs"], tiles.header["axes"]
        level = next((level for level in Level if level.label == attrs["level"]), None)
        maps = [{"delta", "phi", *ways} for ways in (CYLINDRICAL, SPHERICAL)]
        if level is None or set(axes) not in maps:
            must = "be the store of a `dipoletop map`"
            refuse("path", must, f"{path} is of another sweep, which repairs it with `repair=True`")
        settings = {name: attrs.get(name) for name in ("rtol", "max_steps", "confirm", "engine")}
        settings |= {"slow_flow": attrs.get("slow_flow", False), "repair": True}
        settings["progress"] = level.value if progress else False
        grid = Grid(**{name: tiles.values(name) for name in axes})
        run_level(level, grid, tiles.folder, **settings)
    computed = sum(tiles.tiling.length(tile) for tile in (*report.unfinished, *report.damaged))
    say(f"{computed} starts computed again: {tiles.folder} is as it was written.")
