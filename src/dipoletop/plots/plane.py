"""What a map of outcomes shows, before it is drawn: two axes, classes, colours, title."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize, to_rgb

from .._base.checks import refuse
from .._base.types import Outcome, Stop
from .._maps.basin import Basin
from .._maps.symmetry import unfold

CLASSES: dict[tuple[Outcome, Stop], tuple[str, str]] = {
    (Outcome.RESIDUAL, Stop.NONE): ("residual rotation", "#0072b2"),
    (Outcome.STOP, Stop.ROTATING): ("stop, rotating", "#202020"),
    (Outcome.STOP, Stop.WOBBLING): ("stop, wobbling", "#9f9f9f"),
    (Outcome.STOP, Stop.TUMBLING): ("stop, tumbling", "#9f6040"),
    (Outcome.STOP, Stop.AXIS): ("stop, fixed axis", "#4000ff"),
    (Outcome.STOP, Stop.NONE): ("stop", "#606060"),
    (Outcome.UNDECIDED, Stop.NONE): ("undecided", "#66ff33"),
    (Outcome.FAILED, Stop.NONE): ("failed", "#df20ff"),
}
"""What a start can be: its name and its flat colour. With normal and with colour-blind eyes any
two differ plainly, from each other and from the shades of `SIGNED`."""

SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#8e2f00", "#e8853c", "#f7f3ee", "#5fa2d4", "#08488e"]
)
BLUES = LinearSegmentedColormap.from_list("residual", ["#deebf7", "#6baed6", "#08306b"])
BROWNS = LinearSegmentedColormap.from_list("stop", ["#feeed8", "#ec8a32", "#5f2003"])

SYMBOLS = {
    "phi": r"$\varphi$",
    "w3": r"$\omega_3$",
    "w_perp": r"$\omega_\perp$",
    "w1": r"$\omega_1$",
    "w2": r"$\omega_2$",
    "delta": r"$\delta$",
    "amplitude": r"$|\omega_0|$",
    "theta": r"$\vartheta$",
}
"""Names of axes that have a symbol; another name stands for itself."""


class Shade(NamedTuple):
    """How the starts of one outcome are shaded by a column of the basin."""

    outcome: Outcome
    column: str
    colours: Colormap
    norm: Normalize
    label: str
    legend: dict[str, float]
    """Entries of the legend, and where in `colours` each has its colour."""


class Plane(NamedTuple):
    """A basin over two axes, rows along y, both rising."""

    x: str
    y: str
    xs: Float[np.ndarray, "X"]
    ys: Float[np.ndarray, "Y"]
    columns: dict[str, np.ndarray]
    """`outcome`, `stop` and, if shaded, a third; shape (Y, X)."""
    title: str


def plane(
    basin: Basin, shading: str | None, extend: bool, names: tuple[str | None, str | None]
) -> Plane:
    """Two axes and the columns over them; axes of length 1 become part of the title."""
    if not basin.coords:
        refuse("basin", "be over a grid", "is over a sample, which has no axes to map")
    long = [name for name, n in zip(basin.dims, basin.shape, strict=True) if n > 1]
    if len(long) != 2 or any(basin.coords[name].ndim > 1 for name in long):
        refuse(
            "basin",
            "have exactly two axes of numbers that are longer than 1",
            f"has {lengths(basin)}; sweep a grid with a single value on every other axis",
        )
    x, y = _choose(long, *names)
    shown = ["outcome", "stop"] + ([shading] if shading else [])
    needed = {name: basin.columns[name] for name in shown}
    whole = dataclasses.replace(basin, columns=needed)
    whole = unfold(whole) if extend else whole
    order = [np.argsort(whole.coords[name]) for name in (y, x)]
    columns = {}
    for name in shown:
        column = whole.column(name).squeeze()
        columns[name] = (column if long == [y, x] else column.T)[np.ix_(*order)]
    ys, xs = (
        np.asarray(whole.coords[name][at], float) for name, at in zip((y, x), order, strict=True)
    )
    return Plane(x, y, xs, ys, columns, _title(basin))


def lengths(basin: Basin) -> str:
    """The axes of a basin in words."""
    return ", ".join(f"{name} ({n})" for name, n in zip(basin.dims, basin.shape, strict=True))


def _choose(long: list[str], x: str | None, y: str | None) -> tuple[str, str]:
    for argument, name in (("x", x), ("y", y)):
        if name is not None and name not in long:
            refuse(argument, f"be {long[0]!r} or {long[1]!r}", f"is {name!r}")
    if x is not None and x == y:
        refuse("y", "be the other axis than `x`", f"is {y!r} too")
    if x is None:
        free = [name for name in long if name != y]
        x = "phi" if "phi" in free else free[-1]
    return x, next(name for name in long if name != x)


def _title(basin: Basin) -> str:
    """The level; the values that are fixed; what is certified."""
    fixed = [
        f"{SYMBOLS.get(name, name)} = {', '.join(_number(v) for v in np.ravel(values))}"
        for name, values in basin.coords.items()
        if len(values) == 1
    ]
    share = float(np.mean(basin.certified))
    words = {0.0: "no outcome", 1.0: "all outcomes"}
    which = words.get(share, f"{percent(share)} of the outcomes")
    certified = f"{which} certified for this level"
    return f"{sentence(basin.level)}\n{', '.join([*fixed, certified])}"


def sentence(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def _number(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def percent(share: float) -> str:
    """To 0.1 %; 0 % means none and 100 % all."""
    rounded = round(share * 1000) / 10
    if 0 < share < 1 and rounded in (0, 100):
        return "> 99.9 %" if rounded else "< 0.1 %"
    return f"{rounded:g} %"


def shades(shading: str | None, planes: list[Plane]) -> list[Shade]:
    """One scale for every outcome that is shaded and occurs, common to all planes."""
    if shading is None:
        return []
    residual, stop = (
        np.concatenate([p.columns[shading][p.columns["outcome"] == outcome] for p in planes])
        for outcome in (Outcome.RESIDUAL, Outcome.STOP)
    )
    if shading == "omega_inf":
        if residual.size == 0:
            return []
        most = float(np.max(np.abs(residual))) or 1.0
        label = r"$\omega_\infty = \tau_0\Omega_\infty$ (dimensionless)"
        signs = {r"residual, $\omega_\infty > 0$": 0.85, r"residual, $\omega_\infty < 0$": 0.15}
        norm = Normalize(-most, most)
        return [Shade(Outcome.RESIDUAL, shading, SIGNED, norm, label, signs)]

    # A start that is decided at once has τ = 0, below every logarithmic scale, and a few next to
    # the boundary take very long: the ends of the scale are open.
    times = np.concatenate([residual, stop])
    times = times[times > 0] if np.any(times > 0) else np.ones(1)
    least, most = np.percentile(times, [0.5, 99.5])
    norm = LogNorm(least, max(most, 10 * least), clip=True)
    return [
        Shade(outcome, shading, colours, norm, rf"$\tau$ when {name} is certain", {name: 0.6})
        for outcome, values, colours, name in (
            (Outcome.RESIDUAL, residual, BLUES, "residual rotation"),
            (Outcome.STOP, stop, BROWNS, "stop"),
        )
        if values.size
    ]


def kinds(plane: Plane) -> Int[np.ndarray, "Y X"]:
    """Which of `CLASSES` every start is; a way of stopping counts for STOP only."""
    outcome, stop = plane.columns["outcome"], plane.columns["stop"]
    found = np.zeros(outcome.shape, np.int8)
    for k, (wanted, way) in enumerate(CLASSES):
        here = outcome == wanted
        found[here & (stop == way) if wanted == Outcome.STOP else here] = k
    return found


def paint(
    plane: Plane, kinds: Int[np.ndarray, "Y X"], shades: list[Shade]
) -> UInt8[np.ndarray, "Y X 4"]:
    """The colour of every start, RGBA."""
    flat = np.array([(*to_rgb(colour), 1.0) for _, colour in CLASSES.values()])
    image = np.round(255 * flat).astype(np.uint8)[kinds]
    for shade in shades:
        here = plane.columns["outcome"] == shade.outcome
        values = np.asarray(plane.columns[shade.column][here], np.float32)
        image[here] = shade.colours(shade.norm(values), bytes=True)
    return image


def entries(kinds: Int[np.ndarray, "Y X"], shades: list[Shade]) -> dict[str, Any]:
    """Name and colour of every class that occurs, in the order of `CLASSES`."""
    counts = np.bincount(kinds.ravel(), minlength=len(CLASSES)).tolist()
    shaded = {shade.outcome: shade for shade in shades}
    colours: dict[str, Any] = {}
    for count, ((outcome, _), (label, colour)) in zip(counts, CLASSES.items(), strict=True):
        if count == 0:
            continue
        if outcome in shaded:
            shade = shaded[outcome]
            colours |= {name: shade.colours(at) for name, at in shade.legend.items()}
        elif count < kinds.size / 1000:  # too few to be found in the picture
            colours[f"{label} ({count} start{'s' if count > 1 else ''})"] = colour
        else:
            colours[label] = colour
    return colours
