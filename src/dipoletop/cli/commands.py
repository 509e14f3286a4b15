"""`dipoletop simulate`, `figures`, `spectrum`, `validate` and `explore`."""

import functools
from pathlib import Path
from typing import Any

import click

from .._maps.top_parameters import QUANTITIES, describe
from ..equations.levels import Level
from .options import (
    AXIS,
    FORMATS,
    LEVEL,
    MAP_LEVEL,
    NUMBER,
    TERMS,
    levels_option,
    make_folder,
    name_of,
    output_option,
    output_paths,
    picture_options,
    quantity_options,
    range_option,
    saved,
    start_values,
    those_given,
    write_table,
)
from .running import Refusal, computing, end_at_once, say, waiting

FIGURES = click.Choice(["1", "1-full", "2", "3", "spectra", "levels"])
NAMES = """\b
Names of the figures:
  1        which outcomes are possible for which shape δ, at order 1
  1-full   the same by the semi-reduced and the full equation
  2        ω₁, ω₂, ω₃ against τ: a residual rotation and a stop, order 1 and full
  3        phase plane of the plane rotator, with its runaways
  spectra  how perturbations of a residual rotation decay, at every level
  levels   which starts have another outcome at another level"""


@click.command("simulate", epilog=TERMS)
@click.option(
    "--level",
    type=LEVEL,
    metavar="LEVEL",
    default=Level.SEMI.value,
    help="Level of the equation; order-1 is the paper's.",
)
@quantity_options
@click.option("--tau-max", type=NUMBER, default="1000", help="End of the run.")
@click.option("--points", type=click.IntRange(2), default=1001, help="Times in picture and table.")
@click.option("--rtol", type=NUMBER, default="1e-10", help="Relative tolerance.")
@click.option("--max-steps", type=click.IntRange(1), default=50_000, help="Most steps of the run.")
@picture_options("trajectory")
@computing
def simulate_command(**options: Any) -> None:
    """Integrate the motion of one top, and report its outcome.

    Without options: the start of figure 2a of the paper (δ = -1/5, ω⊥ = ω₃ = 1/5, φ = π/30) by
    the semi-reduced equation; with --level order-1 the paper's own curves.
    """
    import numpy as np

    from .. import plots
    from .._maps.top_problems import initial_condition
    from .._runs.classify import classify
    from .._runs.simulate import simulate
    from ..equations.transverse import equation_at

    level, tau_max = Level(options["level"]), options["tau_max"]
    if tau_max <= 0:
        raise Refusal(f"--tau-max must be positive, but is {tau_max:g}.")
    values = start_values(options)
    _, picture = output_paths(options, "trajectory")
    omega0, delta = initial_condition(values), values["delta"]
    settings = {name: options[name] for name in ("rtol", "max_steps")}
    times = np.linspace(0.0, tau_max, options["points"])
    equation = equation_at(level, delta)
    semi = None
    with waiting():
        trajectory = simulate(equation, omega0, times, throw=False, **settings)
        table = trajectory.to_dataframe()
        rows = table.to_numpy()
        if not np.all(np.isfinite(rows)):
            raise Refusal(
                f"The run did not reach τ = {tau_max:g}: it ended after "
                f"{trajectory.stats['num_steps']} steps of at most {options['max_steps']}."
            )
        drawn = plots.trajectory(trajectory)
        end = classify(equation, omega0, **settings)
        if not level.consistent:
            semi = classify(equation_at(Level.SEMI, delta), omega0, **settings)
    say(f"{describe(values)}.\n{trajectory}")
    say(f"{'τ':>10} {'ω₁':>16} {'ω₂':>16} {'ω₃':>16} {'energy':>12} {'power':>12}")
    last = len(rows) - 1  # shown with the tenfold times before it
    for k in sorted({0, *(max(1, round(last / 10**k)) for k in range(4))}):
        say("{:10g} {:16.9e} {:16.9e} {:16.9e} {:12.5e} {:12.5e}".format(*rows[k]))
    say(end)
    if semi is not None:
        say(f"{level.caveat}; at the semi-reduced level: {semi}")
    saved("Picture", picture, functools.partial(plots.save, drawn, dpi=150))
    write_table(picture, dict(table))


@click.command("figures", epilog=NAMES)
@click.argument("names", type=FIGURES, metavar="[NAME]...", nargs=-1)
@output_option("figures", "Folder of the figures.")
@click.option(
    "--format",
    "suffixes",
    type=FORMATS,
    multiple=True,
    default=("pdf", "png"),
    help="Format of the figures; may be given several times.",
)
@computing
def figures_command(names: tuple[str, ...], output: str, suffixes: tuple[str, ...]) -> None:
    """Compute and draw the figures of the paper, and three that it does not have.

    Without names: all of them, in about two minutes.
    """
    make_folder(Path(output))
    from ..paper import figures

    for name in dict.fromkeys(names or FIGURES.choices):
        figure = figures.FIGURES[name]()
        for suffix in dict.fromkeys(suffixes):
            path = Path(output) / f"figure-{name}.{suffix}"
            saved("Figure", path, functools.partial(figures.save, figure))


@click.command("spectrum", epilog=TERMS)
@click.option("--delta", type=NUMBER, default=-0.2, help="δ = 1 − I₃/I₁.")
@click.option("-w", "--w", type=NUMBER, default=0.1, help="ω of the residual rotation.")
@levels_option(LEVEL, ("order-1", "semi", "full"), "Level of the equation; may be repeated.")
@computing
def spectrum_command(delta: float, w: float, level: tuple[str, ...]) -> None:
    """Eigenvalues at the equilibrium ω = (w, 0, 0), rotation about the dipole, in units of 1/τ₀.

    The slow eigenvalues are those of physical motions. The full equation has fast ones, too, of
    runaways.
    """
    import jax.numpy as jnp

    from .. import stability
    from ..equations.transverse import equation_at

    only_first = set(level) == {Level.ORDER_1}
    for each in (*level, Level.SEMI) if only_first else level:
        equation = equation_at(each, delta)
        with waiting():
            found = stability.spectrum(equation, jnp.array([w, 0.0, 0.0]))
        say(f"{equation.level}\n{found}")
    if only_first:
        say(f"{Level.ORDER_1.caveat}.")


@click.command("validate")
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
    from .. import validation

    say(validation.environment())
    if paper:
        from ..paper import ledger

        results = ((entry, entry.holds) for entry in ledger())
    else:
        results = ((check, check.passed) for check in validation.run())
    failed = 0
    for result, good in results:
        say(result)
        failed += not good
    say(f"{failed} failed." if failed else "All passed.")
    raise SystemExit(1 if failed else 0)


@click.command("explore", epilog=TERMS)
@levels_option(MAP_LEVEL, ("semi",), "Level of the equation at first; give two to compare them.")
@click.option("--x", type=AXIS, metavar="AXIS", help="Horizontal axis at first.  [default: phi]")
@click.option("--y", type=AXIS, metavar="AXIS", help="Vertical axis at first.  [default: w3]")
@range_option("Range of an axis or slider; may be repeated.")
@quantity_options
@click.option(
    "--size",
    type=click.Choice(["64", "128", "256", "512", "1024"]),
    default="256",
    help="Starts on each axis at first.",
)
@click.option("--rtol", type=NUMBER, default="1e-8", help="Relative tolerance at first.")
@click.option(
    "--address",
    default="127.0.0.1",
    help="Where to listen. There is no password: others than 127.0.0.1 let other machines in.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port; 0: any free one.")
@click.option(
    "--allow-origin",
    "origins",
    multiple=True,
    metavar="HOST[:PORT]",
    help="Host whose pages may open a session, too, as behind a proxy; may be given several times.",
)
@click.option("--show/--no-show", default=True, help="Open a browser.")
@computing
def explore_command(**options: Any) -> None:
    """Explore in a browser which starts of a top keep rotating, and which stop.

    A page with the map over any two quantities and sliders for the others; the picture follows
    them. A click on a start shows its motion. Zoom in as far as rounding allows. Ctrl-C ends it.
    """
    from ..explorer import explore

    over = those_given(options, *QUANTITIES)
    over |= {name_of(word): ends for word, *ends in options["ranges"]}
    settings: dict[str, Any] = {name: options[name] for name in ("level", "rtol")}
    settings |= {axis: options[axis] and name_of(options[axis]) for axis in ("x", "y")}
    try:
        explorer = explore(None, over, size=int(options["size"]), **settings)
    except ImportError as error:
        raise Refusal(str(error)) from None
    place = {name: options[name] for name in ("address", "port", "origins", "show")}
    explorer.serve(**place, say=lambda url: say(f"Explore at {url} (Ctrl-C ends it)."))
    if explorer.is_working:
        end_at_once(0)
