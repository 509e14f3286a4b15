"""`dipoletop atlas`: how bodies end, over all shapes or over all dipoles."""

import sys
from typing import Any

import click
import numpy as np

from ..atlases import Atlas, Ending, atlas
from ..bodies import Body
from .files import FORMATS, output_paths
from .parameters import Numbers
from .refusals import Refusal, computing

WORDS = {
    Ending.RESIDUAL: "residual rotation",
    Ending.BOTH: "residual or stop, by the start",
    Ending.SPIN_1: "stop, spinning about J₁",
    Ending.SPIN_3: "stop, spinning about J₃",
    Ending.TUMBLING_LOW: "stop, tumbling about J₃",
    Ending.TUMBLING_HIGH: "stop, tumbling about J₁",
    Ending.STOPS: "either of two stops, by the start",
}
CODES = ", ".join(f"{int(ending)} {words}" for ending, words in WORDS.items())


@click.command("atlas", short_help="How bodies of every shape end.")
@click.option(
    "--dipole",
    "dipoles",
    type=click.Choice(["1", "2", "3"]),
    multiple=True,
    help="Principal axis with the dipole (J₁ ≤ J₂ ≤ J₃); may be given several times."
    "  [default: 1 2 3]",
)
@click.option(
    "--body",
    type=Numbers(),
    metavar="J1,J2,J3",
    help="Moments of inertia: map over all dipoles of this body instead.",
)
@click.option(
    "--size", type=click.IntRange(2), default=40, help="Cells along an edge of each triangle."
)
@click.option("--particles/--no-particles", default=True, help="Mark the particles of the paper.")
@click.option(
    "--output", default="dipoletop-atlas", help="Folder, or first part of the names of all files."
)
@click.option("--format", "suffix", type=FORMATS, help="Format of the picture.  [default: png]")
@click.option("--progress/--quiet", default=None, help="Progress bar.  [default: on a terminal]")
@computing
def atlas_command(**options: Any) -> None:
    """Map how weakly radiating bodies end, over all ratios of moments of inertia.

    Each map is one over a triangle, with the dipole on a principal axis; the needle, the disc and
    the sphere are its corners. Directions of L are isotropic. With --body the map is over the
    squares of the direction cosines of the dipole. This takes about two minutes.
    """
    from .. import plots

    base, picture = output_paths(options["output"], options["suffix"], "atlas")
    axes, moments = options["dipoles"] or ("1", "2", "3"), options["body"]
    if moments and options["dipoles"]:
        raise Refusal("--dipole and --body cannot both be given.")
    show = sys.stderr.isatty() if options["progress"] is None else options["progress"]
    settings = {"n": options["size"], "progress": show}
    if moments:
        body = Body(np.diag(moments), [1.0, 0.0, 0.0])
        maps = [atlas(body=body, **settings)]
    else:
        maps = [atlas(int(axis), **settings) for axis in dict.fromkeys(axes)]
    plots.save(plots.atlas(maps, particles=options["particles"]), picture)
    data = base.with_name(f"{base.name}.csv")
    columns = [each.columns() for each in maps]
    rows = np.concatenate([np.column_stack(list(each.values())) for each in columns])
    np.savetxt(data, rows, fmt="%.10g", delimiter=",", header=",".join(columns[0]), comments="")
    click.echo("\n\n".join(_table(each) for each in maps))
    click.echo(f"\nPicture: {picture}\nData: {data} (ending: {CODES})")


def _table(atlas: Atlas) -> str:
    """How often each ending occurs on a map."""
    if atlas.dipole_axis is None:
        j1, j2, _ = atlas.moments[0]
        lines = [f"Dipoles of the body with J₁/J₃ = {j1:.6g}, J₂/J₃ = {j2:.6g}, by n₁², n₂², n₃²"]
    else:
        lines = [f"Dipole on the axis of J{'₁₂₃'[atlas.dipole_axis - 1]}"]
    shares = np.bincount(atlas.ending, minlength=len(Ending)) / atlas.ratio.size
    lines += [f"  {WORDS[Ending(k)]:36}{share:8.2%}" for k, share in enumerate(shares) if share]
    if np.any(atlas.ratio > 0):
        mean, least, most = np.mean(atlas.ratio), np.min(atlas.ratio), np.max(atlas.ratio)
        lines.append(f"  {'mean L∞/L₀':36}{mean:8.3f}, from {least:.3f} to {most:.3f}")
    return "\n".join(lines)
