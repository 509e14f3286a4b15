"""The basin boundary as an object, for any problem that `sweep` takes.

`fate` numbers the ways to end, `bisect` finds the boundary on segments to rounding, `normal` and
`derivative` say how it lies and moves, `trace` follows its curve in a plane, `edge_state` the
motion on it to its saddle, and `minimal_kick` finds its distance from a start.
"""

from ._crossings import Crossings, bisect, derivative, fate, normal
from ._curve import Curve, trace
from ._edge import Edge, edge_state
from ._kick import Kick, minimal_kick

__all__ = [
    "Crossings",
    "Curve",
    "Edge",
    "Kick",
    "bisect",
    "derivative",
    "edge_state",
    "fate",
    "minimal_kick",
    "normal",
    "trace",
]
