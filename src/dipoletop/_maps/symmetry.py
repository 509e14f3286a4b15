"""From one symmetry cell to the whole plane of starts."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .._base.checks import instance
from .basin import Basin


def unfold(basin: Basin) -> Basin:
    """The same basin with φ ∈ [0, 2π) and ω₃ ∈ [−max, max] instead of one symmetry cell.

    Every level has the symmetries (ω₁,ω₂) → −(ω₁,ω₂), that is φ → φ + π with ω∞ → −ω∞, and
    (ω₂,ω₃) → −(ω₂,ω₃), that is (φ,ω₃) → (−φ,−ω₃) with the same ω∞, if the dipole lies along
    axis 1 and the axes are principal, and whatever the other axes of the grid are.

    Args:
        basin: a basin over a grid. Its axis `phi` is extended if it divides [0, π) evenly, as
            in `symmetry_cell`; its axis `w3` if it rises from 0 or more and φ goes round.

    Returns:
        A basin in memory, whose level and settings are those of `basin`; `basin` itself if there
        is nothing to extend. Its starts at ω₃ = 0 are not doubled, so take `fractions` of the
        cell.

    Source: the symmetries of (4.2)–(4.4).
    """
    whole = instance("basin", basin, Basin)
    if _divides(whole.coords.get("phi"), np.pi):
        whole = _go_round(whole)
    if _divides(whole.coords.get("phi"), 2 * np.pi) and _rises(whole.coords.get("w3")):
        whole = _mirror(whole)
    return whole


def _divides(phi: Float[np.ndarray, "..."] | None, period: float) -> bool:
    """Whether φ = 0, h, 2h, … divides the period evenly, its end excluded."""
    if phi is None or phi.ndim > 1 or len(phi) < 2:
        return False
    step = period / len(phi)
    return bool(np.all(np.abs(phi - step * np.arange(len(phi))) < 1e-3 * step))


def _rises(w3: Float[np.ndarray, "..."] | None) -> bool:
    if w3 is None or w3.ndim > 1 or len(w3) < 2:
        return False
    return bool(w3[0] >= 0 and np.all(np.diff(w3) > 0))


def _go_round(basin: Basin) -> Basin:
    """φ → φ + π with ω∞ → −ω∞."""
    phi = basin.coords["phi"]
    at = basin.dims.index("phi")

    def both(name: str) -> np.ndarray:
        cell = basin.column(name)
        # 0 − ω∞ rather than −ω∞, so that a stop stays 0 and does not become −0.
        other = 0 - cell if name == "omega_inf" else cell
        return np.concatenate([cell, other], at)

    return _with(basin, {"phi": np.concatenate([phi, phi + np.pi])}, both)


def _mirror(basin: Basin) -> Basin:
    """(φ, ω₃) → (−φ, −ω₃) with the same ω∞; ω₃ = 0 is its own image."""
    w3 = basin.coords["w3"]
    turn, axial = basin.dims.index("phi"), basin.dims.index("w3")
    back = -np.arange(len(basin.coords["phi"])) % len(basin.coords["phi"])
    below = np.flatnonzero(w3 > 0)[::-1]

    def both(name: str) -> np.ndarray:
        half = basin.column(name)
        return np.concatenate([half.take(below, axial).take(back, turn), half], axial)

    return _with(basin, {"w3": np.concatenate([-w3[below], w3])}, both)


def _with(basin: Basin, coords, column) -> Basin:
    coords = basin.coords | coords
    shape = tuple(len(coords[name]) for name in basin.dims)
    columns = {name: column(name).reshape(-1) for name in basin.columns}
    return dataclasses.replace(basin, shape=shape, coords=coords, columns=columns)
