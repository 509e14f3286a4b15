"""The spinning body in the laboratory, animated: the body, its dipole, ω and their traces."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.animation import FuncAnimation

from .._base.checks import check_body, instance
from .._base.refusals import refuse
from .._base.tolerances import budget
from .._runs.trajectory import Trajectory
from ..bodies import Body
from .style import BLACK, BLUE, ORANGE, capitalised

MERIDIANS, PARALLELS = 16, 9


def animate(trajectory: Trajectory, *, frames: int = 120, interval: int = 50) -> FuncAnimation:
    """Animate the motion of the body in the laboratory, v_lab = q∘v∘q*.

    The body is drawn as the homogeneous ellipsoid with its moments of inertia, its dipole as an
    orange arrow, and ω, scaled to its largest value, as a blue one. The tips of both leave traces.

    Args:
        trajectory: the result of `simulate(…, attitude=…)` for a single top. Each frame shows one
            of its times; evenly spaced times show the motion at constant speed.
        frames: largest number of frames; if there are more times, an even selection is shown.
        interval: milliseconds from one frame to the next.

    Returns:
        matplotlib's `FuncAnimation`. `.save("spin.gif", writer="pillow")` writes a file (mp4 with
        ffmpeg); in a notebook `IPython.display.HTML(animation.to_jshtml())` shows it.

    Raises:
        ValueError: a batch of trajectories, one without attitudes, or an equation without a body.
    """
    run = instance("trajectory", trajectory, Trajectory)
    if np.ndim(run.ts) != 1:
        refuse("trajectory", "describe one top", f"has times of shape {run.ts.shape}")
    check_body(run.equation)
    times, spin = np.asarray(run.ts), np.asarray(run.to_laboratory(run.omega))
    dipole = np.asarray(run.dipole)
    columns = np.stack([np.asarray(run.to_laboratory(axis)) for axis in np.eye(3)], axis=-1)
    last = len(times) - 1
    count = min(budget("frames", frames), len(times))
    shown = np.unique(np.linspace(0, last, count).round().astype(int))
    body: Body = run.equation.body  # pyright: ignore[reportAttributeAccessIssue]
    surface = _ellipsoid(body)
    reach = 1.25
    dipole = reach * dipole / max(np.linalg.norm(dipole[0]), np.finfo(float).tiny)
    largest = np.nanmax(np.linalg.norm(spin, axis=1))
    spin = reach * spin / (largest if largest > 0 else 1.0)
    figure = plt.figure(figsize=(5.4, 5.4), layout="constrained")
    ax: Any = figure.add_subplot(projection="3d")

    def draw(frame: int) -> list[Any]:
        k = shown[frame]
        ax.clear()
        x, y, z = np.einsum("ij,jab->iab", columns[k], surface)
        ax.plot_wireframe(x, y, z, color="0.6", linewidth=0.5)
        for values, colour, label in ((dipole, ORANGE, "dipole"), (spin, BLUE, r"$\omega$")):
            ax.plot(*values[: k + 1].T, color=colour, linewidth=0.8, alpha=0.6)
            ax.quiver(0, 0, 0, *values[k], color=colour, linewidth=2, label=label)
        ax.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.1), zlim=(-1.1, 1.1))
        ax.set_box_aspect((1, 1, 1))
        ax.set_axis_off()
        size = np.linalg.norm(run.omega[k])
        title = rf"{capitalised(run.level)}: $\tau$ = {times[k]:.4g}, $|\omega|$ = {size:.3g}"
        ax.set_title(title, fontsize="medium", color=BLACK)
        ax.legend(loc="lower center", ncols=2, frameon=False)
        return list(ax.collections) + list(ax.lines)

    return FuncAnimation(figure, draw, frames=len(shown), interval=interval, blit=False)


def _ellipsoid(body: Body) -> Float[np.ndarray, "3 a b"]:
    """Return the surface of the homogeneous ellipsoid with the moments of a body, in body axes.

    Its squared semi-axes are proportional to Jⱼ + Jₖ − Jᵢ; the longest one has length 1.
    """
    moments, axes = np.linalg.eigh(np.asarray(body.inertia, float))
    squares = np.maximum(moments.sum() - 2 * moments, 0.0)
    most = squares.max()
    semi_axes = np.sqrt(squares / most) if most > 0 else np.ones(3)
    along = np.linspace(0, 2 * np.pi, MERIDIANS + 1)
    across = np.linspace(0, np.pi, PARALLELS)[:, None]
    x, y = np.sin(across) * np.cos(along), np.sin(across) * np.sin(along)
    unit = np.stack(np.broadcast_arrays(x, y, np.cos(across)))
    return np.einsum("ij,jab->iab", axes, semi_axes[:, None, None] * unit)
