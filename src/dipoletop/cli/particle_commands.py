"""`dipoletop predict`, `balance` and `atlas`: how particles end, what brakes them, all shapes."""

import contextlib
import functools
from typing import TYPE_CHECKING, Any

import click

from .options import (
    DIRECTION,
    NUMBER,
    NUMBERS,
    lengths,
    output_paths,
    picture_options,
    progress_option,
    saved,
    those_given,
    together,
    write_table,
)
from .running import Refusal, computing, say, waiting

if TYPE_CHECKING:
    from ..particles import Particle
    from ..prediction import Prediction

OF_PAPER = click.Choice(["silica", "dast", "cellulose", "cdse", "cds"], case_sensitive=False)
"""The first words of the names of `paper_particles`."""
SHAPES = {
    "box": (lengths(3, "100x60x40nm"), "Edges A x B x C along the body axes x, y, z."),
    "rod": (lengths(2, "100x20nm"), "Length and diameter of a cylinder along the body axis z."),
    "sphere": (lengths(1, "100nm"), "Diameter."),
    "ellipsoid": (lengths(3, "100x60x40nm"), "Diameters along the body axes x, y, z."),
}
HISTORY = "seconds", "energy_J", "angular_momentum_Js", "h_per_kg_m2", "speed_rad_per_s"
COLUMNS = "outcome", "ratio", "omega_inf", "half_time", "lifetime", "radiated_energy", "error"

NOTES = """\b
Examples:
  dipoletop predict --particle cellulose
  dipoletop predict --box 100x60x40nm --density 2000 --dipole 2400 --along z --momentum 1,1,1

\b
The moments of inertia J₁ ≤ J₂ ≤ J₃ belong to the principal axes 1, 2 and 3.
ends             residual rotation along (+) or against (-) the dipole; a stop about an
                 axis; a stop while tumbling about axis 3 (low) or 1 (high); wobbling
                 about the middle axis of a needle; each with its probability
ratio            the angular momentum that is left at the end, over that of the start
omega_inf        the last angular velocity, along the dipole
half_time        after which the energy has fallen halfway to its last value
lifetime         of the last rotation, which decays as L² ∝ 1/(1 + t/lifetime); inf if it
                 is residual. A dipole at a small angle from an axis has a long one
radiated_energy  the energy that is lost, also as a share of that of the start
nan              not known: a matter of chance
Of many starts, the quantiles 0.1, 0.5 and 0.9 are shown.

\b
The law that decided: SLOW_FLOW, the average over free rotation; AVERAGED, the same for two
equal moments; UNFOLDED, capture of a body with two nearly equal moments; EXACT, a solution
in closed form; RESOLVED, integration turn by turn."""


particle_options = together(
    click.option("--particle", type=OF_PAPER, help="A particle of the paper."),
    *(
        click.option(f"--{shape}", type=kind, metavar=kind.name, help=meaning)
        for shape, (kind, meaning) in SHAPES.items()
    ),
    click.option("--density", type=NUMBER, help="Density of a solid, kg/m³."),
    click.option("--dipole", type=NUMBER, help="Dipole moment, debye."),
    click.option("--along", type=DIRECTION, help="Direction of the dipole: x, y, z or 1,0,0.01."),
)

SURROUNDINGS = "pressure", "temperature", "loss"  # options, and arguments of the library
surrounding_options = together(
    click.option("--pressure", type=NUMBER, help="Pressure of the air, Pa (1e-3 mbar is 0.1 Pa)."),
    click.option("--temperature", type=NUMBER, help="Temperature, K.  [default: 300]"),
    click.option(
        "--loss", type=NUMBER, help="Im[(ε − 1)/(ε + 2)] of the material in the infrared."
    ),
)


@click.command("predict", epilog=NOTES)
@particle_options
@click.option("--spin", default="1 GHz", help="L·Ω/|L|: 1GHz, 3000rpm or 6e9rad/s.")
@click.option("--momentum", type=DIRECTION, help="Direction of L: x, y, z or 1,2,3.")
@click.option("--axis", type=DIRECTION, help="Direction of Ω, in place of --momentum.")
@click.option(
    "--directions",
    type=click.IntRange(2),
    default=200,
    help="Number of directions of L, if none is given.",
)
@surrounding_options
@picture_options("prediction")
@progress_option
@computing
def predict_command(**options: Any) -> None:
    """Predict how the rotation of a particle ends, and how long that takes.

    The particle is one of the paper's, or a homogeneous solid with a dipole. Without --momentum and
    --axis it is predicted for directions of L spread evenly over the sphere; the picture then shows
    the median and bands. x, y, z are body axes.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from .. import plots
    from .._base.directions import spread_directions
    from .._base.types import PREDICTED_FATES
    from ..particles import angular_speed, start

    if options["momentum"] and options["axis"]:
        raise Refusal("--momentum and --axis cannot both be given.")
    _, picture = output_paths(options, "prediction")
    particle, spin = given_particle(options), options["spin"]
    name, letter = ("axis", "Ω") if options["axis"] else ("momentum", "L")
    single = options[name]
    directions = np.asarray([single]) if single else spread_directions(options["directions"])
    starts = start(particle, spin, **{name: jnp.asarray(directions)})
    surroundings, progress = those_given(options, *SURROUNDINGS), options["progress"] and not single
    with waiting() if single else contextlib.nullcontext():
        predictions = _predictions(particle, starts, surroundings, progress)
    shown = jax.tree.map(lambda leaf: leaf[0], predictions) if single else predictions
    figure = plots.history(shown)
    say(particle)
    along = f"{letter} along {single}" if single else f"{len(starts)} isotropic directions of L"
    say(f"L·Ω/|L| = {float(angular_speed(spin)):.4g} rad/s, {along}")
    say(shown)
    if single:
        from ..plots.histories import times_for

        times = jnp.asarray(times_for(predictions))
        columns: dict[str, Any] = dict(zip(HISTORY, shown.history(times), strict=True))
    else:
        columns = {f"L_{axis}": directions[:, k] for k, axis in enumerate("xyz")}
        columns |= {column: getattr(shown, column) for column in COLUMNS}
        names = (f"share_{fate.name.lower()}" for fate in PREDICTED_FATES)
        columns |= dict(zip(names, shown.probability.T, strict=True))
    saved("Picture", picture, functools.partial(plots.save, figure))
    write_table(picture, columns)


def _predictions(
    particle: "Particle", starts: Any, surroundings: dict[str, Any], show: bool
) -> "Prediction":
    """The predictions for all starts, as a batch."""
    import jax
    import numpy as np
    from tqdm import tqdm

    from ..prediction import predict

    # One by one: a batch by `vmap` would be compiled for minutes.
    bar = tqdm(starts, desc="predict", disable=not show, leave=False)
    each = [predict(particle, omega0, **surroundings) for omega0 in bar]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *each)


def given_particle(options: dict[str, Any]) -> "Particle":
    """The particle that the options describe.

    Raises:
        Refusal: none or several of --particle and the shapes, or options that one needs are absent.
        ValueError: values that no particle has.
    """
    import jax.numpy as jnp

    from ..particles import DEBYE, Particle, paper_particles

    kinds = those_given(options, "particle", *SHAPES)
    if len(kinds) != 1:
        all_names = "--particle, --box, --rod, --sphere or --ellipsoid"
        was = f"--{' and --'.join(kinds)} are" if kinds else "none is given"
        raise Refusal(f"One of {all_names} must be given, but {was}.")
    shape, size = kinds.popitem()
    dipole, along, density = options["dipole"], options["along"], options["density"]
    if shape == "particle":
        if density is not None:
            raise Refusal("--density is that of a solid; a --particle has its own.")
        rotators = paper_particles()
        found = next(x.particle for x in rotators if x.name.lower().split()[0] == size)
        if dipole is None and along is None:
            return found
        length = jnp.linalg.norm(found.dipole) if dipole is None else dipole * DEBYE
        vector = length * _unit(along or found.dipole)
        return Particle(found.mass, found.inertia, vector, shape=found.shape)
    for name in ("density", "dipole", "along"):
        if options[name] is None:
            raise Refusal(f"--{shape} needs --{name}, too.")
    vector = dipole * DEBYE * _unit(along)
    if shape == "box":
        return Particle.cuboid(size, vector, density=density)
    if shape == "rod":
        return Particle.rod(size[0], size[1] / 2, vector, density=density)
    if shape == "sphere":
        return Particle.sphere(size[0] / 2, vector, density=density)
    return Particle.ellipsoid([length / 2 for length in size], vector, density=density)


def _unit(vector: Any) -> Any:
    import numpy as np

    return np.asarray(vector) / np.linalg.norm(vector)


BALANCE = """\b
Examples:
  dipoletop balance
  dipoletop balance --particle silica --pressure 1e-7 --loss 0.1
  dipoletop balance --rod 300x30nm --density 1600 --dipole 4000 --along x --axis z

\b
radiation   of the dipole itself
gas         the drag by a rarefied gas, diffuse reflection
blackbody   thermal friction, by the absorption of the material in the infrared
The rates are those at which the angular momentum falls."""


@click.command("balance", epilog=BALANCE)
@particle_options
@click.option("--spin", default="1 GHz", help="|Ω|: 1GHz, 3000rpm or 6e9rad/s.")
@click.option(
    "--axis",
    type=DIRECTION,
    help="Direction of Ω.  [default: the stable axis across the dipole]",
)
@surrounding_options
@click.option("--field", type=NUMBER, help="Amplitude of an applied field, V/m.")
@click.option("--strength", type=NUMBER, help="Stress at which the material breaks, Pa.")
@picture_options("balance")
@computing
def balance_command(**options: Any) -> None:
    """Compare the torques on a particle: its radiation, a gas, thermal radiation, a field.

    The particle is one of the paper's, or a homogeneous solid with a dipole; without one, the six
    particles of the paper are compared. Then there is no picture.
    """
    from .. import plots
    from ..particles import paper_particles
    from ..surroundings import balance

    surroundings = those_given(options, *SURROUNDINGS, "field", "strength")
    if those_given(options, "particle", *SHAPES):
        particle = given_particle(options)
        with waiting():
            found = balance(particle, _spin_about(options["axis"], options["spin"]), **surroundings)
        say(f"{particle}\n{found}")
        _, picture = output_paths(options, "balance")
        saved("Picture", picture, functools.partial(plots.save, plots.balance(found)))
        return
    for name, particle, axis in paper_particles():
        spin = _spin_about(options["axis"] or axis, options["spin"])
        say(f"{name}: {balance(particle, spin, **surroundings)}")


def _spin_about(axis: Any, spin: str) -> Any:
    """The angular velocity of a given size, or the size alone."""
    from ..particles import angular_speed

    return spin if axis is None else angular_speed(spin) * _unit(axis)


ENDINGS = """\b
How a body ends, over all directions of L; in the data, by these numbers:
  0 RESIDUAL       residual rotation from every start
  1 BOTH           residual rotation or a stop, by the start
  2 SPIN_1         a stop while spinning about the axis of J₁
  3 SPIN_3         a stop while spinning about the axis of J₃
  4 TUMBLING_LOW   a stop while tumbling about the axis of J₃
  5 TUMBLING_HIGH  a stop while tumbling about the axis of J₁
  6 STOPS          one of two kinds of stop, by the start
ratio is L∞/L₀, what is left of the angular momentum."""


@click.command("atlas", epilog=ENDINGS)
@click.option(
    "--dipole",
    "dipoles",
    type=click.Choice(["1", "2", "3"]),
    multiple=True,
    help="Principal axis with the dipole (J₁ ≤ J₂ ≤ J₃); may be repeated.  [default: 1 2 3]",
)
@click.option(
    "--body",
    type=NUMBERS,
    metavar="J1,J2,J3",
    help="Moments of inertia: map over all dipoles of this body instead.",
)
@click.option(
    "--size", type=click.IntRange(2), default=40, help="Cells along an edge of each triangle."
)
@click.option("--particles/--no-particles", default=True, help="Mark the particles of the paper.")
@picture_options("atlas")
@progress_option
@computing
def atlas_command(**options: Any) -> None:
    """Map how weakly radiating bodies end, over all ratios of moments of inertia.

    Each map is one over a triangle, with the dipole on a principal axis; the needle, the disc and
    the sphere are its corners. Directions of L are isotropic. With --body the map is over the
    squares of the direction cosines of the dipole. This takes about two minutes.
    """
    import numpy as np

    from .. import plots
    from ..atlases import atlas
    from ..bodies import Body

    _, picture = output_paths(options, "atlas")
    dipoles, moments = options["dipoles"], options["body"]
    if moments and dipoles:
        raise Refusal("--dipole and --body cannot both be given.")
    settings = {"n": options["size"], "progress": options["progress"]}
    if moments:
        maps = [atlas(body=Body(np.diag(moments), [1.0, 0.0, 0.0]), **settings)]
    else:
        maps = [atlas(int(axis), **settings) for axis in dict.fromkeys(dipoles or "123")]
    figure = plots.atlas(maps, particles=options["particles"])
    say("\n".join(map(repr, maps)))
    saved("Picture", picture, functools.partial(plots.save, figure))
    columns = [each.columns() for each in maps]
    write_table(picture, {k: np.concatenate([each[k] for each in columns]) for k in columns[0]})
