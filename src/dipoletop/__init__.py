"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from . import radiation
from ._types import Outcome, Stop, Verdict
from .basin import Basin
from .bodies import Body, axisymmetric, box, from_charges, rod, spheroid
from .equations.rigid import Full, Reduced, SemiReduced
from .equations.transverse import (
    TransverseAveraged,
    TransverseCylindrical,
    TransverseFull,
    TransverseReduced,
    TransverseSemi,
    cylindrical,
)
from .grids import Grid, Sample, isotropic, symmetry_cell, uniform_box
from .manifold import slow_manifold
from .outcomes import Classification, classify, classify_many
from .simulate import Trajectory, simulate
from .sweep import sweep

if TYPE_CHECKING:
    from . import plots

__all__ = [
    "Basin",
    "Body",
    "Classification",
    "Full",
    "Grid",
    "Outcome",
    "Reduced",
    "Sample",
    "SemiReduced",
    "Stop",
    "Trajectory",
    "TransverseAveraged",
    "TransverseCylindrical",
    "TransverseFull",
    "TransverseReduced",
    "TransverseSemi",
    "Verdict",
    "axisymmetric",
    "box",
    "classify",
    "classify_many",
    "cylindrical",
    "from_charges",
    "isotropic",
    "plots",
    "radiation",
    "rod",
    "simulate",
    "slow_manifold",
    "spheroid",
    "sweep",
    "symmetry_cell",
    "uniform_box",
]
__version__ = version("dipoletop")


def __getattr__(name: str) -> Any:
    # matplotlib is imported when a picture is drawn, not before.
    if name == "plots":
        return importlib.import_module(".plots", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
