"""Trajectories: ω₁, ω₂, ω₃ and |ω| against time."""

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from .._base.checks import instance, refuse
from .._base.types import DecidingEquation, Outcome
from .._runs.trajectory import Trajectory
from .axes import check_axes
from .style import BLACK, BLUE, COMPONENTS, capitalised


def trajectory(trajectory: Trajectory, *, ax: Axes | None = None) -> Axes:
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
    check_axes(ax)
    if np.ndim(trajectory.ts) != 1:
        refuse("trajectory", "be that of one top", f"has times of shape {trajectory.ts.shape}")
    times, omega = np.asarray(trajectory.ts), np.asarray(trajectory.omega)
    size = np.sqrt(np.sum(omega**2, axis=1))
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    ax.axhline(0.0, color="0.8", linewidth=0.8)
    ax.plot(times, size, color=BLACK, linewidth=1.8, label=r"$|\omega|$")
    dashes = ("-", (0, (5, 1)), (0, (4, 1, 1, 1)))
    for k, ((name, colour), dash) in enumerate(zip(COMPONENTS, dashes, strict=True)):
        ax.plot(times, omega[:, k], color=colour, linestyle=dash, linewidth=1.3, label=name)
    _asymptote(ax, trajectory, times, size)
    if times[0] > 0:
        ax.set_xscale("log")
    else:
        ax.set_xscale("symlog", linthresh=float(times[1] - times[0]), linscale=0.5)
    ax.set_xlim(times[0], times[-1])
    ax.set_xlabel(r"$\tau = t/\tau_0$")
    ax.set_ylabel(r"$\omega = \tau_0\Omega$ (dimensionless)")
    ax.set_title(capitalised(trajectory.level), fontsize="medium")
    ax.legend(frameon=False, ncols=2)
    return ax


def _asymptote(
    ax: Axes, trajectory: Trajectory, times: Float[np.ndarray, "T"], size: Float[np.ndarray, "T"]
) -> None:
    """The limit of ω, or its law of decay, if the verdict of the last state is certain."""
    equation = trajectory.equation
    if not isinstance(equation, DecidingEquation):
        return
    verdict = equation.verdict(trajectory.ys[-1])
    if verdict.outcome == Outcome.RESIDUAL and verdict.error < 1e-3:
        label = rf"$\omega_\infty = {float(verdict.omega_inf):.4g}$"
        ax.axhline(float(verdict.omega_inf), color=BLUE, linestyle=":", label=label)
    elif verdict.outcome == Outcome.STOP:
        late = times >= times[-1] / 30
        law = size[-1] * np.sqrt(times[-1] / times[late])
        ax.plot(times[late], law, color="0.5", linestyle="--", label=r"$\propto\tau^{-1/2}$")
