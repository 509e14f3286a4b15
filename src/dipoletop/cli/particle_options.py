"""The options that describe a particle: one of the paper's, or a solid with a dipole."""

from typing import TYPE_CHECKING, Any

import click
import jax.numpy as jnp
import numpy as np

from .parameters import Direction, Lengths, Number
from .refusals import Command, Refusal

if TYPE_CHECKING:
    from ..particles import Particle

NAMES = {
    "silica": "silica sphere",
    "dast": "DAST about the long axis",
    "cellulose": "cellulose fibre",
    "cdse": "CdSe sphere",
    "cds": "CdS sphere",
}
"""The particles of the paper, by the words of the command line."""
SHAPES = {
    "box": Lengths(3, "100x60x40nm"),
    "rod": Lengths(2, "100x20nm"),
    "sphere": Lengths(1, "100nm"),
    "ellipsoid": Lengths(3, "100x60x40nm"),
}
MEANINGS = {
    "box": "Edges A x B x C along the body axes x, y, z.",
    "rod": "Length and diameter of a cylinder along the body axis z.",
    "sphere": "Diameter.",
    "ellipsoid": "Diameters along the body axes x, y, z.",
}


def particle_options(command: Command) -> Command:
    """The options --particle, --box, …, --density, --dipole, --along."""
    names = click.Choice(list(NAMES), case_sensitive=False)
    options = [
        click.option("--particle", type=names, help="A particle of the paper."),
        *(
            click.option(f"--{shape}", type=lengths, metavar=lengths.example, help=MEANINGS[shape])
            for shape, lengths in SHAPES.items()
        ),
        click.option("--density", type=Number(), help="Density of a solid, kg/m³."),
        click.option("--dipole", type=Number(), help="Dipole moment, debye."),
        click.option(
            "--along", type=Direction(), help="Direction of the dipole: x, y, z or 1,0,0.01."
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def given_particle(options: dict[str, Any]) -> "Particle":
    """The particle that the options describe.

    Raises:
        Refusal: none or several of --particle and the shapes, or options that one needs are absent.
        ValueError: values that no particle has.
    """
    given = [name for name in ("particle", *SHAPES) if options[name] is not None]
    if len(given) != 1:
        all_names = "--particle, --box, --rod, --sphere or --ellipsoid"
        was = "none is given" if not given else f"--{' and --'.join(given)} are"
        raise Refusal(f"One of {all_names} must be given, but {was}.")
    if given == ["particle"]:
        return _of_paper(options)
    for name in ("density", "dipole", "along"):
        if options[name] is None:
            raise Refusal(f"--{given[0]} needs --{name}, too.")
    return _solid(given[0], options[given[0]], options)


def _of_paper(options: dict[str, Any]) -> "Particle":
    """A particle of the paper, its dipole changed as the options say."""
    from ..particles import DEBYE, Particle, paper_particles

    if options["density"] is not None:
        raise Refusal("--density is that of a solid; a --particle has its own.")
    name = NAMES[options["particle"]]
    particle = next(each.particle for each in paper_particles() if each.name == name)
    if options["dipole"] is None and options["along"] is None:
        return particle
    size = float(jnp.linalg.norm(particle.dipole))
    if options["dipole"] is not None:
        size = options["dipole"] * DEBYE
    along = np.asarray(options["along"] or particle.dipole)
    dipole = size * along / np.linalg.norm(along)
    return Particle(particle.mass, particle.inertia, dipole, radius=particle.radius)


def _solid(shape: str, lengths: tuple[float, ...], options: dict[str, Any]) -> "Particle":
    """A homogeneous solid with a dipole."""
    from ..particles import DEBYE, Particle

    along = np.asarray(options["along"])
    dipole = options["dipole"] * DEBYE * along / np.linalg.norm(along)
    density = options["density"]
    if shape == "box":
        return Particle.cuboid(lengths, dipole, density=density)
    if shape == "rod":
        length, diameter = lengths
        return Particle.rod(length, diameter / 2, dipole, density=density)
    if shape == "sphere":
        return Particle.sphere(lengths[0] / 2, dipole, density=density)
    return Particle.ellipsoid([length / 2 for length in lengths], dipole, density=density)
