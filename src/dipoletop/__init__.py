"""dipoletop: rotation of a rigid electric dipole that radiates, its outcomes and their basins."""

from . import radiation
from ._types import Outcome, Stop, Verdict
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
from .outcomes import Classification, classify, classify_many
