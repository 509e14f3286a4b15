"""`dipoletop predict`: how the rotation of a real particle ends, and when."""

import sys
from typing import TYPE_CHECKING, Any

import click
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from .._base.directions import spread_directions
from ..prediction import ENDS, Prediction, predict
from . import prediction_tables
from .files import FORMATS, output_paths
from .parameters import Direction
from .particle_options import given_particle, particle_options
from .refusals import Refusal, computing

if TYPE_CHECKING:
    from ..particles import Particle

HISTORY = "seconds,energy_J,angular_momentum_Js,h_per_kg_m2,speed_rad_per_s"

NOTES = """\b
L∞/L₀       the angular momentum that is left at the end, over that of the start
half time   after which the energy has fallen halfway to its last value
lifetime    of the last rotation, which decays as L² ∝ 1/(1 + t/lifetime); ∞ if it is
            residual. A dipole that lies a small angle off its axis has a long one
ends        residual rotation along (+) or against (−) the dipole; a stop about the
            principal axis 1, 2 or 3 (J₁ ≤ J₂ ≤ J₃), tumbling, or wobbling"""


@click.command("predict", epilog=NOTES, short_help="How the rotation of a real particle ends.")
@particle_options
@click.option("--spin", default="1 GHz", help="L·Ω/L: 1GHz, 3000rpm or 6e9rad/s.")
@click.option("--momentum", type=Direction(), help="Direction of L: x, y, z or 1,2,3; or else")
@click.option("--axis", type=Direction(), help="direction of Ω.  [default: isotropic L]")
@click.option(
    "--directions", type=click.IntRange(2), default=200, help="Directions, if they are isotropic."
)
@click.option(
    "--output", default="dipoletop-prediction", help="Folder, or first part of the file names."
)
@click.option("--format", "suffix", type=FORMATS, help="Format of the picture.  [default: png]")
@click.option("--progress/--quiet", default=None, help="Progress bar.  [default: on a terminal]")
@computing
def predict_command(**options: Any) -> None:
    r"""Predict how the rotation of a particle ends, and how long that takes.

    The particle is one of the paper's, or a homogeneous solid with a dipole:

    \b
      dipoletop predict --particle cellulose
      dipoletop predict --box 100x60x40nm --density 2000 --dipole 2400 --along z --momentum 1,1,1

    Without --momentum and --axis it is predicted for directions of L spread evenly over the sphere;
    the picture then shows the median and bands. x, y, z are body axes.
    """
    from .. import plots

    if options["momentum"] and options["axis"]:
        raise Refusal("--momentum and --axis cannot both be given.")
    base, picture = output_paths(options["output"], options["suffix"], "prediction")
    particle = given_particle(options)
    single = bool(options["momentum"] or options["axis"])
    show = sys.stderr.isatty() if options["progress"] is None else options["progress"]
    directions = np.asarray([options["momentum"] or options["axis"] or (0.0, 0.0, 1.0)])
    if not single:
        directions = spread_directions(options["directions"])
    name = "axis" if options["axis"] else "momentum"
    predictions = _predictions(particle, options["spin"], name, directions, show)
    shown = jax.tree.map(lambda leaf: leaf[0], predictions) if single else predictions
    plots.save(plots.history(shown), picture)
    data = base.with_name(f"{base.name}.csv")
    click.echo(prediction_tables.particle(particle))
    click.echo(f"{_start(options, name)}\n")
    if single:
        click.echo(prediction_tables.one(shown))
        _write(data, HISTORY, _history_rows(shown))
    else:
        click.echo(prediction_tables.many(predictions))
        _write(data, _columns(), _direction_rows(predictions, directions))
    click.echo(f"Picture: {picture}\nData: {data}")


def _predictions(
    particle: "Particle", spin: str, name: str, directions: np.ndarray, show: bool
) -> Prediction:
    """The predictions for all directions, as a batch."""
    from ..particles import start

    starts = start(particle, spin, **{name: jnp.asarray(directions)})
    bar = tqdm(starts, desc="predict", disable=not show, leave=False)
    # One by one: a batch by `vmap` would be compiled for minutes.
    each = [predict(particle, omega0) for omega0 in bar]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *each)


def _start(options: dict[str, Any], name: str) -> str:
    """The start in words."""
    from ..particles import angular_speed

    speed = f"L·Ω/L = {float(angular_speed(options['spin'])):.4g} rad/s"
    if not options[name]:
        return f"{speed}, {options['directions']} isotropic directions of L"
    along = ", ".join(f"{part:g}" for part in options[name])
    return f"{speed}, {'Ω' if name == 'axis' else 'L'} along ({along})"


def _history_rows(prediction: Prediction) -> np.ndarray:
    """The history as a table, at the times of the picture."""
    from ..plots.history_curves import times_for

    times = times_for(jax.tree.map(lambda leaf: leaf[None], prediction))
    return np.stack([np.asarray(column) for column in prediction.history(jnp.asarray(times))], 1)


def _columns() -> str:
    """The header of the table over directions."""
    ends = ",".join(end.replace(",", "").replace(" ", "_") for end in ENDS)
    names = "outcome,ratio,omega_inf,half_time,lifetime,radiated_energy,error"
    return f"L_x,L_y,L_z,{names},{ends}"


def _direction_rows(predictions: Prediction, directions: np.ndarray) -> np.ndarray:
    """The table over directions."""
    p = predictions
    columns = p.outcome, p.ratio, p.omega_inf, p.half_time, p.lifetime, p.radiated_energy, p.error
    return np.column_stack([directions, *map(np.asarray, columns), np.asarray(p.probability)])


def _write(path: Any, header: str, rows: np.ndarray) -> None:
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=header, comments="")
