"""Thermal noise: many paths of a body in a bath, turn by turn or averaged over free rotation.

Friction without noise, or noise without friction, has no thermal equilibrium. A `Bath` holds both.
`with_noise` adds it to a reduced equation, of which `ensemble` integrates paths turn by turn.
`averaged_ensemble` follows real particles, which turn far too often for that: its cost does not
depend on τ₀Ω. With noise an end is a matter of probability, so `classify` and `sweep` refuse it.
"""

from .averaged import averaged_ensemble
from .bath import Bath
from .diffusion import Diffusion, diffusion
from .ensembles import Ensemble
from .resolved import Noisy, ensemble, with_noise
from .stationary import grain_density, mean_square, rotator_density

__all__ = [
    "Bath",
    "Diffusion",
    "Ensemble",
    "Noisy",
    "averaged_ensemble",
    "diffusion",
    "ensemble",
    "grain_density",
    "mean_square",
    "rotator_density",
    "with_noise",
]
