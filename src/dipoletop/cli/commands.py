"""The command line: `dipoletop map`, `simulate`, `predict`, `atlas`, `figures`, …."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import jax
import jax.numpy as jnp
import numpy as np

from .. import stability, validation
from .._maps.basin import Basin
from .._maps.top_parameters import QUANTITIES, describe, initial_condition
from .._runs.classify import classify
from .._runs.simulate import simulate
from .._runs.slow_runs import SlowFlow
from ..equations.levels import Level
from ..equations.transverse import equation_at
from . import maps, quantities, tables
from .atlas_command import atlas_command
from .clusters import cluster_client
from .data_commands import export_command, info_command, plot_command
from .explore_command import explore_command
from .files import FORMATS, check_output, make_folder, output_paths
from .interruption import interruptible
from .parameters import Duration, Number, Size
from .predict_command import predict_command
from .refusals import Refusal, computing
from .store_commands import store

NUMBER = Number()
AXIS = click.Choice(list(quantities.OPTIONS))
LEVEL = click.Choice([level.value for level in Level])
MAP_LEVEL = click.Choice([level.value for level in Level if level is not Level.FULL])
SLOW_FLOW: dict[str, SlowFlow] = {"auto": "auto", "on": True, "off": False}
COLUMNS = "tau,omega_1,omega_2,omega_3,energy,power"
FIGURES = click.Choice(["1", "1-full", "2", "3", "spectra", "levels"])

NAMES = """\b
Names of the figures:
  1        which outcomes are possible for which shape δ, at order 1
  1-full   the same by the semi-reduced and the full equation
  2        ω₁, ω₂, ω₃ against τ: a residual rotation and a stop, order 1 and full
  3        phase plane of the plane rotator, with its runaways
  spectra  how perturbations of a residual rotation decay, at every level
  levels   which starts have another outcome at another level"""

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
  order-2 … order-4   the same reduction to higher order, which has that term
  semi       semi-reduced: only the second derivative of ω is replaced. It has that
             term and is as cheap as order 1: use it for outcomes and maps
  full       the full equation on its physical branch (too slow for maps)

\b
Outcomes: residual (ω → ω∞ ≠ 0, along the dipole), stop (ω → 0), undecided (the budget
of steps ran out, or chance decides), failed (not a number). Certified: the run entered a
region that is proven to decide for this level of the equation; the difference between
this level and the full equation is not taken into account."""

SHOWN = {"show_default": True, "help_option_names": ["-h", "--help"], "max_content_width": 100}


@click.group(epilog=TERMS, context_settings=SHOWN)
@click.version_option(package_name="dipoletop", message="%(prog)s %(version)s")
def main() -> None:
    """Rotation of a rigid electric dipole that radiates: does it keep rotating, or stop?"""


main.add_command(store)
main.add_command(info_command)
main.add_command(plot_command)
main.add_command(export_command)
main.add_command(predict_command)
main.add_command(atlas_command)
main.add_command(explore_command)


@main.command("map", epilog=TERMS, short_help="Which starts keep rotating and which stop.")
@click.option(
    "--level",
    type=MAP_LEVEL,
    metavar="LEVEL",
    multiple=True,
    default=("order-1", "semi"),
    help="Level of the equation; give two to compare them.",
)
@click.option(
    "--x",
    type=AXIS,
    metavar="AXIS",
    default="phi",
    help="Horizontal axis.",
)
@click.option("--y", type=AXIS, metavar="AXIS", default="w3", help="Vertical axis.")
@click.option(
    "--range",
    "ranges",
    type=(AXIS, NUMBER, NUMBER),
    multiple=True,
    metavar="AXIS LOW HIGH",
    help="Range of an axis; may be given for each axis.",
)
@quantities.quantity_options
@click.option("--size", type=Size(), metavar="N[xM]", default="512", help="Starts on x [and on y].")
@click.option("--rtol", type=NUMBER, default="1e-8", help="Relative tolerance of every step.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Budget of each run.")
@click.option(
    "--slow-flow",
    type=click.Choice(list(SLOW_FLOW)),
    default="auto",
    help="Predict runs by the average over free rotation: those beyond the budget (auto), all that "
    "the first state does not decide (on), none (off).",
)
@click.option(
    "--confirm", type=NUMBER, metavar="RTOL", help="Run all again at this tolerance and compare."
)
@click.option(
    "--device", type=click.Choice(["cpu", "gpu"]), help="Kind of devices.  [default: all]"
)
@click.option(
    "--engine",
    type=click.Choice(["auto", "jax", "native"]),
    default="auto",
    help="auto runs native (machine code; needs llvmlite) where it can, else jax. Machine code is "
    "kept in your folder of caches, ~/.cache/dipoletop on Linux, unless DIPOLETOP_CACHE=off.",
)
@click.option(
    "--output", default="dipoletop-map", help="Folder, or first part of the names of all files."
)
@click.option("--format", "suffix", type=FORMATS, help="Format of the picture.  [default: png]")
@click.option(
    "--store/--no-store",
    default=True,
    help="Keep the data in OUTPUT-LEVEL.zarr; the same command resumes a stopped sweep.",
)
@click.option("--repair", is_flag=True, help="Recompute damaged data of the store.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute on the workers of this Dask scheduler, as tcp://host:8786 (needs dask).",
)
@click.option(
    "--time-limit",
    type=Duration(),
    help="Stop after this time, as 90s, 30m, 2h or 1:30:00, with exit status 124; finished tiles "
    "are kept.",
)
@click.option("--progress/--quiet", default=None, help="Progress bar.  [default: on a terminal]")
@computing
def map_command(**options: Any) -> None:
    """Map which starts keep rotating and which stop, over any two quantities.

    Without options: outcome and ω∞ over φ and ω₃, at δ = -0.2 and ω⊥ = 0.2, by the paper's
    equation (order 1) and by the semi-reduced one. Starts whose outcomes differ are hatched.
    """
    levels = [Level(word) for word in options["level"]]
    if len(set(levels)) != len(levels) or len(levels) > 2:
        raise Refusal("--level must be one level, or two different ones.")
    axes = quantities.OPTIONS[options["x"]], quantities.OPTIONS[options["y"]]
    ranges = {quantities.OPTIONS[word]: (low, high) for word, low, high in options["ranges"]}
    grid, text = quantities.grid_over(axes, ranges, options["size"], _given(options))
    base, picture = output_paths(options["output"], options["suffix"], "map")
    settings = {
        name: options[name] for name in ("rtol", "max_steps", "confirm", "engine", "repair")
    }
    settings["slow_flow"] = SLOW_FLOW[options["slow_flow"]]
    settings["devices"] = _devices(options["device"])
    show = sys.stderr.isatty() if options["progress"] is None else options["progress"]
    click.echo(f"{text}.")
    runs = []
    with (
        interruptible(keeps_tiles=options["store"], time_limit=options["time_limit"]),
        cluster_client(options["scheduler"], options["store"]) as settings["client"],
    ):
        for level in levels:
            place = base.with_name(f"{base.name}-{level}.zarr") if options["store"] else None
            progress = level.value if show else False
            runs.append(maps.run_level(level, grid, place, progress=progress, **settings))
    _draw([run.basin for run in runs], axes, picture)
    click.echo(tables.maps(runs))
    if levels == [Level.ORDER_1]:
        click.echo(
            f"{Level.ORDER_1.caveat}; outcomes may differ at the consistent levels (--level semi)."
        )
    click.echo(f"Picture: {picture}")
    for run in runs:
        if run.store:
            click.echo(f"Data: {run.store} (dipoletop.Basin.load reads it)")


def _given(options: dict[str, Any]) -> dict[str, float | None]:
    """The quantities among the options; None where the user gave none."""
    return {name: options[name] for name in QUANTITIES}


def _devices(kind: str | None) -> list[Any] | None:
    """JAX's devices of a kind; None means all."""
    if kind is None:
        return None
    try:
        return jax.devices(kind)
    except RuntimeError:
        raise Refusal(f"--device {kind}: JAX finds none on this machine.") from None


def _draw(basins: list[Basin], axes: tuple[str, str], picture: Path) -> None:
    """Draw one map, or the comparison of two."""
    from .. import plots

    x, y = axes
    if len(basins) == 2:
        figure: Any = plots.compare(*basins, x=x, y=y)
    else:
        figure = plots.basin(basins[0], x=x, y=y).figure
    figure.savefig(picture, dpi=150)


@main.command("simulate", epilog=TERMS, short_help="One top: its motion and its outcome.")
@click.option(
    "--level",
    type=LEVEL,
    metavar="LEVEL",
    default=Level.SEMI.value,
    help="Level of the equation; order-1 is the paper's.",
)
@quantities.quantity_options
@click.option("--tau-max", type=NUMBER, default="1000", help="End of the run.")
@click.option("--points", type=click.IntRange(2), default=1001, help="Times in picture and table.")
@click.option("--rtol", type=NUMBER, default="1e-10", help="Relative tolerance.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Budget of the run.")
@click.option(
    "--output", default="dipoletop-trajectory", help="Folder, or first part of the file names."
)
@click.option("--format", "suffix", type=FORMATS, help="Format of the picture.  [default: png]")
@computing
def simulate_command(**options: Any) -> None:
    """Integrate the motion of one top, and report its outcome.

    Without options: the start of figure 2a of the paper (δ = -1/5, ω⊥ = ω₃ = 1/5, φ = π/30) by
    the semi-reduced equation; with --level order-1 the paper's own curves.
    """
    from .. import plots

    level, tau_max = Level(options["level"]), options["tau_max"]
    if tau_max <= 0:
        raise Refusal(f"--tau-max must be positive, but is {tau_max:g}.")
    base, picture = output_paths(options["output"], options["suffix"], "trajectory")
    values = quantities.with_defaults(_given(options))
    omega0, delta = initial_condition(values), values["delta"]
    equation = equation_at(level, delta)
    settings = {name: options[name] for name in ("rtol", "max_steps")}
    times = np.linspace(0.0, tau_max, options["points"])
    trajectory = simulate(equation, omega0, times, throw=False, **settings)
    rows = np.column_stack([trajectory.ts, trajectory.omega, trajectory.energy, trajectory.power])
    if not np.all(np.isfinite(rows)):
        raise Refusal(
            f"The run did not reach τ = {tau_max:g}: it ended after "
            f"{trajectory.stats['num_steps']} steps of at most {options['max_steps']}."
        )
    table = base.with_name(f"{base.name}.csv")
    # 17 digits give every number back exactly.
    np.savetxt(table, rows, fmt="%.17g", delimiter=",", header=COLUMNS, comments="")
    figure: Any = plots.trajectory(trajectory).figure
    figure.savefig(picture, dpi=150)
    click.echo(f"{describe(values)}. Level: {equation.level}.")
    click.echo(tables.states(rows))
    click.echo(tables.ending(classify(equation, omega0, **settings)))
    if level is Level.ORDER_1:
        consistent = equation_at(Level.SEMI, delta)
        result = classify(consistent, omega0, **settings)
        click.echo(tables.other_ending(consistent.level, result))
    click.echo(f"Picture: {picture}\nData: {table}")


@main.command("figures", epilog=NAMES, short_help="The figures of the paper, and three more.")
@click.argument("names", type=FIGURES, metavar="[NAME]...", nargs=-1)
@click.option("--output", default="dipoletop-figures", help="Folder of the figures.")
@click.option(
    "--format",
    "suffixes",
    type=FORMATS,
    multiple=True,
    default=("pdf", "png"),
    help="Format of the figures; may be given several times.",
)
@computing
def figures_command(**options: Any) -> None:
    """Compute and draw the figures of the paper, and three that it does not have.

    Without names: all of them, in about two minutes.
    """
    from ..paper import figures

    check_output(options["output"])
    folder = Path(options["output"])
    make_folder(folder)
    for name in dict.fromkeys(options["names"] or FIGURES.choices):
        figure = figures.FIGURES[name]()
        for suffix in dict.fromkeys(options["suffixes"]):
            path = folder / f"figure-{name}.{suffix}"
            figures.save(figure, path)
            click.echo(f"Figure: {path}")


@main.command(
    "spectrum", epilog=TERMS, short_help="How perturbations of a residual rotation decay."
)
@click.option("--delta", type=NUMBER, default=-0.2, help="δ = 1 − I₃/I₁.")
@click.option("-w", "--w", type=NUMBER, default=0.1, help="ω of the residual rotation.")
@click.option(
    "--level",
    type=LEVEL,
    metavar="LEVEL",
    multiple=True,
    default=("order-1", "semi", "full"),
    help="Level of the equation; may be given several times.",
)
@computing
def spectrum_command(delta: float, w: float, level: tuple[str, ...]) -> None:
    """Eigenvalues at the equilibrium ω = (w, 0, 0), rotation about the dipole, in units of 1/τ₀.

    The slow eigenvalues are those of physical motions. The full equation has others, of runaways.
    """
    for line in _spectra(level, delta, w):
        click.echo(line)
    if set(level) == {Level.ORDER_1}:
        first, slow, *_ = _spectra([Level.SEMI], delta, w)
        click.echo(f"{Level.ORDER_1.caveat}; {first}, {' '.join(slow.split())}.")


def _spectra(levels: Iterable[str], delta: float, w: float) -> list[str]:
    """The lines of all levels, one below the other."""
    omega, lines = jnp.array([w, 0.0, 0.0]), []
    for level in levels:
        equation = equation_at(level, delta)
        lines += tables.spectrum(equation.level, stability.spectrum(equation, omega))
    return lines


@main.command("validate", short_help="Check this installation against exact values.")
@click.option(
    "--paper",
    is_flag=True,
    help="Check every equation, claim, figure and number of the paper instead, and print which "
    "are confirmed or corrected, with residuals. Takes about two minutes.",
)
@computing
def validate_command(paper: bool) -> None:
    """Check this installation against exact solutions, identities and reference values.

    This takes less than a minute; the exit status is 1 if a check fails.
    """
    click.echo(validation.environment())
    if paper:
        from ..paper import ledger

        lines = tables.ledger(ledger())
    else:
        lines = tables.checks(validation.run())
    failed = 0
    for line, good in lines:
        click.echo(line)
        failed += not good
    click.echo(f"{failed} failed." if failed else "All passed.")
    raise SystemExit(1 if failed else 0)
