"""The ledger of the source paper: its confirmed and its corrected statements.

The ledger checks every equation, claim, figure and number by a computation when it runs; no result
is stored.
"""

from collections.abc import Iterator

import numpy as np

from . import (
    ledger_averaged,
    ledger_claims,
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
    ledger_claims.conclusions,
    ledger_longitudinal.braking_time,
    ledger_rotator.phase_plane,
    ledger_rotator.manifold,
    ledger_rotator.asymptotics,
    ledger_longitudinal.changed_variables,
    ledger_longitudinal.asymptotics,
)
"""Functions that yield the entries of the parts of the paper, in its order."""


def ledger() -> Iterator[Entry]:
    """Yield the entries of the ledger, in the paper's order; an exception gives a failed entry."""
    for part in PARTS:
        try:
            yield from part()
        except Exception as error:  # of any type: the entry shows it
            reason = str(error).strip().splitlines()
            yield Entry(part.__name__, reason[0] if reason else type(error).__name__, np.inf, 0.0)
