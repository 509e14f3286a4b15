"""The basin boundary, for any problem that `sweep` takes.

`fate` numbers the ways to end, `bisect` finds the boundary on segments to rounding, `normal` and
`derivative` give its direction and how it moves with a parameter. `trace` follows its curve in a
plane, `edge_state` the motion on it to its saddle. `minimal_kick` finds its distance from a start,
and `residual_share` the share of segments that ends in residual rotation, with its derivatives.
"""

from .crossings import Crossings, bisect, derivative, normal
from .curves import Curve, CurveEnd, trace
from .edge_states import Edge, edge_state
from .fates import fate
from .kicks import Kick, minimal_kick
from .residual_shares import ResidualShare, residual_share

__all__ = [
    "Crossings",
    "Curve",
    "CurveEnd",
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
