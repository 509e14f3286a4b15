"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

import importlib
from typing import Any

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
from .outcomes import Classification, classify, classify_many
from .simulate import Trajectory, simulate
from .sweep import sweep

__version__ = importlib.metadata.version("dipoletop")


def __getattr__(name: str) -> Any:
    # matplotlib is imported when a picture is drawn, not before.
    if name == "plots":
        return importlib.import_module(".plots", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
