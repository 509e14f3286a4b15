"""Basins on the whole plane of starts, extended from one symmetry cell."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .._base.checks import instance
from ..equations.levels import WITH_TORQUE
from .basin import Basin
from .columns import DERIVATIVE_PREFIX


def unfold(basin: Basin) -> Basin:
    """Extend a basin from one symmetry cell to φ ∈ [0, 2π) and ω₃ ∈ [−max, max].

    If the dipole lies along axis 1 and the axes are principal, every level has two symmetries:

    | rotation by π about | start | on the grid | ω∞ |
    |---|---|---|---|
    | axis 3 | (ω₁, ω₂) → −(ω₁, ω₂) | φ → φ + π | changes sign |
    | axis 1 | (ω₂, ω₃) → −(ω₂, ω₃) | (φ, ω₃) → (−φ, −ω₃) | is the same |

    They hold for any other axes of the grid. A torque from outside may break them, so the basin of
    an equation with such a torque is not extended. Derivatives transform accordingly: all change
    sign where ω∞ does, and ∂ω∞/∂φ and ∂ω∞/∂ω₃ change sign under (φ, ω₃) → (−φ, −ω₃).

    Args:
        basin: a basin over a grid. Its axis `phi` is extended if it divides [0, π) evenly, with
            its values at the edges of the parts, as in `symmetry_cell`, or at their midpoints; its
            axis `w3` if it increases from 0 or more and φ then covers [0, 2π).

    Returns:
        A basin in memory with the level and settings of `basin`; `basin` itself if there is
        nothing to extend. Starts at ω₃ = 0 occur once and all others twice, so take `fractions`
        from the cell.

    Source: the symmetries of (4.2)–(4.4).
    """
    unfolded = instance("basin", basin, Basin)
    if unfolded.level.endswith(WITH_TORQUE):
        return basin
    if _divides(_axis(unfolded, "phi"), np.pi):
        unfolded = _to_full_turn(unfolded)
    if _divides(_axis(unfolded, "phi"), 2 * np.pi) and _rises(_axis(unfolded, "w3")):
        unfolded = _to_both_hemispheres(unfolded)
    return unfolded


def _axis(basin: Basin, name: str) -> Float[np.ndarray, "n"] | None:
    """Return the values on an axis with two numbers or more; None if there is no such axis."""
    values = basin.coords.get(name) if name in basin.dims else None
    return None if values is None or values.ndim > 1 or len(values) < 2 else values


def _divides(phi: Float[np.ndarray, "n"] | None, period: float) -> bool:
    """Return whether φ = 0, h, 2h, … or ½h, 1½h, … divides the period evenly, its end excluded."""
    if phi is None:
        return False
    step = period / len(phi)
    places = phi / step - np.arange(len(phi))
    return bool(np.all(np.abs(places - _is_in_middles(phi) / 2) < 1e-3))


def _is_in_middles(phi: Float[np.ndarray, "n"]) -> bool:
    """Return whether values that divide a period begin at half a step rather than at 0."""
    return bool(phi[0] > (phi[1] - phi[0]) / 4)


def _rises(w3: Float[np.ndarray, "n"] | None) -> bool:
    return w3 is not None and bool(w3[0] >= 0 and np.all(np.diff(w3) > 0))


def _to_full_turn(basin: Basin) -> Basin:
    """Extend a basin by φ → φ + π with ω∞ → −ω∞."""
    phi, axis, columns = basin.coords["phi"], basin.dims.index("phi"), {}
    for name in basin.columns:
        cell = basin.column(name)
        odd = name == "omega_inf" or name.startswith(DERIVATIVE_PREFIX)
        columns[name] = np.concatenate([cell, _negative(cell) if odd else cell], axis)
    return _extended(basin, "phi", np.concatenate([phi, phi + np.pi]), columns)


def _to_both_hemispheres(basin: Basin) -> Basin:
    """Extend a basin by (φ, ω₃) → (−φ, −ω₃) with the same ω∞; ω₃ = 0 is its own image."""
    w3, phi, columns = basin.coords["w3"], basin.coords["phi"], {}
    phi_axis, w3_axis = basin.dims.index("phi"), basin.dims.index("w3")
    mirrored_phi = (-np.arange(len(phi)) - _is_in_middles(phi)) % len(phi)
    mirrored_w3 = np.flatnonzero(w3 > 0)[::-1]
    for name in basin.columns:
        upper = basin.column(name)
        lower = upper.take(mirrored_w3, w3_axis).take(mirrored_phi, phi_axis)
        if name in (DERIVATIVE_PREFIX + "phi", DERIVATIVE_PREFIX + "w3"):
            lower = _negative(lower)
        columns[name] = np.concatenate([lower, upper], w3_axis)
    return _extended(basin, "w3", np.concatenate([-w3[mirrored_w3], w3]), columns)


def _negative(values: np.ndarray) -> np.ndarray:
    """Return −x, except that 0 (the ω∞ of a stop) stays 0 and does not become −0."""
    return 0 - values


def _extended(
    basin: Basin, axis: str, values: Float[np.ndarray, "n"], columns: dict[str, np.ndarray]
) -> Basin:
    """Return the basin with other values on one axis, and the corresponding columns."""
    coords = basin.coords | {axis: values}
    shape = tuple(len(coords[name]) for name in basin.dims)
    flat = {name: column.reshape(-1) for name, column in columns.items()}
    return dataclasses.replace(basin, shape=shape, coords=coords, columns=flat)
