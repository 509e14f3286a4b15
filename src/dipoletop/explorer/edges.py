"""Finer edges of a picture: further starts in the pixels where the fate changes."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from .._maps.basin import Basin
from .._maps.grids import Grid
from ..boundary import fate

FINER = 3
"""Starts on a side of a pixel at an edge; odd, so that the pixel's own start is one of them."""


def starts_at_edges(basin: Basin) -> Int[np.ndarray, "n"]:
    """Return the flat indices, in a grid `FINER` times finer, of new starts of pixels at edges.

    A pixel is at an edge if one of its eight neighbours has another fate.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    fates = fate(basin).reshape(basin.shape[-2:])
    differs = maximum_filter(fates, 3, mode="nearest") != minimum_filter(fates, 3, mode="nearest")
    finer = np.kron(differs, np.ones((FINER, FINER), bool))
    finer[FINER // 2 :: FINER, FINER // 2 :: FINER] = False  # computed already
    return np.flatnonzero(finer)


def finer_basin(
    basin: Basin, finer: Grid, index: Int[np.ndarray, "n"], found: list[Basin]
) -> Basin:
    """Return the basin over a finer grid: each pixel's values, and those found at edges.

    Args:
        basin: the basin over the pixels.
        finer: the finer grid.
        index: flat indices in it, from `starts_at_edges`.
        found: basins over these starts, one after the other; more starts may follow.
    """
    columns = {}
    for name in basin.columns:
        wide = basin.column(name).repeat(FINER, axis=-1).repeat(FINER, axis=-2).ravel()
        if len(index):
            wide[index] = np.concatenate([part.columns[name] for part in found])[: len(index)]
        columns[name] = wide
    return replace(basin, shape=finer.shape, coords=finer.coords, columns=columns)
