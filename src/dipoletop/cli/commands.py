"""The command line: `dipoletop map`, `simulate`, `figures`, `spectrum`, `validate`, `store`."""

import os
import sys
from pathlib import Path
from typing import Any

import click

from ..equations.levels import CONSISTENT, LACKS, Level
from .command import Command
from .command import computing as _computing
from .parameters import Number, Size
from .store_commands import store

FULL_TOO = click.Choice([level.value for level in Level])
LEVELS = click.Choice([level.value for level in Level if level is not Level.FULL])
NAMES = click.Choice(["delta", "w-perp", "w3", "phi", "amplitude", "theta"])
FORMATS = click.Choice(["png", "pdf", "svg"])
FIGURES = click.Choice(["1", "1-full", "2", "3", "spectra", "levels"])

TERMS = """\b
Quantities (dimensionless: ω = τ₀Ω and τ = t/τ₀, with τ₀ = 2d²/(3c³I₁) in Gaussian units):
  delta      δ = 1 − I₃/I₁, the shape: -1 a disc, 0 a sphere, towards 1 a needle
  w-perp     ω⊥, angular velocity across the symmetry axis
  w3         ω₃, angular velocity along the symmetry axis
  phi        φ, angle from the dipole to ω⊥, in radians; may be written pi/30
  amplitude  |ω|; with theta, the angle from the symmetry axis to ω, in place of
             w-perp and w3

\b
Levels of the equation of motion:
  order-1    the paper's reduced equation (4.2)-(4.4). For this top it lacks a leading
             term of the full equation: some outcomes, and its threshold at δ = -1/2,
             are not those of the full equation
  order-2 … order-4   the same reduction carried to higher order, without that defect
  semi       semi-reduced: only the second derivative of ω is replaced; without it too,
             and as cheap as order 1: for outcomes and maps
  full       the full equation along its physical branch (not for maps: slow)

\b
Outcomes: residual (ω → ω∞ ≠ 0, along the dipole), stop (ω → 0), undecided (out of
steps), failed (not a number). Certified: decided in a region that is proven to decide
for this level of the equation; how far the level is from the full equation is not in it."""


NUMBER = Number()
SHOWN = {"show_default": True, "help_option_names": ["-h", "--help"], "max_content_width": 100}


@click.group(epilog=TERMS, context_settings=SHOWN)
@click.version_option(package_name="dipoletop", message="%(prog)s %(version)s")
def main() -> None:
    """Rotation of a rigid electric dipole that radiates: does it keep rotating, or stop?"""


main.add_command(store)


def _quantities(run: Command) -> Command:
    """The options --delta, --w-perp, …."""
    usual = (
        "δ = 1 − I₃/I₁.  [default: -0.2]",
        "ω⊥, across the symmetry axis.  [default: 0.2]",
        "ω₃, along the symmetry axis.  [default: 0.2]",
        "φ, from the dipole to ω⊥.  [default: pi/30]",
        "|ω|, with --theta in place of w-perp and w3.  [default: 0.2]",
        "Angle from the symmetry axis to ω.  [default: pi/4]",
    )
    for name, text in reversed(list(zip(NAMES.choices, usual, strict=True))):
        run = click.option(f"--{name}", type=NUMBER, help=text)(run)
    return run


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: options[name.replace("-", "_")] for name in NAMES.choices}


def _files(output: str, suffix: str | None, name: str) -> tuple[Path, Path]:
    """The beginning of all file names, and the picture; in a folder they are called `name`."""
    base = Path(output)
    if output.endswith(("/", os.sep)) or base.is_dir():
        base = base / name
    if base.suffix[1:] in FORMATS.choices:
        suffix, base = suffix or base.suffix[1:], base.with_suffix("")
    base.parent.mkdir(parents=True, exist_ok=True)
    return base, base.with_name(f"{base.name}.{suffix or 'png'}")


@main.command("map", epilog=TERMS, short_help="Which starts keep rotating and which stop.")
@click.option(
    "--level",
    type=LEVELS,
    metavar="LEVEL",
    multiple=True,
    default=("order-1", "semi"),
    help="Level of the equation; give two to compare them.",
)
@click.option(
    "--x",
    type=NAMES,
    metavar="AXIS",
    default="phi",
    help="Horizontal axis; phi always, in comparisons.",
)
@click.option("--y", type=NAMES, metavar="AXIS", default="w3", help="Vertical axis.")
@click.option(
    "--range",
    "ranges",
    type=(NAMES, NUMBER, NUMBER),
    multiple=True,
    metavar="AXIS LOW HIGH",
    help="Range of an axis; one for each, if wanted.",
)
@_quantities
@click.option("--size", type=Size(), metavar="N[xM]", default="512", help="Starts on x [and on y].")
@click.option("--rtol", type=NUMBER, default="1e-8", help="Relative tolerance of every step.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Budget of each run.")
@click.option(
    "--confirm", type=NUMBER, metavar="RTOL", help="Run all again at this tolerance and compare."
)
@click.option("--device", type=click.Choice(["cpu", "gpu"]), help="[default: all there is]")
@click.option(
    "--engine",
    type=click.Choice(["auto", "jax", "native"]),
    default="auto",
    help="native is machine code (it needs numba), auto the fastest that can run.",
)
@click.option(
    "--output", default="dipoletop-map", help="Folder, or beginning of the names of all files."
)
@click.option("--format", "suffix", type=FORMATS, help="Of the picture.  [default: png]")
@click.option(
    "--store/--no-store",
    default=True,
    help="Keep the data, in OUTPUT-LEVEL.zarr; the same command goes on where it was stopped.",
)
@click.option("--repair", is_flag=True, help="Compute damaged data of the store again.")
@click.option("--progress/--quiet", default=None, help="Progress bar.  [default: on a terminal]")
@_computing
def map_(**options: Any) -> None:
    """Map which starts keep rotating and which stop, over any two quantities.

    Without options: outcome and ω∞ over φ and ω₃, at δ = -0.2 and ω⊥ = 0.2, by the paper's
    equation (order 1) and by the semi-reduced one, with the starts hatched whose outcome differs.
    """
    from . import maps as _mapping

    levels, axes = options["level"], (options["x"], options["y"])
    if len(set(levels)) != len(levels) or len(levels) > 2:
        raise ValueError("--level must be one level, or two different ones.")
    ranges = {name: (low, high) for name, low, high in options["ranges"]}
    grid, text = _mapping.make_grid(_given(options), axes, ranges, options["size"])
    base, picture = _files(options["output"], options["suffix"], "map")
    settings = {
        name: options[name] for name in ("rtol", "max_steps", "confirm", "engine", "repair")
    }
    settings["devices"] = _devices(options["device"])
    show = sys.stderr.isatty() if options["progress"] is None else options["progress"]
    click.echo(f"{text}.")
    runs = []
    try:
        for level in levels:
            store = base.with_name(f"{base.name}-{level}.zarr") if options["store"] else None
            progress = level if show else False
            run = _mapping.run_level(level, grid, store, progress=progress, **settings)
            runs.append(run)
    except KeyboardInterrupt:
        kept = "finished tiles are kept, and the same command goes on from there"
        nothing = "nothing is kept without a store"
        click.echo(f"Stopped: {kept if options['store'] else nothing}.", err=True)
        raise SystemExit(130) from None
    _draw([run.basin for run in runs], axes, picture)
    click.echo(_mapping.report(runs))
    if levels == ("order-1",):
        click.echo(f"{LACKS}; outcomes may differ at the consistent levels (--level semi).")
    click.echo(f"Picture: {picture}")
    for run in runs:
        if run.store:
            click.echo(f"Data: {run.store} (dipoletop.Basin.load reads it)")


def _devices(kind: str | None) -> Any:
    import jax

    try:
        return kind and jax.devices(kind)
    except RuntimeError:
        raise ValueError(f"--device {kind}: JAX finds none on this machine.") from None


def _draw(basins: list[Any], axes: tuple[str, str], picture: Path) -> None:
    from .. import plots

    if len(basins) == 2:
        figure: Any = plots.compare(*basins)
    else:
        x, y = (name.replace("-", "_") for name in axes)
        figure = plots.basin(basins[0], x=x, y=y).figure
    figure.savefig(picture, dpi=150)


@main.command(epilog=TERMS, short_help="One top: its motion and its end.")
@click.option(
    "--level",
    type=FULL_TOO,
    metavar="LEVEL",
    default=CONSISTENT.value,
    help="Level of the equation; order-1 is the paper's.",
)
@_quantities
@click.option("--tau-max", type=NUMBER, default="1000", help="End of the run.")
@click.option("--points", type=click.IntRange(2), default=1001, help="Times in picture and table.")
@click.option("--rtol", type=NUMBER, default="1e-10", help="Relative tolerance.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Budget of the run.")
@click.option(
    "--output", default="dipoletop-trajectory", help="Folder, or beginning of the file names."
)
@click.option("--format", "suffix", type=FORMATS, help="Of the picture.  [default: png]")
@_computing
def simulate(**options: Any) -> None:
    """Follow one top, and say how it ends.

    Without options: the start of figure 2a of the paper (δ = -1/5, ω⊥ = ω₃ = 1/5, φ = π/30) by
    the semi-reduced equation; with --level order-1 the paper's own curves.
    """
    import numpy as np

    from .. import plots
    from .._runs.classify import classify
    from .._runs.simulate import simulate
    from ..equations.transverse import equation_at
    from . import maps as _mapping
    from . import run_report as _run_report

    if options["tau_max"] <= 0:
        raise ValueError(f"--tau-max must be positive, but is {options['tau_max']:g}.")
    at = _mapping.quantities(_given(options))
    equation, start = equation_at(options["level"], at["delta"]), _mapping.start(at)
    settings = {name: options[name] for name in ("rtol", "max_steps")}
    times = np.linspace(0.0, options["tau_max"], options["points"])
    trajectory = simulate(equation, start, times, throw=False, **settings)
    base, picture = _files(options["output"], options["suffix"], "trajectory")
    table = base.with_name(f"{base.name}.csv")
    rows = np.column_stack([trajectory.ts, trajectory.omega, trajectory.energy, trajectory.power])
    if not np.all(np.isfinite(rows)):
        steps, most = trajectory.stats["num_steps"], options["max_steps"]
        raise ValueError(
            f"The run did not reach τ = {options['tau_max']:g}: "
            f"it ended after {steps} steps of at most {most}."
        )
    header = "tau,omega_1,omega_2,omega_3,energy,power"
    np.savetxt(table, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    figure: Any = plots.trajectory(trajectory).figure
    figure.savefig(picture, dpi=150)
    click.echo(f"{_mapping.describe(at)}. Level: {equation.level}.")
    click.echo(_run_report.states(rows))
    click.echo(_run_report.ending(classify(equation, start, **settings)))
    if options["level"] == "order-1":
        click.echo(_run_report.by_consistent(at["delta"], start, settings))
    click.echo(f"Picture: {picture}\nData: {table}")


@main.command(short_help="The figures of the paper, and three more.")
@click.argument("names", type=FIGURES, metavar="[NAME]...", nargs=-1)
@click.option("--output", default="dipoletop-figures", help="Folder of the figures.")
@click.option(
    "--format",
    "suffixes",
    type=FORMATS,
    multiple=True,
    default=("pdf", "png"),
    help="Of the figures; may be given several times.",
)
@_computing
def figures(**options: Any) -> None:
    r"""Compute and draw the figures of the paper, and three that it does not have.

    \b
    1        which ends are possible for which shape δ, at order 1
    1-full   the same by the semi-reduced and the full equation
    2        ω₁, ω₂, ω₃ against τ: a residual rotation and a stop, order 1 and full
    3        phase plane of the plane rotator, with its runaways
    spectra  how motions beside a residual rotation decay, at every level
    levels   which starts end otherwise at another level

    Without names: all of them, in about two minutes.
    """
    from ..paper import figures

    folder = Path(options["output"])
    folder.mkdir(parents=True, exist_ok=True)
    for name in dict.fromkeys(options["names"] or FIGURES.choices):
        figure = figures.FIGURES[name]()
        for suffix in dict.fromkeys(options["suffixes"]):
            path = folder / f"figure-{name}.{suffix}"
            figures.save(figure, path)
            click.echo(f"Figure: {path}")


@main.command(epilog=TERMS, short_help="How motions beside a residual rotation decay.")
@click.option("--delta", type=NUMBER, default=-0.2, help="δ = 1 − I₃/I₁.")
@click.option("-w", "--w", type=NUMBER, default=0.1, help="ω of the residual rotation.")
@click.option(
    "--level",
    type=FULL_TOO,
    metavar="LEVEL",
    multiple=True,
    default=("order-1", "semi", "full"),
    help="Level of the equation; may be given several times.",
)
@_computing
def spectrum(delta: float, w: float, level: tuple[str, ...]) -> None:
    """Eigenvalues at ω = (w, 0, 0), rotation about the dipole, in units of 1/τ₀.

    The slow ones belong to physical motions, those of runaways to the full equation only.
    """
    from ..equations.transverse import equation_at
    from . import tables as _reports

    for line in _reports.spectra([equation_at(name, delta) for name in level], w):
        click.echo(line)
    if set(level) == {"order-1"}:
        consistent = equation_at(CONSISTENT, delta)
        first, slow, *_ = _reports.spectra([consistent], w)
        click.echo(f"{LACKS}; {first}, {' '.join(slow.split())}.")


@main.command(short_help="Check this installation against exact values.")
@click.option(
    "--paper",
    is_flag=True,
    help="Try every equation, claim, figure and number of the paper instead: which are "
    "confirmed, which corrected, and the residuals. Takes about two minutes.",
)
@_computing
def validate(paper: bool) -> None:
    """Check this installation against exact solutions, identities and reference digits.

    Takes under a minute; the exit status is 1 if a check fails.
    """
    from .. import validation
    from . import tables as _reports

    click.echo(validation.environment())
    failed = 0
    for line, good in _reports.paper() if paper else _reports.checks():
        click.echo(line)
        failed += not good
    click.echo(f"{failed} failed." if failed else "All passed.")
    raise SystemExit(1 if failed else 0)
