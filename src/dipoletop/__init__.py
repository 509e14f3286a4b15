"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from . import exact, planar, radiation
from ._base.types import Outcome, Regime, Stop, Verdict
from ._branch.slow_manifold import slow_manifold
from ._maps.basin import Basin
from ._maps.grids import Grid, Points, Sample, isotropic, symmetry_cell, uniform_box
from ._maps.store.errors import StoreDamaged, StoreMismatch
from ._maps.sweep import sweep
from ._runs.classification import Classification
from ._runs.classify import classify
from ._runs.classify_many import classify_many
from ._runs.sensitivity import decay_time, residual_rotation
from ._runs.simulate import simulate
from ._runs.trajectory import Trajectory
from .atlas import Atlas, atlas
from .bodies import Body, axisymmetric, box, from_charges, rod, spheroid
from .equations import (
    Full,
    Level,
    LongitudinalFull,
    LongitudinalReduced,
    LongitudinalSemi,
    Reduced,
    RotatorBranch,
    RotatorFull,
    RotatorReduced,
    SemiReduced,
    TransverseAveraged,
    TransverseCylindrical,
    TransverseFull,
    TransverseLinearised,
    TransverseReduced,
    TransverseSemi,
    equation_at,
)
from .equations.coordinates import cylindrical
from .equations.rotator_curves import closed_manifold, critical_manifold, separatrix
from .prediction import Prediction, predict
from .stability import Equilibria, Spectrum, equilibria, spectrum, threshold

if TYPE_CHECKING:
    from . import (
        adaptive,
        boundary,
        complexity,
        continuation,
        emission,
        fitting,
        particles,
        plots,
        uncertainty,
    )
    from .emission import lines, stokes
    from .particles import Particle

__all__ = [
    "Atlas",
    "Basin",
    "Body",
    "Classification",
    "Equilibria",
    "Full",
    "Grid",
    "Level",
    "LongitudinalFull",
    "LongitudinalReduced",
    "LongitudinalSemi",
    "Outcome",
    "Particle",
    "Points",
    "Prediction",
    "Reduced",
    "Regime",
    "RotatorBranch",
    "RotatorFull",
    "RotatorReduced",
    "Sample",
    "SemiReduced",
    "Spectrum",
    "Stop",
    "StoreDamaged",
    "StoreMismatch",
    "Trajectory",
    "TransverseAveraged",
    "TransverseCylindrical",
    "TransverseFull",
    "TransverseLinearised",
    "TransverseReduced",
    "TransverseSemi",
    "Verdict",
    "adaptive",
    "atlas",
    "axisymmetric",
    "boundary",
    "box",
    "classify",
    "classify_many",
    "closed_manifold",
    "complexity",
    "continuation",
    "critical_manifold",
    "cylindrical",
    "decay_time",
    "emission",
    "equation_at",
    "equilibria",
    "exact",
    "fitting",
    "from_charges",
    "isotropic",
    "lines",
    "particles",
    "planar",
    "plots",
    "predict",
    "radiation",
    "residual_rotation",
    "rod",
    "separatrix",
    "simulate",
    "slow_manifold",
    "spectrum",
    "spheroid",
    "stokes",
    "sweep",
    "symmetry_cell",
    "threshold",
    "uncertainty",
    "uniform_box",
]
__version__ = version("dipoletop")


# Imported when they are used, not before: with matplotlib, SciPy, or the constants of physics.
_MODULES = ("adaptive", "boundary", "complexity", "continuation", "emission", "fitting")
_NAMES = {"Particle": "particles", "lines": "emission", "stokes": "emission"}
_LAZY = {name: name for name in (*_MODULES, "particles", "plots", "uncertainty")} | _NAMES


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f".{_LAZY[name]}", __name__)
    return module if name == _LAZY[name] else getattr(module, name)
