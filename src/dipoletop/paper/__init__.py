"""The ledger of the source paper: what of it is confirmed, and what is corrected.

Every equation, claim, figure and number is tried when it is run; nothing is looked up.
"""

from collections.abc import Iterator

import numpy as np

from . import ledger_averaged as _averaged
from . import ledger_claims as _claims
from . import ledger_conclusions as _conclusions
from . import ledger_equation_of_motion as _general
from . import ledger_longitudinal as _longitudinal
from . import ledger_rotator as _rotator
from . import ledger_transverse as _transverse
from .ledger_entry import Entry as Entry

PARTS = (
    _general.rotator,
    _general.motion,
    _longitudinal.equations,
    _transverse.equations,
    _averaged.orbits,
    _averaged.limits,
    _averaged.late,
    _transverse.fixed_points,
    _claims.outcomes,
    _claims.figures,
    _claims.exceptions,
    _claims.asymmetric,
    _conclusions.conclusions,
    _longitudinal.braking_time,
    _rotator.phase_plane,
    _rotator.manifold,
    _rotator.asymptotics,
    _longitudinal.changed_variables,
    _longitudinal.asymptotics,
)


def ledger() -> Iterator[Entry]:
    """The lines of the ledger, in the paper's order; a part that breaks down is a failed line."""
    for part in PARTS:
        try:
            yield from part()
        except Exception as error:
            reason = str(error).strip().splitlines()
            yield Entry(part.__name__, reason[0] if reason else type(error).__name__, np.inf, 0.0)
