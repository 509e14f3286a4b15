"""`dipoletop store`: verify the data of a sweep on disk, and recompute what is damaged."""

import sys

import click

from .._maps.store.errors import StoreDamaged
from .._maps.store.saved_basins import verify
from . import maps
from .interruption import interruptible
from .refusals import computing


@click.group("store", short_help="Verify and repair the data of a sweep.")
def store() -> None:
    """Verify and repair the data that `dipoletop map` and `dipoletop.sweep` keep in a folder."""


@store.command("verify", short_help="Check that the data are what was written.")
@click.argument("path")
@computing
def verify_command(path: str) -> None:
    """Read all data of the store PATH and list the tiles that are damaged.

    The exit status is 1 if there is damage. A tile that a sweep has not computed yet is not
    damaged; the same sweep computes it when it is resumed.
    """
    try:
        report = verify(path)
    except StoreDamaged as error:
        click.echo(str(error))
        raise SystemExit(1) from None
    for tile, reason in report.damaged.items():
        click.echo(f"tile {tile}: {reason}")
    left = f", {len(report.unfinished)} not computed yet" if report.unfinished else ""
    click.echo(f"{len(report.damaged)} of {report.tiles} tiles damaged{left}.")
    raise SystemExit(1 if report.damaged else 0)


@store.command("repair", short_help="Recompute damaged tiles of a map.")
@click.argument("path")
@click.option("--progress/--quiet", default=None, help="Progress bar.  [default: on a terminal]")
@computing
def repair_command(path: str, progress: bool | None) -> None:
    """Recompute the damaged and the missing tiles of a map.

    PATH is the store of one level, as `dipoletop map` names it. If its metadata are sound, it holds
    all that is needed. If they are damaged, `dipoletop map --repair` with the options of the map
    writes them anew. The store of another sweep is repaired by that sweep: dt.sweep(...,
    repair=True).
    """
    show = sys.stderr.isatty() if progress is None else progress
    with interruptible(keeps_tiles=True):
        run, computed = maps.repair(path, progress=show)
    click.echo(f"{computed} starts computed again: {run.store} is as it was written.")
