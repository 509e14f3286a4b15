"""Atlases: how bodies end, over the triangle of bodies or the triangle of dipoles."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon

from .._base.checks import flag, instance
from .._base.refusals import refuse
from ..atlases import BODY_CORNERS, STOPS_AT, Atlas, Ending, saddle_node_border, spin_border
from ..particles import paper_particles
from .axes import several_axes
from .style import BLACK, MM, STYLE, WIDE, percent

DIPOLE_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
"""The corners n₁² = 1, n₃² = 1 and n₂² = 1 of the triangle of dipoles, in this order."""
STOPS = {
    Ending.SPIN_3: ("stop, spinning about $J_3$", "#202020"),
    Ending.TUMBLING_LOW: ("stop, tumbling about $J_3$", "#9f6040"),
    Ending.SPIN_1: ("stop, spinning about $J_1$", "#8e72b5"),
    Ending.TUMBLING_HIGH: ("stop, tumbling about $J_1$", "#ebb97f"),
}
"""Name and colour of every kind of stop."""
RATIOS = mpl.colormaps["YlGnBu"]
"""Colours of the mean L∞/L₀."""
MOST = 0.75
"""L∞/L₀ at the dark end of the colours; only the thinnest needles have a larger mean."""
HEIGHT = 74 * MM
ALONE = 110 * MM, 100 * MM
"""Size of the figure of a single atlas."""
DENSE = "/////"


def atlas(
    atlases: Atlas | Sequence[Atlas],
    *,
    particles: bool = True,
    axes: Axes | Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw how bodies end: residual rotation coloured by its mean L∞/L₀, stops by their kind.

    Each atlas has a panel. In hatched cells the outcome depends on the start. Over bodies, lines
    show where a pure spin about J₃ and tumbling meet, J₂J₁² = (J₃ − J₂)(J₃ − J₁)² (dipole on J₂),
    and where tumbling becomes possible (dipole on J₁). They are computed independently of the map,
    so that each checks the other.

    Args:
        atlases: one atlas or several.
        particles: whether to mark the particles of the paper, over bodies.
        axes: matplotlib axes to draw on, one for each atlas; None makes a figure.

    Returns:
        The figure; `plots.save` writes it.

    Raises:
        ValueError: an argument that is not an atlas, or another number of axes.
    """
    must = "be an Atlas or a sequence of them"
    several = [atlases] if isinstance(atlases, Atlas) else atlases
    maps = list(instance("atlases", several, Sequence, must))
    for each in maps:
        instance("atlases", each, Atlas, must)
    if not maps:
        refuse("atlases", must, "is empty")
    marked = flag("particles", particles)
    must = f"be {len(maps)}, one for each atlas"
    given = None if axes is None else several_axes(axes, len(maps), must)
    with mpl.rc_context(STYLE):
        if given is None:
            size = (WIDE, HEIGHT) if len(maps) > 1 else ALONE
            figure = Figure(size, layout="constrained")
            given = list(figure.subplots(1, len(maps), squeeze=False)[0])
        for k, (ax, each) in enumerate(zip(given, maps, strict=True)):
            _draw(ax, each, marked, first=k == 0)
        result: Any = given[0].figure
        if any(np.any(each.ratio > 0) for each in maps):
            colours = ScalarMappable(Normalize(0, MOST), RATIOS)
            label = r"mean $L_\infty/L_0$, residual rotation"
            result.colorbar(colours, ax=given, label=label, pad=0.01, shrink=0.9, aspect=25)
        handles = _legend(maps)
        columns = min(len(handles), 3 if len(maps) > 1 else 2)
        result.legend(handles=handles, loc="outside lower center", ncols=columns)
    return result


def _draw(ax: Axes, atlas: Atlas, particles: bool, *, first: bool) -> None:
    """Draw one atlas."""
    over_bodies = atlas.dipole_axis is not None
    corners = BODY_CORNERS if over_bodies else DIPOLE_CORNERS[[0, 2, 1]]
    polygons = atlas.corners @ corners
    # Edges have the colour of the cell, so that no background shows between cells.
    colours = _colours(atlas)
    cells = PolyCollection(list(polygons), facecolors=colours, edgecolors=colours, lw=0.6)
    cells.set_rasterized(True)
    ax.add_collection(cells)
    ending = atlas.ending
    for chance, colour in ((Ending.BOTH, BLACK), (Ending.STOPS, "white")):
        _hatch(ax, polygons[ending == chance], colour)
    ax.add_patch(Polygon(corners, fill=False, lw=0.6, ec=BLACK))
    if over_bodies:
        _finish_bodies(ax, atlas, particles, first=first)
    else:
        _finish_dipoles(ax, atlas)


def _colours(atlas: Atlas) -> Float[np.ndarray, "N 4"]:
    """Return the colour of every cell, from its mean L∞/L₀ or its most frequent kind of stop."""
    places = list(STOPS_AT)
    most = np.argmax(atlas.probability[:, places], axis=1)
    flat = np.array([(*to_rgb(STOPS[STOPS_AT[place]][1]), 1.0) for place in places])
    return np.where(
        (atlas.residual > 0)[:, None], RATIOS(np.clip(atlas.ratio / MOST, 0, 1)), flat[most]
    )


def _hatch(ax: Axes, polygons: Float[np.ndarray, "M 3 2"], colour: str) -> None:
    """Hatch cells with a pattern that is continuous across them."""
    if len(polygons):
        with mpl.rc_context({"hatch.linewidth": 0.6}):
            marks = PolyCollection(
                list(polygons), hatch=DENSE, facecolors="none", edgecolors=colour, lw=0
            )
        marks.set_rasterized(True)
        ax.add_collection(marks)


def _finish_bodies(ax: Axes, atlas: Atlas, particles: bool, *, first: bool) -> None:
    """Draw borders, particles, labels and axes of a map over bodies."""
    ratios = np.linspace(0.385, 2 / 3 - 1e-4, 120)
    if atlas.dipole_axis == 1:
        ax.plot(ratios, saddle_node_border(ratios), color=BLACK, lw=0.8)
    if atlas.dipole_axis == 2:
        ratios = np.linspace(0.0, 1.0, 400)
        border = spin_border(ratios)
        real = (border >= ratios) & (border >= 1 - ratios)
        ax.plot(ratios[real], border[real], color="white", lw=1.6)
        ax.plot(ratios[real], border[real], color=BLACK, lw=0.7)
    if particles:
        _mark_particles(ax)
    for name, (x, y), (dx, dy), align in (
        ("needle", BODY_CORNERS[0], (0, 3), "left"),
        ("disc", BODY_CORNERS[1], (-6, -3), "right"),
        ("sphere", BODY_CORNERS[2], (0, 3), "right"),
    ):
        place = {"xytext": (dx, dy), "textcoords": "offset points", "ha": align}
        ax.annotate(name, (x, y), color="0.35", annotation_clip=False, **place)
    ax.set_title(f"Dipole on the axis of $J_{atlas.dipole_axis}$\n{_shares(atlas)}", pad=12)
    ax.set(xlim=(-0.02, 1.02), ylim=(0.47, 1.02), xlabel="$J_1/J_3$")
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
    ax.set_yticks([0.5, 0.75, 1], ["½", "¾", "1"] if first else [])
    if first:
        ax.set_ylabel("$J_2/J_3$")
    ax.spines[["top", "right"]].set_visible(False)


def _shares(atlas: Atlas) -> str:
    """Return the share of bodies that keep a residual rotation, in words."""
    always = float(np.mean(atlas.ending == Ending.RESIDUAL))
    some = float(np.mean(atlas.ending == Ending.BOTH))
    if always + some == 0:
        return "never residual"
    by_start = f", by the start {percent(some)}" if some else ""
    return f"residual {percent(always)}{by_start}" if always < 1 else "always residual"


def _mark_particles(ax: Axes) -> None:
    """Mark the particles of the paper at their moments of inertia; equal ones share a mark."""
    places: dict[tuple[float, float], list[str]] = {}
    for rotator in paper_particles():
        moments = np.linalg.eigvalsh(np.asarray(rotator.particle.inertia) * 1e30)
        j1, j2 = np.round(moments[:2] / moments[2], 4).tolist()
        names = places.setdefault((j1, j2), [])
        name = rotator.name.split()[0]
        if name not in names:
            names.append(name)
    for (x, y), names in places.items():
        ax.plot(x, y, "o", ms=3.5, mfc="white", mec=BLACK, mew=0.8, clip_on=False, zorder=5)
        # The labels are in the empty corners below the triangle.
        left = x < 0.5
        at = (0.02 if left else 1.0, 0.62 if left else 0.69 if x > 0.9 else 0.53)
        ax.annotate(
            ",\n".join([names[0], ", ".join(names[1:])]) if names[1:] else names[0],
            (x, y),
            at,
            ha="left" if left else "right",
            va="center",
            fontsize=6.5,
            arrowprops={"arrowstyle": "-", "lw": 0.5, "color": "0.4", "shrinkB": 3},
        )


def _finish_dipoles(ax: Axes, atlas: Atlas) -> None:
    """Draw labels and axes of a map over dipoles."""
    offsets = {"$J_1$": (-4, -9), "$J_3$": (4, -9), "$J_2$": (0, 4)}
    for corner, (name, offset) in zip(DIPOLE_CORNERS, offsets.items(), strict=True):
        place = {"xytext": offset, "textcoords": "offset points", "ha": "center"}
        ax.annotate(f"dipole on {name}", corner, annotation_clip=False, **place)
    j1, j2, _ = atlas.moments[0]
    body = f"$J_1/J_3 = {j1:.4g}$, $J_2/J_3 = {j2:.4g}$"
    ax.set_title(f"Dipoles by $n_1^2$, $n_2^2$, $n_3^2$; {body}", loc="center", pad=18)
    ax.set(xlim=(-0.08, 1.08), ylim=(-0.02, 0.9), aspect="equal")
    ax.axis("off")


def _legend(maps: list[Atlas]) -> list[Patch]:
    """Return legend entries of the classes that occur."""
    endings = np.concatenate([each.ending for each in maps])
    handles = []
    if np.any(endings == Ending.RESIDUAL):
        handles.append(Patch(facecolor=RATIOS(0.6), label="residual, from every start"))
    if np.any(endings == Ending.BOTH):
        label = "residual or a stop, by the start"
        handles.append(Patch(fc=RATIOS(0.2), ec=BLACK, hatch=DENSE, lw=0, label=label))
    for place, ending in sorted(STOPS_AT.items(), key=lambda item: list(STOPS).index(item[1])):
        if any(np.any(each.probability[each.residual == 0][:, place] > 0) for each in maps):
            name, colour = STOPS[ending]
            handles.append(Patch(facecolor=colour, label=name))
    if np.any(endings == Ending.STOPS):
        label = "either of two, by the start"
        handles.append(Patch(fc="0.4", ec="white", hatch=DENSE, lw=0, label=label))
    return handles
