"""Trajectories: ω₁, ω₂, ω₃ and |ω| against time, of one run or of several."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cbook import normalize_kwargs
from matplotlib.lines import Line2D

from .._base.checks import instance
from .._base.compiling import compiled_soon
from .._base.refusals import refuse
from .._base.types import DecidingEquation, Outcome, State, Verdict
from .._runs.trajectory import BranchSolution, Trajectory
from .axes import axes_or_new
from .style import BLACK, BLUE, COMPONENTS, capitalised

CURVES = {"size": (r"$|\omega|$", BLACK)} | {
    f"w{k}": component for k, component in enumerate(COMPONENTS, 1)
}
"""Label and colour of every curve, by its name."""
DASHES: dict[str, Any] = {"size": "-", "w1": "-", "w2": (0, (5, 1)), "w3": (0, (4, 1, 1, 1))}
"""The dashes of the curves of a single run."""
RUNS: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
"""The dashes of several runs, one for each."""
SMOOTH = 800  # points of a curve that looks smooth
ROUGH = 0.05  # relative error at a time of the interpolation between its two neighbours


def trajectory(
    trajectory: Trajectory | Mapping[str, Trajectory],
    *,
    ax: Axes | None = None,
    curves: Sequence[str] = tuple(CURVES),
    **line: Any,
) -> Axes:
    """Plot ω₁, ω₂, ω₃ and |ω| against τ on a logarithmic scale, linear near τ = 0.

    A dotted line marks ω∞ if the last state is certain to keep a residual rotation, a dashed one
    the law |ω| ∝ τ^{-1/2} if it is certain to stop.

    Between its times a run is drawn with the solver's interpolation (`dense=True`) or else with
    cubic polynomials that have the rates of the equation. If the times are too far apart for them,
    straight lines join dots.

    Args:
        trajectory: the result of `simulate` for a single top; or a dict of several by label, drawn
            with different dashes.
        ax: matplotlib axes to draw on; None makes a figure.
        curves: the curves to draw, among "size", "w1", "w2", "w3".
        line: keywords of `Axes.plot` for all curves, such as `linewidth`, `alpha` or `color`.

    Returns:
        The axes; the title shows the level of the equation, the shape and the first |ω|.

    Raises:
        ValueError: a batch of trajectories, more than four of them, or an unknown curve.
    """
    instance("trajectory", trajectory, Trajectory | Mapping, "be a Trajectory, or a dict of them")
    several = isinstance(trajectory, Mapping)
    runs: dict[str, Trajectory] = dict(trajectory) if several else {"": trajectory}
    if not 1 <= len(runs) <= len(RUNS):
        refuse("trajectory", f"hold from 1 to {len(RUNS)} runs", f"holds {len(runs)}")
    for run in runs.values():
        instance("trajectory", run, Trajectory)
        if np.ndim(run.ts) != 1:
            refuse("trajectory", "describe one top", f"has times of shape {run.ts.shape}")
    names = [curves] if isinstance(curves, str) else list(curves)
    if not names or any(name not in CURVES for name in names):
        refuse("curves", f"be among {', '.join(CURVES)}", f"is {curves!r}")
    wanted = [name for name in CURVES if name in names]
    ax = axes_or_new(ax)
    ax.axhline(0.0, color="0.8", linewidth=0.8)
    for run, dashes in zip(runs.values(), RUNS, strict=False):
        _draw(ax, run, wanted, None if not several else dashes, normalize_kwargs(line, Line2D))
    _asymptotes(ax, runs)
    _time_axis(ax, list(runs.values()))
    ax.set_ylabel(r"$\omega = \tau_0\Omega$ (dimensionless)")
    ax.set_title(_title(list(runs.values())), fontsize="medium")
    handles: list[Any] = [line for line in ax.lines if not str(line.get_label()).startswith("_")]
    if several:
        handles = [Line2D([], [], color=CURVES[name][1], label=CURVES[name][0]) for name in wanted]
        lines = zip(runs, RUNS, strict=False)
        handles += [Line2D([], [], color="0.3", ls=dashes, label=name) for name, dashes in lines]
    ax.legend(handles=handles, frameon=False, ncols=2)
    return ax


def _title(runs: list[Trajectory]) -> str:
    """Return the levels, with the shape of the top and the size of ω at the start."""
    levels: dict[str, dict[str, None]] = {}
    for run in runs:
        delta, size = getattr(run.equation, "delta", None), float(np.linalg.norm(run.omega[0]))
        shape = "" if delta is None else rf"$\delta = {float(delta):.4g}$, "
        start = rf"{shape}$|\omega| = {size:.4g}$ at first"
        levels.setdefault(start, {})[capitalised(run.level)] = None
    return "\n".join(f"{'; '.join(each)}: {start}" for start, each in levels.items())


def _draw(ax: Axes, run: Trajectory, wanted: list[str], dashes: Any, given: dict[str, Any]) -> None:
    """Draw the curves of one run; `dashes` is None if it is the only one."""
    times, omega = _smooth(run)
    values = dict(zip(CURVES, [np.sqrt(np.sum(omega**2, axis=1)), *omega.T], strict=True))
    for name in wanted:
        label, colour = CURVES[name]
        style: dict[str, Any] = {"color": colour, "linestyle": dashes or DASHES[name]}
        style["linewidth"] = 1.8 if name == "size" else 1.3
        style |= {"label": label if dashes is None else f"_{label}"} | given
        ax.plot(times, values[name], **style)
        if len(times) == len(run.ts) < SMOOTH / 4:  # it is not interpolated
            ax.plot(times, values[name], ".", ms=4, color=style["color"])


def _smooth(run: Trajectory) -> tuple[Float[np.ndarray, "t"], Float[np.ndarray, "t 3"]]:
    """Return times close enough for a smooth curve, the run's own among them, and ω there."""
    from scipy.interpolate import CubicHermiteSpline

    times, omega = np.asarray(run.ts), np.asarray(run.omega)
    known = np.isfinite(times) & np.isfinite(omega).all(axis=1)
    times, omega = times[known], omega[known]
    parts = -(-SMOOTH // max(len(times), 1))
    if len(times) < 3 or parts < 2:
        return times, omega
    within = np.arange(parts) / parts
    finer = (times[:-1, None] + np.diff(times)[:, None] * within).ravel()
    finer = np.append(finer, times[-1])
    if not isinstance(run.solution, BranchSolution) and run.solution.interpolation is not None:
        return finer, np.asarray(run.evaluate(finer))
    rates = np.asarray(run.omega_dot)[known]
    every_other = slice(0, len(times) - 1 + len(times) % 2, 2)
    between = slice(1, len(times) - 1, 2)
    cubic = CubicHermiteSpline(times[every_other], omega[every_other], rates[every_other])
    errors = np.abs(cubic(times[between]) - omega[between])
    if np.max(errors) > ROUGH * np.max(np.abs(omega)):
        return times, omega
    return finer, CubicHermiteSpline(times, omega, rates)(finer)


def _asymptotes(ax: Axes, runs: Mapping[str, Trajectory]) -> None:
    """Draw the limit of ω, or the law of decay, of runs whose last state has a certain outcome."""
    for name, run in runs.items():
        equation, times = run.equation, np.asarray(run.ts)
        if not isinstance(equation, DecidingEquation):
            continue
        verdict, hidden = _verdict(equation, run.ys[-1]), "_" if name else ""
        if verdict.outcome == Outcome.RESIDUAL and verdict.error < 1e-3:
            label = rf"{hidden}$\omega_\infty = {float(verdict.omega_inf):.4g}$"
            ax.axhline(float(verdict.omega_inf), color=BLUE, linestyle=":", label=label)
        elif verdict.outcome == Outcome.STOP:
            late = times >= times[-1] / 30
            law = np.linalg.norm(run.omega[-1]) * np.sqrt(times[-1] / times[late])
            label = rf"{hidden}$\propto\tau^{{-1/2}}$"
            ax.plot(times[late], law, color="0.5", linestyle="--", label=label)


@compiled_soon
def _verdict(equation: DecidingEquation, y: State) -> Verdict:
    return equation.verdict(y)


def _time_axis(ax: Axes, runs: list[Trajectory]) -> None:
    """Make the axis of τ logarithmic, linear near 0 if the runs begin there."""
    firsts, last = [float(run.ts[0]) for run in runs], max(float(np.nanmax(x.ts)) for x in runs)
    if min(firsts) > 0:
        ax.set_xscale("log")
    else:
        step = min(float(run.ts[1] - run.ts[0]) for run in runs)
        ax.set_xscale("asinh", linear_width=step)  # smooth, unlike `symlog`
        decades = 10.0 ** np.arange(np.ceil(np.log10(step)), np.log10(last))
        ax.set_xticks([0.0, *decades])
        ax.set_xticks([x * k for x in decades for k in range(2, 10) if x * k < last], minor=True)
    ax.set_xlim(min(firsts), last)
    ax.set_xlabel(r"$\tau = t/\tau_0$")
