"""The figures of `dipoletop figures`: 1, 2 and 3 of the paper, and three further ones.

Every function computes its data and returns a matplotlib `Figure`. `save` writes it with embedded
fonts, each time with the same bytes.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnnotationBbox, DrawingArea
from matplotlib.patches import Ellipse
from matplotlib.ticker import MultipleLocator

from .. import planar, plots
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.grids import Sample
from .._runs.trajectory import Trajectory
from ..equations.levels import Level
from ..equations.rotator import RotatorFull
from ..equations.rotator_curves import closed_manifold, critical_manifold, separatrix
from ..equations.transverse import TransverseReduced, equation_at
from ..plots.style import COMPONENTS, MM, ORANGE, STYLE, WIDE, YELLOW, hatch, level_line, percent
from ..plots.style import save as save
from ..stability import threshold
from . import figure_data

NARROW = 85 * MM
"""Width of one column of a journal in inches."""
SHORT = {
    Level.ORDER_1: "order 1",
    Level.ORDER_2: "order 2",
    Level.SEMI: "semi-reduced",
    Level.FULL: "full",
}
"""Short names of the levels that are shown."""
BODY_SHAPES = (-0.94, -0.5, 0.0, 0.5, 0.9)
"""δ of the bodies that are drawn above the shares."""
NEEDLE = 0.99
"""The largest δ that is shown."""
# With these sizes the sweeps of shares and of maps have tiles of one size, and compile once.
STARTS, MAP_SIZE, MAP_STRIDE = 1024, 280, 9


@mpl.rc_context(STYLE)  # which other figures do not get
def ends_order_1() -> Figure:
    """Draw shares of the outcomes against the shape δ, at order 1."""
    critical = threshold(TransverseReduced, 0.05, -0.9, 0.5)
    basin = figure_data.outcomes_by_shape(Level.ORDER_1, _shapes(), figure_data.even_starts(STARTS))
    figure, ax, strip = _shape_axes()
    _stack_shares(ax, basin)
    _mark_shapes(ax, {critical: rf"$\delta = {critical:.1f}$", 0.0: r"$\delta = 0$"})
    _name_regimes(strip, [-1, critical, 0, NEEDLE], ["stop", "both", "residual rotation"])
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(_heading("Reduced equation, order 1 (the paper's)", basin))
    return figure


@mpl.rc_context(STYLE)
def ends_full() -> Figure:
    """Draw shares of the outcomes by the semi-reduced equation, and dots by the full equation.

    At |ω| = 0.2 the tested regions decide every run of the full equation up to δ = 0.3.
    """
    critical = [planar.critical_delta(prolate=prolate) for prolate in (False, True)]
    basin = figure_data.outcomes_by_shape(Level.SEMI, _shapes(), figure_data.even_starts(STARTS))
    sample = Sample(128, figure_data.AMPLITUDE, seed=1).points(np.arange(128))
    full = figure_data.outcomes_by_shape(Level.FULL, [-0.9, -0.6, -0.3, -0.1, 0.3], sample)
    figure, ax, strip = _shape_axes()
    _stack_shares(ax, basin)
    _add_full_shares(ax, full)
    _mark_shapes(ax, {d: rf"$\delta_{{c{k}}} = {d:.4f}$" for k, d in enumerate(critical, 1)})
    _name_regimes(strip, [-1, 0, critical[1], NEEDLE], ["both", "residual rotation", "both"])
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(_heading("Semi-reduced equation", basin))
    return figure


def _heading(level: str, basin: Basin) -> str:
    """Return the title: level, number of starts and certified share."""
    words = f"{percent(float(np.mean(basin.certified)))} certified"
    n = basin.shape[1]
    return rf"{level}: {n} isotropic starts at each $\delta$, $|\omega|$ = 0.2, {words}"


def _shapes() -> Float[np.ndarray, "d"]:
    """Return the values of δ; one of them, 0.756, is just above δ_c2."""
    return np.sort([*np.linspace(-1, 0.975, 80), 0.756, NEEDLE])


def _shape_axes() -> tuple[Figure, Axes, Axes]:
    """Make a figure with axes over δ and a strip above them with drawings of the bodies."""
    figure = Figure((WIDE, 95 * MM), layout="constrained")
    strip, ax = figure.subplots(2, 1, sharex=True, height_ratios=[1, 3.2])
    ax.set(xlim=(-1, NEEDLE), ylim=(0, 1), ylabel="share of the starts")
    ax.set_xlabel(r"$\delta = 1 - I_3/I_1$")
    strip.set(ylim=(0, 1), yticks=[])
    strip.spines[:].set_visible(False)
    strip.tick_params(bottom=False, labelbottom=False)
    moments = strip.secondary_xaxis("top", functions=(lambda x: 1 - x, lambda x: 1 - x))
    moments.set_xlabel(r"$I_3/I_1$")
    for delta in BODY_SHAPES:
        strip.add_artist(_spheroid(delta))
    return figure, ax, strip


def _spheroid(delta: float) -> AnnotationBbox:
    """Draw a homogeneous upright spheroid, I₃/I₁ = 2a²/(a² + c²), and its dipole."""
    slender = np.sqrt(2 / (1 - delta) - 1)  # c/a
    a = 7.5 * min(1, slender ** (-2 / 3))  # points; a slender body is drawn thinner
    area = DrawingArea(40, 36)
    area.add_artist(Ellipse((20, 18), 2 * a, 2 * a * slender, fc="0.85", ec="0.3", lw=0.7))
    area.add_artist(Line2D([20 - a, 20 + a], [18, 18], color=ORANGE, lw=1.2))
    area.add_artist(Line2D([20 + a], [18], color=ORANGE, marker=">", ms=3))
    return AnnotationBbox(area, (delta, 0.66), frameon=False, pad=0)


def _stack_shares(ax: Axes, basin: Basin) -> None:
    """Draw the shares of all outcomes, stacked."""
    shares = figure_data.shares(basin)
    level = basin.level.split(" (")[0]
    ax.stackplot(
        basin.coords["delta"],
        *(outcome.share for outcome in shares),
        colors=[outcome.colour for outcome in shares],
        labels=[f"{outcome.label} ({level})" for outcome in shares],
        lw=0,
    )


def _add_full_shares(ax: Axes, basin: Basin) -> None:
    """Draw shares of residual rotation by the full equation, with 95 % intervals."""
    shares = {outcome.label: outcome for outcome in figure_data.shares(basin)}
    residual = shares["residual rotation"]
    bars = np.abs(np.stack([residual.low, residual.high]) - residual.share)
    label = f"residual, full equation: {basin.shape[1]} random starts, 95 % interval, not certified"
    style: dict[str, Any] = {"fmt": "o", "ms": 4, "capsize": 2, "clip_on": False, "zorder": 5}
    colours: Any = {"color": "white", "mfc": ORANGE, "ecolor": ORANGE}
    ax.errorbar(basin.coords["delta"], residual.share, bars, **style, **colours, label=label)


def _mark_shapes(ax: Axes, places: dict[float, str]) -> None:
    """Draw a labelled vertical line at every δ of `places`."""
    for delta, label in places.items():
        ax.axvline(delta, color="white", lw=2.4)
        ax.axvline(delta, color="black", lw=0.8, ls="--")
        text = ax.text(delta + 0.015, 0.92, label, ha="left", va="center")
        text.set_bbox({"fc": "white", "ec": "none", "pad": 1.5})


def _name_regimes(strip: Axes, limits: list[float], names: list[str]) -> None:
    """Draw an arrow over every range of δ, labelled with the outcomes that occur there."""
    for low, high, name in zip(limits, limits[1:], names, strict=False):
        strip.annotate("", (low, 0), (high, 0), arrowprops={"arrowstyle": "<->", "lw": 0.7})
        strip.text((low + high) / 2, 0.05, name, ha="center", va="bottom")


@mpl.rc_context(STYLE)
def two_starts() -> Figure:
    """Plot ω₁, ω₂, ω₃ against τ from φ₀ = π/30 (residual) and π/3 (stop), order 1 and full."""
    times = np.concatenate([[0], np.geomspace(0.3, 3000, 500)])
    figure = Figure((WIDE, 78 * MM), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    titles = (
        r"(a)  $\varphi_0 = \pi/30$: residual rotation",
        r"(b)  $\varphi_0 = \pi/3$: stop",
    )
    for ax, phi, title in zip(panels, (np.pi / 30, np.pi / 3), titles, strict=True):
        ax.axhline(0, color="0.8", lw=0.6)
        for level in (Level.ORDER_1, Level.FULL):
            _draw_motion(ax, level, figure_data.motion(level, phi, times))
        ax.set(xscale="log", xlim=(1, times[-1]), xlabel=r"$\tau = t/\tau_0$")
        ax.set_title(title)
    panels[0].set_ylabel(r"$\omega = \tau_0\Omega$")
    levels = {"order 1 (the paper's)": (1.4, "-"), "full, physical branch": (0.9, "--")}
    handles = [Line2D([], [], color=colour, label=name) for name, colour in COMPONENTS]
    handles += [Line2D([], [], color="0.3", lw=w, ls=s, label=k) for k, (w, s) in levels.items()]
    handles.append(Line2D([], [], color="0.3", lw=0.9, ls=":", label=r"$\omega_\infty$"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _draw_motion(ax: Axes, level: Level, trajectory: Trajectory) -> None:
    """Plot the components of ω, and ω∞ of a residual rotation."""
    full = level is Level.FULL
    width, dash = (0.9, (0, (4, 1.5))) if full else (1.4, "-")
    for k, (_, colour) in enumerate(COMPONENTS):
        ax.plot(trajectory.ts, trajectory.omega[:, k], color=colour, lw=width, ls=dash)
    equation: Any = trajectory.equation
    verdict = equation.verdict(trajectory.ys[-1])
    if verdict.outcome == Outcome.RESIDUAL:
        value = float(verdict.omega_inf)
        ax.axhline(value, color="0.3", lw=0.9, ls=":")
        text = rf"$\omega_\infty$ = {value:.4f} ({SHORT[level]})"
        place: Any = {"va": "bottom" if full else "top", "ha": "right"}
        place |= {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
        ax.annotate(text, (1, value), (-3, 2 if full else -3), **place)


@mpl.rc_context(STYLE)
def rotator_plane() -> Figure:
    """Draw the phase plane of the full plane rotator: separatrices, domains, runaways."""
    figure = Figure((NARROW, 88 * MM), layout="constrained")
    ax = figure.subplots()
    w, top = np.linspace(-2, 2, 401), 2.5
    physical, other = np.asarray(critical_manifold(w)), np.asarray(separatrix(w))
    _draw_domains(ax, w, np.minimum(physical, other), np.maximum(physical, other), top)
    _draw_runaways(ax, 2.0, top)
    ax.plot(w, physical, color="black", lw=2, label="AOC, the physical motions")
    ax.plot(w, other, color="black", lw=1, label="BOD, the motions from rest")
    closed = r"AOC in closed form, $-\omega^3/\sqrt{1+2\omega^2}$"
    ax.plot(w, closed_manifold(w), color=ORANGE, lw=1.2, ls="--", label=closed)
    ax.plot(0, 0, "o", color="black", ms=4)
    _name_points(ax, w, {"AC": physical, "BD": other}, 0.85 * top)
    ax.set(xlim=(-2, 2), ylim=(-top, top), xlabel=r"$\omega$", ylabel=r"$\varpi = d\omega/d\tau$")
    figure.legend(loc="outside lower center")
    return figure


def _name_points(ax: Axes, w: np.ndarray, curves: dict[str, np.ndarray], top: float) -> None:
    """Label points as in the paper: O at rest, and both ends of every curve."""
    places = {"O": (0.0, 0.0)}
    for letters, curve in curves.items():
        inside = np.flatnonzero(np.abs(curve) < top)
        places |= {x: (w[k], curve[k]) for x, k in zip(letters, inside[[0, -1]], strict=True)}
    for letter, place in places.items():
        aside = -16 if place[0] > 1.8 else 7
        text = ax.annotate(letter, place, (aside, 5), textcoords="offset points", zorder=6)
        text.set_bbox({"fc": "white", "ec": "none", "pad": 0.6, "alpha": 0.8})


def _draw_domains(ax: Axes, w: np.ndarray, low: np.ndarray, high: np.ndarray, top: float) -> None:
    """Draw the four domains of runaways, with the limits of ω in the past and in the future."""
    right = w >= 0
    areas = {
        (0.0, 1.9): (w, high, np.full_like(w, top), "#e3eef6"),
        (0.0, -1.9): (w, np.full_like(w, -top), low, "#fbeadb"),
        (1.42, 0.45): (w[right], low[right], high[right], "#e2f2ec"),
        (-1.42, -0.45): (w[~right], low[~right], high[~right], "#f3e6ef"),
    }
    for place, (xs, least, most, tint) in areas.items():
        ax.fill_between(xs, least, most, color=tint, lw=0)
        past, future = RotatorFull().domain(jnp.array(place))
        ends = ["+" if sign > 0 else "-" for sign in (int(past), int(future))]
        name = rf"$\omega: {{{ends[0]}}}\infty\to{{{ends[1]}}}\infty$"
        text = ax.text(*place, name, ha="center", va="center", zorder=4)
        text.set_bbox({"fc": tint, "ec": "none", "pad": 1})


def _draw_runaways(ax: Axes, right: float, top: float) -> None:
    """Draw stream lines of the phase plane, with arrows."""
    xs, ys = np.linspace(-right, right, 161), np.linspace(-top, top, 161)
    plane = np.stack(np.meshgrid(xs, ys))
    u, v = np.asarray(RotatorFull()(0.0, jnp.asarray(plane.reshape(2, -1)))).reshape(plane.shape)
    half = np.array([[0, 0.45], [0, 1.1], [0, 1.9], [0.6, 0], [1.1, 0], [1.6, 0]])
    starts = np.concatenate([half, -half])
    style: dict[str, Any] = {"color": "0.45", "linewidth": 0.7, "arrowsize": 0.8, "density": 2}
    ax.streamplot(xs, ys, u, v, start_points=starts, broken_streamlines=False, **style)


@mpl.rc_context(STYLE)
def spectra() -> Figure:
    """Plot λ/w² of slow perturbations of {w, 0, 0} against δ at each level, and the limit w → 0."""
    w, deltas = 0.05, np.linspace(-1, 0.99, 399)
    figure = Figure((WIDE, 85 * MM), layout="constrained")
    real, imaginary = figure.subplots(1, 2, sharex=True)
    widths = {Level.ORDER_1: 1.8, Level.ORDER_2: 4.2, Level.SEMI: 2.2, Level.FULL: 1.6}
    for level, width in widths.items():
        rates, line = figure_data.eigenvalues(level, deltas, w), level_line(level) | {"lw": width}
        real.plot(deltas, np.real(rates), **line, label=[SHORT[level], None])
        imaginary.plot(deltas, np.imag(rates), **line)
    limit, line = figure_data.small_w(deltas), {"color": "black", "lw": 0.6}
    real.plot(deltas, np.real(limit), **line, label=[r"limit $w \to 0$, all but order 1", None])
    imaginary.plot(deltas, np.imag(limit), **line)
    _mark_thresholds(real, w)
    real.set(xlim=(-1, 1), ylim=(-5, 1.5), ylabel=r"Re $\lambda/w^2$")
    imaginary.set(ylim=(-1.1, 1.1), ylabel=r"Im $\lambda/w^2$")
    for ax in (real, imaginary):
        ax.axhline(0, color="0.6", lw=0.6, zorder=0)
        ax.set_xlabel(r"$\delta = 1 - I_3/I_1$")
        ax.xaxis.set_major_locator(MultipleLocator(0.5))
    figure.legend(*real.get_legend_handles_labels(), loc="outside lower center", ncols=5)
    figure.suptitle(rf"Motions beside the residual rotation $\{{w, 0, 0\}}$, $w$ = {w:g}")
    return figure


def _mark_thresholds(ax: Axes, w: float) -> None:
    """Mark where the line loses its stability: order 1, and order 2 beyond its validity."""
    for level, bracket in ((Level.ORDER_1, (-0.9, 0.5)), (Level.ORDER_2, (0.5, 0.999))):
        delta = threshold(lambda d, level=level: equation_at(level, d), w, *bracket)
        ax.plot(delta, 0, "o", color="white", mec="black", ms=5, zorder=5)
        place: Any = {"ha": "center", "va": "bottom", "textcoords": "offset points"}
        text = rf"{SHORT[level]}: $\delta = {delta:.3g}$"
        ax.annotate(text, (delta, 0), (20 if delta < 0 else -45, 8), **place)


@mpl.rc_context(STYLE)
def levels() -> Figure:
    """Draw where the outcome depends on the level: a map over φ and ω₃, δ = −0.2, ω⊥ = 0.2."""
    maps = figure_data.level_maps(MAP_SIZE, MAP_STRIDE, 0.4)
    figure = Figure((WIDE, 105 * MM), layout="constrained")
    ax = figure.subplots()
    plots.basin(maps.semi, ax=ax, shade=None)
    legend: Any = ax.get_legend()
    legend.remove()
    handles: list[Any] = [*legend.legend_handles]
    label = f"order 1 differs ({percent(float(np.mean(maps.order_1_differs)))})"
    phi, w3 = maps.semi.coords["phi"], maps.semi.coords["w3"]
    handles.append(hatch(ax, phi, w3, maps.order_1_differs, label))
    rows, columns = MAP_STRIDE * np.array(np.nonzero(maps.full_differs))
    label = f"full equation differs ({rows.size} of {maps.full_differs.size} starts)"
    dots: dict[str, Any] = {"color": "white", "mec": "black", "ms": 4, "ls": "", "clip_on": False}
    handles += ax.plot(phi[columns], w3[rows], "o", **dots, label=label)
    angles = np.linspace(0, np.pi, 1201)
    for corrected, colour in ((False, ORANGE), (True, YELLOW)):
        kind = "all other levels" if corrected else "order 1"
        label = rf"$z_s(\varphi)\,\omega_\perp^2$, limit of small $\omega$: {kind}"
        curve = figure_data.small_boundary(corrected, angles)
        handles += ax.plot(angles, curve, color=colour, lw=1.6, label=label)
    share = percent(float(np.mean(maps.semi.certified)))
    certified = f"{share} of the outcomes certified for this level"
    where = rf"$\delta = {figure_data.DELTA}$, $\omega_\perp = {figure_data.AMPLITUDE}$"
    ax.set_title(f"Semi-reduced equation, {where}; {certified}")
    ax.set(xlim=(0, np.pi), ylim=(0, w3[-1]))
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "1": ends_order_1,
    "1-full": ends_full,
    "2": two_starts,
    "3": rotator_plane,
    "spectra": spectra,
    "levels": levels,
}
"""The functions by the names of the figures, in the order of drawing."""
