"""Pictures of basins, trajectories and continuations.

`map_layout` and `column_shading` compute the content of a map before it is drawn; `axes` and
`style` serve several pictures; the other modules draw. The colours are distinct for colour-blind
people, too. Only this folder, `paper`, `explorer` and `cli` import matplotlib.
"""

from .._maps.unfolded_basins import unfold
from .animations import animate
from .atlases import atlas
from .balances import balance
from .basins import basin, compare, shares
from .continuations import continuation, diagram
from .histograms import histogram
from .histories import history
from .single_starts import line, starts
from .style import save
from .trajectories import trajectory

__all__ = [
    "animate",
    "atlas",
    "balance",
    "basin",
    "compare",
    "continuation",
    "diagram",
    "histogram",
    "history",
    "line",
    "save",
    "shares",
    "starts",
    "trajectory",
    "unfold",
]
