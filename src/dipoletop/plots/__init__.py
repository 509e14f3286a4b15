"""Pictures of basins and trajectories, in colours that colour-blind people can tell apart."""

from .._maps.symmetry import unfold
from .basins import basin, compare, trajectory

__all__ = ["basin", "compare", "trajectory", "unfold"]
