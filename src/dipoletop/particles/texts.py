"""Particles as text."""

from typing import Any

import numpy as np

from .._base.summaries import span
from .units import DEBYE


def text(particle: Any) -> str:
    """Return the numbers of one particle, or ranges of many."""
    dipole = np.asarray(particle.dipole)
    size = np.linalg.norm(dipole, axis=-1)
    moments = np.linalg.eigvalsh(np.asarray(particle.inertia))
    mass = f"mass={span(particle.mass)} kg"
    if particle.mass.ndim:
        low, high = span(moments[..., 0]), span(moments[..., 2])
        shown = [
            f"{particle.mass.size} particles",
            mass,
            f"least moment={low} kg m²",
            f"largest moment={high} kg m²",
            f"dipole={span(size / DEBYE)} D",
        ]
    else:
        diagonal = np.diag(particle.inertia)
        if np.array_equal(particle.inertia, np.diag(diagonal)):
            moments = diagonal  # about the body axes, as `along`
        shown = [
            mass,
            f"moments={_tuple(moments)} kg m²",
            f"dipole={span(size / DEBYE)} D along {_tuple(dipole / size)}",
        ]
    if particle.radius is not None:
        shown.append(f"radius={span(particle.radius)} m")
    return f"Particle({', '.join(shown)})"


def _tuple(numbers: np.ndarray) -> str:
    return f"({', '.join(f'{x:.6g}' for x in numbers)})"
