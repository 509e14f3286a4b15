"""A sweep that `faults` kills. It prints "ready" when it begins, its tiles, and "done"."""

import os
from pathlib import Path

import jax
import numpy as np

import dipoletop as dt
from dipoletop._engines import native_engine  # noqa: F401 (imported by a sweep at its beginning)
from dipoletop._maps import sweep, sweep_plan, tiling  # noqa: F401

COLUMNS = 128


def problem(w3: jax.Array, phi: jax.Array) -> tuple[dt.TransverseReduced, jax.Array]:
    return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)


def run(folder: str, tiles: int) -> None:
    """Sweep, and print the progress; for a process that does nothing else.

    Tiles are small, a row of the grid each, so that there are many moments for a kill.
    """
    jax.config.update("jax_enable_x64", True)
    grid = dt.Grid(w3=np.linspace(0, 0.5, tiles), phi=np.arange(COLUMNS) * np.pi / COLUMNS)
    tiling.TILE = COLUMNS
    compute = sweep_plan.Plan.compute

    def reported(plan: sweep_plan.Plan, numbers: list[int], device: jax.Device) -> list:
        found = compute(plan, numbers, device)
        os.write(1, f"{' '.join(map(str, numbers))}\n".encode())
        return found

    sweep_plan.Plan.compute = reported
    os.write(1, b"ready\n")
    dt.sweep(problem, grid, store=folder)
    os.write(1, b"done\n")


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of every file of a store, by its path."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
