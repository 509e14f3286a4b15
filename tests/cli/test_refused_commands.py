"""What a command cannot do is refused in one line, before anything is written."""

import jax
import pytest

from command_line import refusal

REFUSALS = {
    "atlas": {
        "--dipole 4": "'4' is not one of '1', '2', '3'",
        "--dipole 1 --body 3,4,5": "--dipole and --body cannot both be given.",
        "--body 3,4,9": "inertia must have principal moments with J1 + J2 >= J3",
        "--body 3,3,5": "--body must have three different moments",
        "--body 3,4": "'3,4' is not three numbers",
        "--size 1": "Invalid value for '--size'",
    },
    "balance": {
        "--pressure -1": "--pressure must not be negative, but is -1.0.",
        "--rod 300x30nm": "--rod needs --density, too.",
    },
    "map": {
        "--delta 1.5": "--delta must lie in [-1, 1), but is 1.5.",
        "--x delta --range delta -2 0": "--delta must lie in [-1, 1), but is -2.",
        "--rtol 1e-20": "must lie between 4.4e-15 and 1 in float64, but is 1e-20.",
        "--confirm 3": "--confirm must lie between 4.4e-15 and 1 in float64, but is 3.",
        "--phi 0.3": "--phi would fix an axis of the map; use --range phi LOW HIGH.",
        "--x w3": "--x and --y must be two different quantities, but are both w3.",
        "--range delta 0 0.5": "--range delta: the axes of this map are phi and w3.",
        "--range w3 1 0": "--range w3: 1 must be less than 0.",
        "--x theta --y amplitude --range theta -1 1": "--theta must lie in [0, 3.14159], but is",
        "--w-perp -0.1": "--w-perp must be at least 0, but is -0.1.",
        "--amplitude 0.3": "amplitude and w3 cannot be mixed: the start is given by w-perp and",
        "--level semi --level semi": "--level must be one level, or two different ones.",
        "--device gpu": "--device gpu: JAX finds none on this machine.",
        "--level full": "Invalid value for '--level': 'full' is not one of 'order-1'",
        "--w3 nan": "'nan' is not a finite number such as 0.2, 1e-3 or pi/30.",
        "--w3 pi/0": "'pi/0' is not a finite number such as 0.2, 1e-3 or pi/30.",
        "--size 1": "'1' is not a size such as 512 or 512x256, at least 2.",
        "--size 5,5": "'5,5' is not a size such as 512 or 512x256, at least 2.",
        "--max-steps 0": "Invalid value for '--max-steps'",
        "--format bmp": "Invalid value for '--format'",
        "--sizes 5": "No such option '--sizes'",
    },
    "predict": {
        "": "One of --particle, --box, --rod, --sphere or --ellipsoid must be given, but none is",
        "--particle cds --rod 9x1nm": "but --particle and --rod are.",
        "--sphere 9nm --density 1000 --dipole 9": "--sphere needs --along, too.",
        "--particle cds --density 3": "--density is that of a solid; a --particle has its own.",
        "--particle cds --axis x --momentum x": "--momentum and --axis cannot both be given.",
        "--box 3x2nm": "'3x2nm' is not 3 positive lengths with a unit (nm, um, mm, …) such as",
        "--box 3x2x1": "'3x2x1' is not 3 positive lengths with a unit",
        "--sphere -3nm": "'-3nm' is not a positive length with a unit",
        "--particle cds --along 0,0,0": "'0,0,0' is not a direction such as x, y, z or 1,0,0.01.",
        "--particle cds --spin 1kg": "--spin must be a number with a unit among Hz",
        "--particle cds --dipole 0": "--dipole must not be zero",
        "--particle cds --spin 1e8GHz --axis x": "must have a rim slower than 0.1 c, since",
    },
    "simulate": {
        "--level order-1 --points 101 --max-steps 3": (
            "The run did not reach τ = 1000: it ended after 3 steps of at most 3."
        ),
        "--tau-max 0": "--tau-max must be positive, but is 0.",
        "--theta 1 --w3 1": "theta and w3 cannot be mixed",
        "--delta -1.1": "--delta must lie in [-1, 1), but is -1.1.",
        "--points 1": "Invalid value for '--points'",
    },
}
"""The sentence by what is asked of a command."""


@pytest.mark.parametrize(
    ("command", "options", "sentence"),
    [(command, *row) for command, rows in REFUSALS.items() for row in rows.items()],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, command, options, sentence):
    if options == "--device gpu" and jax.default_backend() == "gpu":
        pytest.skip("this machine has one")
    assert sentence in refusal(command, *options.split(), "--output", f"{tmp_path}/x")
    assert list(tmp_path.iterdir()) == []
