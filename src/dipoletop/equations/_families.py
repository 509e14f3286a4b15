"""The equations of this library by the kind of body."""

from .longitudinal import LongitudinalFull, LongitudinalReduced, LongitudinalSemi
from .rigid import Full, Reduced, SemiReduced
from .transverse import TransverseFull, TransverseReduced, TransverseSemi

TRANSVERSE = TransverseReduced, TransverseSemi, TransverseFull
LONGITUDINAL = LongitudinalReduced, LongitudinalSemi, LongitudinalFull
RIGID = Reduced, SemiReduced, Full
