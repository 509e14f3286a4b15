"""The basin boundary as an object, for any problem that `sweep` takes.

`fate` numbers the ways to end, `bisect` finds the boundary on segments to rounding, `normal` and
`derivative` say how it lies and moves, `trace` follows its curve in a plane, `edge_state` the
motion on it to its saddle, `minimal_kick` finds its distance from a start, and `residual_share`
tells how much lies inside and how that moves.
"""

from .crossings import Crossings, bisect, derivative, fate, normal
from .curves import Curve, trace
from .edge_states import Edge, edge_state
from .kicks import Kick, minimal_kick
from .residual_shares import ResidualShare, residual_share

__all__ = [
    "Crossings",
    "Curve",
    "Edge",
    "Kick",
    "ResidualShare",
    "bisect",
    "derivative",
    "edge_state",
    "fate",
    "minimal_kick",
    "normal",
    "residual_share",
    "trace",
]
