"""Pictures of basins, trajectories and continuations.

`plane` computes what a map shows before it is drawn; `basins`, `trajectories` and `continuations`
draw; `axes` and `style` hold what several pictures share. The colours can be told apart by
colour-blind people. Only this folder, `paper` and `cli` import matplotlib.
"""

from .._maps.symmetry import unfold
from .atlases import atlas
from .basins import basin, compare
from .continuations import continuation, diagram
from .histories import history
from .panels import panels, shares
from .style import save
from .trajectories import trajectory

__all__ = [
    "atlas",
    "basin",
    "compare",
    "continuation",
    "diagram",
    "history",
    "panels",
    "save",
    "shares",
    "trajectory",
    "unfold",
]
