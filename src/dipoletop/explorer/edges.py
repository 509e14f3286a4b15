"""Finer edges of a picture: further starts in the pixels where the fate changes."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int

from .._maps.basin import Basin
from .._maps.grids import Grid
from ..boundary import fate

FINER = 3
"""Starts on a side of a pixel at an edge; odd, so that the pixel's own start is one of them."""


def starts_at_edges(basin: Basin) -> Int[np.ndarray, "n"]:
    """Return the flat indices, in a grid `FINER` times finer, of new starts of pixels at edges.

    A pixel is at an edge if one of its eight neighbours has another fate.
    """
    differs = _differs(fate(basin).reshape(basin.shape[-2:]))
    finer = np.kron(differs, np.ones((FINER, FINER), bool))
    finer[FINER // 2 :: FINER, FINER // 2 :: FINER] = False  # computed already
    return np.flatnonzero(finer)


def _differs(fates: Int[np.ndarray, "Y X"]) -> Bool[np.ndarray, "Y X"]:
    rows, columns = fates.shape
    around = np.pad(fates, 1, mode="edge")
    shifts = ((y, x) for y in range(3) for x in range(3))
    near = (around[y : y + rows, x : x + columns] for y, x in shifts)
    return np.logical_or.reduce([fates != other for other in near])


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
