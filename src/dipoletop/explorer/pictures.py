"""From the basins of a view to its picture: colours, hatching, legend and shares."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from matplotlib.colors import Normalize, to_hex

from .._base.types import Outcome
from .._maps.basin import Basin
from ..plots.column_shading import SIGNED, Shade
from ..plots.map_layout import Plane, classes_of, coloured, legend_colours, plane_of, shades_of
from ..plots.style import percent
from .views import View

STRIPES = 64
"""Stripes of the hatching along a side of a picture."""
NICE = 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0
"""Possible ends of a scale in a decade: few, so that it seldom changes while a slider moves."""


class Picture(NamedTuple):
    """The images of a view, one for each level, with their legend and basins."""

    view: View
    size: int
    """Pixels on a side."""
    is_final: bool
    """Whether the picture has the size and tolerance of the view; False for a coarse one."""
    images: tuple[UInt8[np.ndarray, "Y X 4"], ...]
    """RGBA colours; rows along y, both axes increasing."""
    legend: dict[str, str]
    """Colour of each class that occurs, by its name."""
    scale: float
    """The |ω∞| at the ends of the colour scale; 0 if no start ends in residual rotation."""
    basins: tuple[Basin, ...]
    planes: tuple[Plane, ...]
    differs: float | None
    """The share of starts whose outcomes differ between two levels."""
    has_fine_edges: bool = False
    """Whether pixels at an edge are divided; images and planes are finer than the basins then."""


def picture_of(
    view: View, basins: Sequence[Basin], folded: bool, size: int, is_final: bool
) -> Picture:
    """Return the picture of the basins of a view's levels, all over the same cells."""
    axes = view.x, view.y
    planes = [plane_of(basin, "omega_inf", folded, axes) for basin in basins]
    shades = [_with_nice_scale(shade) for shade in shades_of(planes, "omega_inf")]
    classes = list(map(classes_of, planes))
    images = [coloured(*pair, shades) for pair in zip(planes, classes, strict=True)]
    named = legend_colours(planes, classes, shades)
    legend = {
        name.replace(r"\omega_\infty", "ω∞").replace("$", ""): to_hex(colour)
        for name, colour in named.items()
    }
    share = None
    if len(planes) == 2:
        differs = np.asarray(planes[0].columns["outcome"] != planes[1].columns["outcome"])
        share = float(np.mean(differs))
        for image in images:
            hatch(image, differs)
    scale = float(shades[0].norm.vmax or 0.0) if shades else 0.0
    return Picture(
        view, size, is_final, tuple(images), legend, scale, tuple(basins), tuple(planes), share
    )


def _with_nice_scale(shade: Shade) -> Shade:
    """Return the shade with a scale that ends at a round number."""
    end = rounded_up(float(shade.norm.vmax or 1.0), NICE)
    return shade._replace(norm=Normalize(-end, end))


def rounded_up(least: float, factors: Sequence[float]) -> float:
    """Return the first of the factors times a power of ten that is not below a number."""
    decade = 10.0 ** math.floor(math.log10(least))
    return next(k * decade for k in factors if k * decade >= least * (1 - 1e-12))


def hatch(image: UInt8[np.ndarray, "Y X 4"], inside: Bool[np.ndarray, "Y X"]) -> None:
    """Hatch and outline a region of a picture, in place.

    Black and white side by side show on every colour; the outline makes a thin band as easy to see
    as a broad one.
    """
    rows, columns = inside.shape
    period = max(4, 2 * max(rows, columns) // STRIPES)
    phase = np.add.outer(np.arange(rows), np.arange(columns)) % period
    wide = max(1, period // 4)
    whole = np.pad(inside, 1, mode="edge")
    inner = whole[:-2, 1:-1] & whole[2:, 1:-1] & whole[1:-1, :-2] & whole[1:-1, 2:]
    image[inside & (phase >= wide) & (phase < 2 * wide)] = 255
    image[inside & ((phase < wide) | ~inner)] = 0, 0, 0, 255


def shares(basin: Basin) -> str:
    """Return the shares of the outcomes in a picture, and the certified share, as text."""
    outcome = basin.outcome
    shown = [
        f"{kind.name.lower()} {percent(float(np.mean(outcome == kind)))}"
        for kind in (Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED)
        if np.any(outcome == kind)
    ]
    certified = percent(float(np.mean(basin.certified)))
    return f"{', '.join(shown)}; {certified} of the outcomes certified for this level"


def colour_scale() -> list[str]:
    """Return colours from the most negative to the most positive ω∞."""
    return [to_hex(SIGNED(place)) for place in np.linspace(0.0, 1.0, 9)]
