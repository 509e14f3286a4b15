"""`dipoletop info`, `plot` and `export`: what is in a store, while its sweep runs or after."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from .._maps.basin import Basin
from .._maps.columns import VERSION, without_versions
from .._maps.grids import counted, described_axis
from .._maps.store.status import Status, status
from .._maps.tally_results import Tally
from .files import FORMATS, output_paths
from .parameters import Number
from .refusals import Refusal, computing

NUMBER = Number()
AT = click.option(
    "--at",
    type=(str, NUMBER),
    multiple=True,
    metavar="AXIS VALUE",
    help="Fix an axis at the value nearest to this; may be given for several axes.",
)


@click.command("info", short_help="What is in a store, and how far its sweep is.")
@click.argument("path")
@computing
def info_command(path: str) -> None:
    """Say what the sweep of the store PATH is, how far it is, how fast it goes, and its digests."""
    found = status(path)
    if "tally" in found.header:
        tally = Tally.load(path, unfinished=True)
        shares: Any = tally.merged.fractions()
        kept = f"; counted by {', '.join(tally.dims)}" if tally.dims else ""
        described = _Described(tally.coords, f"{counted((tally.size,))}{kept}", shares)
        names = ["counts of outcomes", *(f"histogram of {name}" for name in tally.reduction.edges)]
    else:
        basin = Basin.load(path, unfinished=True)
        size = "" if basin.coords else f"{', '.join(basin.dims)}; "
        described = _Described(basin.coords, f"{size}{counted(basin.shape)}", basin.fractions())
        names = list(basin.columns)
    for line in _lines(found, described, names):
        click.echo(line)


class _Described(NamedTuple):
    """What a store holds."""

    coords: Mapping[str, Any]
    size: str
    shares: Mapping[str, Any]


def _lines(found: Status, described: _Described, names: list[str]) -> list[str]:
    header, attrs = found.header, found.header["attrs"]
    plain = without_versions(attrs)
    settings = (f"{name} {value}" for name, value in plain.items() if name != "level")
    versions = (
        f"{name.removeprefix(VERSION)} {value}"
        for name, value in attrs.items()
        if name not in plain
    )
    axes = ", ".join(described_axis(*axis) for axis in described.coords.items())
    shares = ", ".join(f"{name} {x.share:.2%}" for name, x in described.shares.items())
    lines = [
        f"Level     {attrs.get('level', 'not known')}",
        f"Settings  {', '.join(settings)}",
        f"Over      {axes}{'; ' if axes else ''}{described.size}",
        f"Tiles     {found.finished} of {found.tiles} finished, {found.starts_done} starts "
        f"({found.starts_done / found.starts:.1%}); {found.bytes / 1e6:.3g} MB on disk",
    ]
    if shares:
        lines.append(f"Outcomes  {shares}")
    if found.rate:
        speed = f"{found.rate:,.0f} starts per second over the last tiles, pauses included"
        if found.finished < found.tiles:
            speed += f"; {duration(found.seconds_left or 0.0)} left at this rate"
        lines.append(f"Speed     {speed}")
    lines.append(f"Work      {'a process is at it' if found.at_work else 'no process is at it'}")
    lines.append(f"Versions  {', '.join(versions)}")
    for name, digest in header.get("programs", {}).items():
        lines.append(f"Digest    {digest} of the {name}")
    return [*lines, f"Format    {header['format']}, {', '.join(names)}"]


def duration(seconds: float) -> str:
    """A time in the largest units that it fills."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 360_000 else f"{seconds / 86400:.1f} days"


@click.command("plot", short_help="A picture of the data in a store.")
@click.argument("path")
@click.option("--x", metavar="AXIS", help="Horizontal axis.  [default: phi, or the last]")
@click.option("--y", metavar="AXIS", help="Vertical axis.  [default: the other one]")
@AT
@click.option("--panels", metavar="AXIS", help="Draw a panel for each value on this axis.")
@click.option(
    "--average", is_flag=True, help="Draw the share of residual rotations over all other axes."
)
@click.option(
    "--shade",
    metavar="COLUMN",
    default="omega_inf",
    help="What shades the outcomes: omega_inf, omega_inf_error, time, steps, probability, "
    "certified, a derivative such as d_omega_inf_d_delta, or none.",
)
@click.option("--output", default="dipoletop-plot", help="Folder, or first part of the file name.")
@click.option("--format", "suffix", type=FORMATS, help="Format of the picture.  [default: png]")
@computing
def plot_command(path: str, **options: Any) -> None:
    """Draw the basin in the store PATH over any two of its axes, while its sweep runs or after.

    Other axes are fixed (--at), averaged (--average) or drawn as panels (--panels). What is not
    computed yet is hatched.
    """
    from .. import plots

    basin = _part(path, options["at"])
    shade = None if options["shade"] == "none" else options["shade"]
    x, y = (options[name] and _axis(options[name]) for name in ("x", "y"))
    _, picture = output_paths(options["output"], options["suffix"], "plot")
    if options["average"]:
        if x is None or y is None:
            raise Refusal("--average needs --x and --y, the axes that are not averaged over.")
        figure: Any = plots.shares(basin, x, y).figure
    elif options["panels"]:
        panels = _axis(options["panels"])
        figure = plots.basin(basin, shade=shade, x=x, y=y, panels=panels)[0].figure
    elif not basin.coords:
        figure = plots.starts(basin, x or "phi", y or "cos_theta", shade=shade).figure
    elif sum(n > 1 for n in basin.shape) == 1:
        figure = plots.line(basin, options["shade"]).figure
    else:
        figure = plots.basin(basin, shade=shade, x=x, y=y).figure
    figure.savefig(picture, dpi=150)
    click.echo(f"Picture: {picture}")


@click.command("export", short_help="Data of a store as NetCDF, Parquet or CSV.")
@click.argument("path")
@click.argument("target")
@AT
@click.option(
    "--range",
    "ranges",
    type=(str, NUMBER, NUMBER),
    multiple=True,
    metavar="AXIS LOW HIGH",
    help="Only values in this range; may be given for several axes.",
)
@click.option(
    "--column", "columns", multiple=True, metavar="NAME", help="Only this column, and so on."
)
@computing
def export_command(path: str, target: str, **options: Any) -> None:
    """Write what is in the store PATH to the file TARGET: .nc (NetCDF), .parquet or .csv.

    NetCDF keeps the grid, its labels and units. The tables have a row for each start.
    """
    write = WRITERS.get(Path(target).suffix)
    if write is None:
        raise Refusal(f"{target} must end with {', '.join(WRITERS)}, which tells the format.")
    basin = _part(path, options["at"], options["ranges"])
    data = basin.to_xarray()
    names = [str(name) for name in data.data_vars]
    if unknown := [name for name in options["columns"] if name not in names]:
        raise Refusal(f"--column {unknown[0]}: the columns are {', '.join(names)}.")
    if options["columns"]:
        data = data.drop_vars([name for name in names if name not in options["columns"]])
    write(data, basin.dims, Path(target))
    click.echo(f"Data: {target} ({counted(basin.shape)}, {', '.join(options['columns'] or names)})")


def _part(path: str, at: Any, ranges: Any = ()) -> Basin:
    """What is chosen of the basin in a store, whether it is finished or not."""
    basin = Basin.load(path, unfinished=True)
    if at:
        basin = basin.sel(method="nearest", **{_axis(name): value for name, value in at})
    within: dict[str, Any] = {_axis(name): slice(low, high) for name, low, high in ranges}
    return basin.sel(**within) if within else basin


def _axis(name: str) -> str:
    """An axis as `dipoletop map` spells it, or as the data do."""
    return name.replace("-", "_")


def _to_netcdf(data: Any, dims: tuple[str, ...], target: Path) -> None:
    data.to_netcdf(target, engine="scipy")


def _to_parquet(data: Any, dims: tuple[str, ...], target: Path) -> None:
    try:
        _table(data, dims).to_parquet(target)
    except ImportError:
        raise Refusal("Parquet needs pyarrow: pip install pyarrow.") from None


def _to_csv(data: Any, dims: tuple[str, ...], target: Path) -> None:
    # 17 digits give every number back exactly.
    _table(data, dims).to_csv(target, index=False, float_format="%.17g")


def _table(data: Any, dims: tuple[str, ...]) -> Any:
    """A row for each start; components have columns of their own."""
    for name in [*data.data_vars, *data.coords]:
        behind = [dim for dim in data[name].dims if dim not in dims]
        if behind:
            values = data[name].values
            kept = data[name].dims[: -len(behind)]
            flat = values.reshape(*values.shape[: len(kept)], -1)
            parts = {f"{name}_{k + 1}": (kept, flat[..., k]) for k in range(flat.shape[-1])}
            data = data.drop_vars(name).assign(parts)
    return data.to_dataframe().reset_index()


WRITERS = {".nc": _to_netcdf, ".parquet": _to_parquet, ".csv": _to_csv}
