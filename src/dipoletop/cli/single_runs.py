"""Follows one top, and writes the table of its states."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._base.types import Equation
from .._runs.simulate import simulate
from .._runs.trajectory import Trajectory

COLUMNS = "tau,omega_1,omega_2,omega_3,energy,power"


def follow(
    equation: Equation, omega0: Array, tau_max: float, points: int, settings: Mapping[str, Any]
) -> tuple[Trajectory, Float[np.ndarray, "T 6"]]:
    """The trajectory up to `tau_max`, and its `COLUMNS` at even times.

    Raises:
        ValueError: the run ended before.
    """
    times = np.linspace(0.0, tau_max, points)
    trajectory = simulate(equation, omega0, times, throw=False, **settings)
    rows = np.column_stack([trajectory.ts, trajectory.omega, trajectory.energy, trajectory.power])
    if not np.all(np.isfinite(rows)):
        steps = trajectory.stats["num_steps"]
        raise ValueError(
            f"The run did not reach τ = {tau_max:g}: "
            f"it ended after {steps} steps of at most {settings['max_steps']}."
        )
    return trajectory, rows


def write_table(path: Path, rows: Float[np.ndarray, "T 6"]) -> None:
    """Write the rows as CSV, each number to the digits that give it back exactly."""
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=COLUMNS, comments="")
