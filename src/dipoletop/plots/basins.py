"""Pictures of basins and trajectories, in colours that colour-blind people can tell apart."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MultipleLocator
from matplotlib.transforms import ScaledTranslation

from .._base.checks import flag, instance, refuse
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.symmetry import unfold as unfold
from .._runs.trajectory import Trajectory
from . import plane as _maps
from .plane import Plane, Shade

HATCH = "///"


def basin(
    basin: Basin,
    *,
    ax: Axes | None = None,
    shade: str | None = "omega_inf",
    unfold: bool = True,
    x: str | None = None,
    y: str | None = None,
) -> Axes:
    """A map of the outcomes over the two axes of a grid.

    Args:
        basin: a basin over a grid with two axes longer than 1; the others go into the title.
        ax: where to draw; None makes a figure.
        shade: what shades the outcomes. "omega_inf": residual rotation by its signed ω∞;
            "time": residual rotation and stop by the τ at which they were certain; None: nothing.
        unfold: whether to extend a symmetry cell in φ and ω₃ to the whole plane, by the rules of
            `plots.unfold`; not for a dipole off the principal axes.
        x: the horizontal axis; None means φ if there is one, else the last.
        y: the vertical axis; None means the other one.

    Returns:
        The axes; the title says the level of the equation and what share is certified.

    Raises:
        ValueError: no basin over a grid with two axes longer than 1, a name that is not one of
            them, or another `shade`.
    """
    instance("basin", basin, Basin)
    unfold = flag("unfold", unfold)
    _check_axes(ax)
    if shade not in ("omega_inf", "time", None):
        refuse("shade", "be 'omega_inf', 'time' or None", f"is {shade!r}")
    plane = _maps.plane(basin, shade, unfold, (x, y))
    shades = _maps.shades(shade, [plane])
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 5.4), layout="constrained")
    _draw(ax, plane, shades)
    _colourbars(shades, [ax])
    return ax


def compare(first: Basin, second: Basin, *, axes: Any = None) -> Figure:
    """Two maps side by side in the same colours; hatched where the outcome differs.

    Args:
        first: a basin over a grid with two axes longer than 1.
        second: a basin over the same grid.
        axes: a pair of axes to draw on; None makes a figure.

    Returns:
        The figure; the titles say what share of the starts has another outcome.

    Raises:
        ValueError: the two are not over the same grid, or that is not a plane.
    """
    instance("first", first, Basin)
    instance("second", second, Basin)
    _check_same_grid(first, second)
    pair = (None, None) if axes is None else tuple(np.ravel(axes))
    if len(pair) != 2:
        refuse("axes", "be a pair of axes, or None", f"has {len(pair)}")
    for ax in pair:
        _check_axes(ax, "axes")
    share = float(np.mean(first.outcome != second.outcome))
    planes = [_maps.plane(one, "omega_inf", True, (None, None)) for one in (first, second)]
    shades = _maps.shades("omega_inf", planes)
    if axes is None:
        _, axes = plt.subplots(1, 2, figsize=(12.0, 5.6), layout="constrained", sharey=True)
    one, two = (plane.columns["outcome"] for plane in planes)
    line = f"outcome differs for {_maps.percent(share)} of the starts (hatched)"
    for ax, plane in zip(axes, planes, strict=True):
        _draw(ax, plane._replace(title=f"{plane.title}\n{line}"), shades, one != two)
    axes[1].set_ylabel("")
    _colourbars(shades, list(axes))
    return axes[0].figure


def trajectory(trajectory: Any, *, ax: Axes | None = None) -> Axes:
    """ω₁, ω₂, ω₃ and |ω| against τ on a logarithmic scale (linear up to the first step from 0).

    A dotted line marks ω∞ if the last state is certain to keep a residual rotation, a dashed one
    the law |ω| ∝ τ^{-1/2} if it is certain to stop.

    Args:
        trajectory: what `simulate` returned for a single top.
        ax: where to draw; None makes a figure.

    Returns:
        The axes; the title says the level of the equation.

    Raises:
        ValueError: a batch of trajectories.
    """
    instance("trajectory", trajectory, Trajectory)
    _check_axes(ax)
    if np.ndim(trajectory.ts) != 1:
        refuse("trajectory", "be that of one top", f"has times of shape {trajectory.ts.shape}")
    times, omega = np.asarray(trajectory.ts), np.asarray(trajectory.omega)
    size = np.sqrt(np.sum(omega**2, axis=1))
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    ax.axhline(0.0, color="0.8", linewidth=0.8)
    ax.plot(times, size, color="#202020", linewidth=1.8, label=r"$|\omega|$")
    dashes = (("#0072b2", "-"), ("#d55e00", (0, (5, 1))), ("#009e73", (0, (4, 1, 1, 1))))
    for k, (colour, dash) in enumerate(dashes):
        name = rf"$\omega_{k + 1}$"
        ax.plot(times, omega[:, k], color=colour, linestyle=dash, linewidth=1.3, label=name)
    _asymptote(ax, trajectory, times, size)
    if times[0] > 0:
        ax.set_xscale("log")
    else:
        ax.set_xscale("symlog", linthresh=float(times[1] - times[0]), linscale=0.5)
    ax.set_xlim(times[0], times[-1])
    ax.set_xlabel(r"$\tau = t/\tau_0$")
    ax.set_ylabel(r"$\omega = \tau_0\Omega$ (dimensionless)")
    ax.set_title(_maps.sentence(trajectory.level), fontsize="medium")
    ax.legend(frameon=False, ncols=2)
    return ax


def _asymptote(ax: Axes, trajectory: Any, times, size) -> None:
    """Where it goes, for an equation that can tell from the last state."""
    if not hasattr(trajectory.equation, "verdict"):
        return
    verdict = trajectory.equation.verdict(trajectory.ys[-1])
    if verdict.outcome == Outcome.RESIDUAL and verdict.error < 1e-3:
        label = rf"$\omega_\infty = {float(verdict.omega_inf):.4g}$"
        ax.axhline(float(verdict.omega_inf), color="#0072b2", linestyle=":", label=label)
    elif verdict.outcome == Outcome.STOP:
        late = times >= times[-1] / 30
        law = size[-1] * np.sqrt(times[-1] / times[late])
        ax.plot(times[late], law, color="0.5", linestyle="--", label=r"$\propto\tau^{-1/2}$")


def _check_axes(ax: Any, name: str = "ax") -> None:
    if ax is not None:
        instance(name, ax, Axes, "be axes of matplotlib, or None")


def _check_same_grid(first: Basin, second: Basin) -> None:
    if first.dims != second.dims or first.shape != second.shape:
        was = f"is over {_maps.lengths(second)}"
        refuse("second", f"be over the axes of `first`, {_maps.lengths(first)}", was)
    for name, values in first.coords.items():
        if not np.allclose(values, second.coords[name], rtol=1e-6, atol=1e-12):
            refuse("second", "be over the same grid as `first`", f"has other values of {name}")


def _draw(
    ax: Axes,
    plane: Plane,
    shades: list[Shade],
    differs: Bool[np.ndarray, "Y X"] | None = None,
) -> None:
    """The image, the hatching of what differs, the axes, title and legend."""
    kinds = _maps.kinds(plane)
    colours = _maps.entries(kinds, shades)
    handles: list[Any] = [Patch(facecolor=c, label=label) for label, c in colours.items()]
    xs, image = _close(plane, _maps.paint(plane, kinds, shades))
    _show(ax, xs, plane.ys, image)
    if differs is not None:
        handles.append(_hatch(ax, xs, plane.ys, _close(plane, differs)[1]))
    for name, axis in ((plane.x, ax.xaxis), (plane.y, ax.yaxis)):
        axis.set_label_text(_maps.SYMBOLS.get(name, name))
        if name == "phi":
            _mark_quarters(axis)
    ax.set_title(plane.title, fontsize="medium")
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        # Half an inch below the axes, under their label, however large they are.
        bbox_transform=ax.transAxes + ScaledTranslation(0, -0.5, ax.figure.dpi_scale_trans),
        ncols=min(3, len(handles)),
        frameon=False,
        fontsize="small",
    )


def _close(plane: Plane, image: np.ndarray) -> tuple[Float[np.ndarray, "n"], np.ndarray]:
    """With φ = 2π, which is φ = 0 again, if φ goes round along x."""
    xs = plane.xs
    step = xs[1] - xs[0]
    if plane.x != "phi" or abs(xs[-1] + step - xs[0] - 2 * np.pi) > 1e-3 * step:
        return xs, image
    return np.append(xs, xs[0] + 2 * np.pi), np.concatenate([image, image[:, :1]], 1)


def _show(ax: Axes, xs, ys, image: UInt8[np.ndarray, "Y X 4"]) -> None:
    """An image if both axes are even; else a mesh of cells, on logarithmic axes if those are."""
    scales = [_scale(values) for values in (xs, ys)]
    x_edges, y_edges = (_edges(v, scale) for v, scale in zip((xs, ys), scales, strict=True))
    if scales == ["even", "even"]:
        extent = (*x_edges[[0, -1]].tolist(), *y_edges[[0, -1]].tolist())
        ax.imshow(image, origin="lower", extent=extent, aspect="auto", rasterized=True)
        return
    ax.pcolormesh(x_edges, y_edges, image, rasterized=True)
    for scale, apply in zip(scales, (ax.set_xscale, ax.set_yscale), strict=True):
        if scale == "log":
            apply("log")


def _scale(values: Float[np.ndarray, "n"]) -> str:
    def even(points) -> bool:
        return bool(np.ptp(np.diff(points)) < 1e-3 * np.mean(np.diff(points)))

    if even(values):
        return "even"
    return "log" if values[0] > 0 and even(np.log(values)) else "uneven"


def _edges(values: Float[np.ndarray, "n"], scale: str) -> Float[np.ndarray, "n+1"]:
    """Borders of the cells round the values, halfway between them."""
    if scale == "log":
        return np.exp(_edges(np.log(values), "even"))
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def _hatch(ax: Axes, xs, ys, differs: Bool[np.ndarray, "Y X"]) -> Patch:
    """Hatching and an outline, as wide round a thin band as round a broad one."""
    if differs.any():
        height = differs.astype(np.float32)
        areas = ax.contourf(xs, ys, height, levels=[0.5, 1.5], colors="none")
        areas.remove()  # it keeps a copy of the grid; its paths are enough
        # Black on white shows on every colour, so the lines are drawn twice.
        for colour, width in (("white", 1.8), ("black", 0.7)):
            with plt.rc_context({"hatch.linewidth": width, "hatch.color": colour}):
                marks = PathCollection(areas.get_paths(), hatch=HATCH, transform=ax.transData)
            marks.set(facecolor="none", edgecolor=colour, linewidth=width, rasterized=True)
            ax.add_collection(marks, autolim=False)
    return Patch(facecolor="white", edgecolor="black", hatch=HATCH, label="outcome differs")


def _mark_quarters(axis: Any) -> None:
    """Ticks at multiples of π/2."""
    names = {-2: r"$-\pi$", -1: r"$-\pi/2$", 0: "0", 1: r"$\pi/2$", 2: r"$\pi$", 3: r"$3\pi/2$"}

    def name(value: float, _: Any) -> str:
        return names.get(round(value / (np.pi / 2)), rf"${value / np.pi:g}\pi$")

    axis.set_major_locator(MultipleLocator(np.pi / 2))
    axis.set_major_formatter(FuncFormatter(name))


def _colourbars(shades: list[Shade], axes: list[Axes]) -> None:
    """One for each; those of several outcomes stand side by side and share their ticks."""
    for k, shade in enumerate(shades):
        scale = ScalarMappable(shade.norm, shade.colours)
        extend = "both" if shade.column == "time" else "neither"
        bar = axes[0].figure.colorbar(scale, ax=axes, label=shade.label, pad=0.02, extend=extend)
        bar.ax.tick_params(which="both", labelright=k == 0)
