"""The ledger of the source paper: which of its statements are confirmed, and which corrected.

Every equation, claim, figure and number is checked by a computation when the ledger runs; no
result is stored.
"""

from collections.abc import Iterator

import numpy as np

from . import (
    ledger_averaged,
    ledger_claims,
    ledger_conclusions,
    ledger_equation_of_motion,
    ledger_longitudinal,
    ledger_rotator,
    ledger_transverse,
)
from .ledger_entry import Entry as Entry

PARTS = (
    ledger_equation_of_motion.rotator,
    ledger_equation_of_motion.motion,
    ledger_longitudinal.equations,
    ledger_transverse.equations,
    ledger_averaged.orbits,
    ledger_averaged.limits,
    ledger_averaged.late,
    ledger_transverse.fixed_points,
    ledger_claims.outcomes,
    ledger_claims.figures,
    ledger_claims.exceptions,
    ledger_claims.asymmetric,
    ledger_conclusions.conclusions,
    ledger_longitudinal.braking_time,
    ledger_rotator.phase_plane,
    ledger_rotator.manifold,
    ledger_rotator.asymptotics,
    ledger_longitudinal.changed_variables,
    ledger_longitudinal.asymptotics,
)
"""Every function yields the entries of a part of the paper, in the paper's order."""


def ledger() -> Iterator[Entry]:
    """The lines of the ledger, in the paper's order; a part that raises is a failed line."""
    for part in PARTS:
        try:
            yield from part()
        except Exception as error:  # whatever it is, the line shows it
            reason = str(error).strip().splitlines()
            yield Entry(part.__name__, reason[0] if reason else type(error).__name__, np.inf, 0.0)
